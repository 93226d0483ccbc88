"""What a pipeline says between pushes, of slow wear over an axis's life, and of what it cannot know."""

import numpy as np
import pytest
from simulated_logs import simulated

from fdd import Samples, Scenario, Unit, simulate
from fdd.diagnosis.answering import Span
from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import Quality
from fdd.diagnosis.hypotheses import hypotheses
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import EPOCHS, Pipeline
from fdd.diagnosis.sequential_detector import SequentialDetector
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S
from fdd.residuals.effects import usual_conditions
from fdd.residuals.epochs import EPOCH_FRAMES, Epochs

UNIT = Unit.load("axis_a")
MODEL = Model.load()
THRESHOLD = MODEL.tail.threshold(UNIT.monitoring.false_alarms_per_hour * 3600.0)
EFFECTS = effects_of(UNIT)
FAULTS = hypotheses(UNIT, EFFECTS)
SEEN = ("volume", "force")
LEAK = next(h for h in FAULTS if h.fault == "internal_leakage")
HOURS, LEAKS_FROM = 40, 25


def live(unit: Unit, samples: Samples) -> Pipeline:
    pipeline = Pipeline(unit, keep_trajectories=False)
    for block in samples.blocks(1000):
        pipeline.push(block)
    return pipeline


def test_what_is_said_now_is_what_the_last_look_saw(unit: Unit, leaking: Samples) -> None:
    before, after = live(unit, leaking.rows(0, 10_200)), live(unit, leaking)  # a look is at 10 s
    answer = after.finish()
    assert before.standing == [] and [f.fault for f in after.standing] == ["internal_leakage"]
    for pipeline, end in ((before, 10.2), (after, 32.0)):
        assert end - 5.0 <= pipeline.looked_at <= end
        assert set(pipeline.channels) == set(leaking.channels)
    healthy, leaks = before.now(), after.now()
    for (probabilities, estimates, misfits), matter in ((healthy, "healthy"), (leaks, "leakage")):
        assert sum(probabilities.values()) == pytest.approx(1.0, abs=1e-3)
        assert max(probabilities, key=lambda k: probabilities[k]) == matter
        assert misfits.keys() <= BALANCES.keys() and {"volume", "force"} <= misfits.keys()
        assert estimates["leakage"].unit == "m^3/(s*Pa)"
    assert leaks[0] == pytest.approx(answer.probabilities, abs=0.05)
    assert healthy[0] == pytest.approx(before.finish().probabilities, abs=0.05)
    assert leaks[1] == answer.estimates
    assert leaks[2]["volume"] > 2.0 * healthy[2]["volume"], "the leak is in the chambers' oil"
    assert leaks[2]["force"] < 2.0 * max(healthy[2]["force"], 1.0), "and not in the forces"
    assert before.largest_score < before.threshold < after.largest_score


def add_hour(epochs: Epochs, hour: int, rng: np.random.Generator, leak: float) -> None:
    """What it tells: its own draw of what differs from log to log, known to a tenth of that."""
    told = {}
    for name in SEEN:
        effects, change = EFFECTS[name], leak * LEAK.columns.get(name, np.zeros(len(BALANCES[name].columns)))
        size = np.sqrt(effects.between_logs(usual_conditions(effects.noise)))
        sharp = 100.0 / size / size[:, None] * (np.eye(size.size) + 0.3)
        true = effects.mean + size * rng.normal(size=size.size) + change
        told[name] = sharp, sharp @ true + np.linalg.cholesky(sharp) @ rng.normal(size=size.size)
    epochs.add(range(hour * EPOCH_FRAMES, (hour + 1) * EPOCH_FRAMES), told)


def life(seed: int, hours: int, severity: float, begins: int, grows: int) -> list[tuple[int, set[str]]]:
    """Hours at which alarms were raised, and of which families."""
    rng, epochs = np.random.default_rng(seed), Epochs()
    detector, raised = SequentialDetector(FAULTS, THRESHOLD, MODEL), []
    for hour in range(hours):
        add_hour(epochs, hour, rng, severity * min(max(hour - begins, 0) / grows, 1.0))
        effects = Epochs.effects(EFFECTS)
        evidence = Evidence(epochs.marginalised(effects), effects, from_start=False, stretches=EPOCHS)
        span = Span(epochs.starts().tolist(), (hour + 1) * EPOCH_FRAMES * FRAME_S, "stretches", None)
        fresh, _ = detector.take(detector.evaluate(evidence, span, 0.0), 0.0)
        if fresh:
            raised.append((hour, {f.fault for f in fresh}))
    return raised


@pytest.mark.slow
def test_hours_that_differ_as_healthy_logs_do_raise_nothing() -> None:
    """Of ten lives of 120 hours one alarm is expected; more than four come once in 280 times."""
    assert sum(len(life(seed, 120, 0.0, 0, 1)) for seed in range(10)) <= 4


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_leak_that_grows_over_days_is_found(seed: int) -> None:
    """It grows by 0.5 % of a gross leak an hour; after the first ten hours, and below a third of one."""
    (hour, found), *more = life(seed, 90, 0.3, 10, 60)
    assert found == {"internal_leakage"} and 10 < hour < 70 and not more


def aged(unit: Unit, first: Samples, hours: int, severity: float) -> Pipeline:
    """An axis with a life behind it since some samples, whose leakage has been larger since an hour of it."""
    pipeline, rng = Pipeline(unit, keep_trajectories=False), np.random.default_rng(5)
    pipeline.push(first)
    for hour in range(hours):
        add_hour(pipeline._history.epochs, hour, rng, severity * (hour >= LEAKS_FROM))
    return pipeline


def later(samples: Samples, hours: float) -> Samples:
    return Samples(samples.time + 3600.0 * hours, samples.columns)


def test_slow_wear_is_told_once_and_stands(leaking: Samples) -> None:
    """Of hours that the reference of minutes has long followed."""
    healthy = leaking.rows(0, 16_000)
    first = healthy.rows(0, 9)
    assert aged(UNIT, first, LEAKS_FROM, 0.5).push(later(healthy, HOURS)) == []
    pipeline = aged(UNIT, first, HOURS, 0.5)
    told = pipeline.push(later(healthy, HOURS))
    assert [f.fault for f in told] == ["internal_leakage"]
    assert told[0].onset_s / 3600.0 == pytest.approx(LEAKS_FROM, abs=2.0)
    assert told[0].severity == pytest.approx(0.5, abs=0.2)
    assert [f.fault for f in pipeline.standing] == ["internal_leakage"]
    again = Pipeline(UNIT, keep_trajectories=False)
    again.restore(pipeline.state())
    for each in (pipeline, again):
        answer = each.finish()
        assert answer.verdict == "faulty" and [f.fault for f in answer.faults] == ["internal_leakage"]
        assert each.push(later(healthy, HOURS + 1)) == [], "nothing that was not told"
        each._history.epochs.add(range(EPOCH_FRAMES), {})
        assert each.push(later(healthy, HOURS + 2)) == []


def test_a_fault_that_minutes_show_is_not_told_as_slow_wear_too(unit: Unit, leaking: Samples) -> None:
    pipeline = aged(unit, leaking.rows(0, 9), HOURS, 0.5)
    epochs = pipeline._history.epochs
    pipeline._epochs = epochs.completed  # not looked at yet
    start = 3600.0 * HOURS
    told = pipeline.push(later(leaking, HOURS))
    assert [f.fault for f in told] == ["internal_leakage"] and told[0].onset_s > start
    first = round((start + 32.0) / FRAME_S)
    epochs.add(range(first, first + EPOCH_FRAMES), {})
    more = simulated(11, "spring", "internal_leakage").rows(20_000, 32_000)
    assert pipeline.push(Samples(more.time + start + 13.0, more.columns)) == []
    assert [f.onset_s > start for f in pipeline.standing] == [True]
    assert [f.onset_s > start for f in pipeline.finish().faults] == [True]


def test_a_log_that_hardly_moves_says_nothing_of_health(unit: Unit) -> None:
    still = simulate(unit, Scenario(duration=20.0, duty={"name": "standstill"}, seed=5)).samples
    given = Quality(dropped_samples=3, notes=["a word of the reader"])
    pipeline = live(unit, still)
    answer = pipeline.finish(given)
    assert answer.verdict == "inconclusive" and answer.faults == []
    assert "hardly moves" in answer.quality.notes[0] and answer.quality.notes[1] == given.notes[0]
    assert answer.quality.dropped_samples == 3 and given.notes == ["a word of the reader"]


def test_what_is_known_of_a_unit_is_told(unit: Unit, leaking: Samples) -> None:
    short = leaking.rows(0, 10_000)

    def notes(of: Unit) -> str:
        return " ".join(live(of, short).finish().quality.notes)

    old = unit.model_copy(deep=True)
    old.baseline.version = "0"
    assert "another version" in notes(old) and "not identified" not in notes(old)
    assert "not identified" in notes(Unit.load("axis_a"))
    assert "version" not in notes(unit) and "not identified" not in notes(unit)


def test_a_fault_left_out_of_the_catalogue_is_not_named(unit: Unit, leaking: Samples) -> None:
    pipeline = Pipeline(unit, without=("internal_leakage",), keep_trajectories=False)
    pipeline.push(leaking)
    said = pipeline.finish()
    assert said.verdict == "faulty"
    assert all("internal_leakage" not in (f.fault, *f.ambiguity) for f in said.faults)
    assert "internal_leakage" not in {x.fault for x in said.not_visible}


def test_probabilities_over_time_turn_to_each_fault_as_it_is_detected(unit: Unit, leaking: Samples) -> None:
    slipped = leaking["position"] + 1e-3 * (leaking.time > 27.0)
    pipeline = Pipeline(unit)
    pipeline.push(leaking.with_columns({"position": slipped}))
    answer = pipeline.finish()
    over = pipeline.trajectories(answer)
    leak, slip = sorted(answer.faults, key=lambda f: f.detected_s)
    assert (leak.family, slip.family) == ("leakage", "sensor")
    for fault in (leak, slip):
        share = over.probabilities[fault.family]
        since = int(np.searchsorted(over.window_time, fault.detected_s))
        assert share[since - 2] < 0.6 and (share[since + 1 :] > 0.9).all()
    assert over.probabilities["healthy"][-1] == answer.probabilities["healthy"]


def test_trajectories_end_with_what_the_answer_says(unit: Unit, leaking: Samples) -> None:
    pipeline = Pipeline(unit)
    pipeline.push(leaking)
    answer = pipeline.finish()
    over = pipeline.trajectories(answer)
    assert over.time[0] < 1.0 and over.time[-1] > 31.9 and (np.diff(over.time) > 0.0).all()
    assert over.statistic[-1] == pipeline.score != over.statistic[-2], "the last look is the answer's own"
    for name, said in answer.estimates.items():
        for values, what in (
            (over.estimates["ekf"], said.value), (over.stds["ekf"], said.std), (over.held, said.held),
            (over.held_std, said.held_std), (over.information_std, said.information_std),
        ):  # fmt: skip
            assert values[name].shape == over.time.shape
            expected = np.nan if what is None else what  # never observable
            assert values[name][-1] == pytest.approx(expected, rel=1e-3, nan_ok=True), name
        assert bool(over.observable[name][-1]) == said.observable
        assert over.estimates["svsf"][name].shape == over.time.shape
    assert over.nis.keys() == over.estimates.keys()
    assert over.features.shape == (over.window_time.size, len(over.feature_names))
    np.testing.assert_allclose(np.diff(over.window_time), FRAME_S)
    assert over.window_time[-1] == pytest.approx(32.0, abs=FRAME_S), "a frame is told of at its end"
    with pytest.raises(ValueError, match="not kept"):
        live(unit, leaking).trajectories()
