"""What is learnt from scored logs, against the densities drawn from; metrics; errors of estimates."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import bootstrap, genpareto
from sklearn.metrics import f1_score

from fdd import Scenario, Unit, simulate
from fdd.campaign.dataset import Dataset
from fdd.campaign.generate import _trouble, generate
from fdd.campaign.labels import Label
from fdd.campaign.recipe import Recipe
from fdd.campaign.scores import Outcome, calibration_error, class_of, figures, macro_f1, visible_from
from fdd.campaign.train import LAW_SPREAD, LEAST_LOGS, ScoredLog, as_stated, learnt, pareto, second_logistic
from fdd.campaign.validate import estimate_errors, outcomes_csv, report_text, summary, validate
from fdd.diagnosis.findings import FaultFinding, Trajectories
from fdd.diagnosis.model import root
from fdd.plant.state import Truth
from fdd.residuals.oil import air_compliance
from tests.made_up import answer, entry, finding, label
from tests.refusal import refused

RECIPE = Recipe(
    schema="fdd.recipe/1", name="tiny", seed=3, bases=["axis_a"], units=1, logs_per_unit=2, format="parquet",
    faults={"internal_leakage": {}}, healthy_share=0.5, profiles={"step": 1}, duties={"steps": 1},
    loads={"spring": 1}, severity=[0.9, 1.0], duration=[40, 41], onset=[0.3, 0.4], baseline=True,
)  # fmt: skip


def scored(family: str, score: float) -> ScoredLog:
    return ScoredLog(family, score, score, 360.0)


def drawn(seed: int = 0) -> list[ScoredLog]:
    """A peak each tenth of an hour; roots exponential, of mean 2 in healthy logs and of 12 in faulty ones."""
    rng = np.random.default_rng(seed)
    healthy = [scored("healthy", 0.5 * r**2) for r in rng.exponential(2.0, 4000)]
    return healthy + [scored("leakage", 0.5 * r**2) for r in rng.exponential(12.0, 1000)]


@pytest.mark.parametrize("rate", [2.0, 0.5, 0.05])
def test_the_threshold_is_passed_at_the_rate_asked_for(rate: float) -> None:
    model = learnt(drawn(), "made up")
    # Ten peaks an hour above 0, each root above r with exp(-r/2).
    assert root(model.tail.threshold(rate)) == pytest.approx(2.0 * np.log(10.0 / rate), rel=0.1)
    assert model.tail.hours == pytest.approx(400.0)


def test_probabilities_are_those_of_even_odds_before_the_log() -> None:
    """Bayes on the densities drawn from: a log of either kind is as likely before its score is known."""
    calibration = learnt(drawn(), "made up").calibration
    for score in (2.0, 4.0, 6.0, 10.0):
        healthy, faulty = np.exp(-score / 2.0) / 2.0, np.exp(-score / 12.0) / 12.0
        right = faulty / (healthy + faulty)
        assert calibration.probability(0.5 * score**2) == pytest.approx(right, abs=0.08), score


@pytest.mark.parametrize("share", [0.2, 1.0 / 3.0, 0.6])
def test_a_quiet_log_does_not_rule_out_faults_that_leave_no_trace(share: float) -> None:
    """A third of the faulty logs, whatever share these could not have shown by what was reckoned."""
    traceless = [scored("leakage", 0.5 * r**2) for r in np.random.default_rng(1).exponential(2.0, 500)]
    clear = [scored("leakage", 0.5 * r**2) for r in 20.0 + np.random.default_rng(2).exponential(12.0, 1000)]
    healthy = [x for x in drawn() if x.family == "healthy"]
    logs = [replace(x, hidden=share) for x in healthy + traceless + clear]
    calibration = learnt(logs, "made up").calibration
    assert share**calibration.hidden_power == pytest.approx(1.0 / 3.0, abs=0.03)
    assert calibration.probability(0.1, share) == pytest.approx(0.25, abs=0.02)
    assert calibration.probability(0.5 * 25.0**2, share) > 0.95


def test_severities_are_as_doubtful_as_their_errors() -> None:
    """Sizes of half the truth in a fifth of the logs, right in the others: 80 % are, but for the law."""
    sized = [replace(x, doubt=0.8 if k % 5 == 0 else 0.0) for k, x in enumerate(drawn())]
    assert LAW_SPREAD <= learnt(sized, "made up").calibration.severity_doubt < 0.8
    sized = [replace(x, doubt=0.4 * k / len(sized)) for k, x in enumerate(sized)]
    doubt = learnt(sized, "made up").calibration.severity_doubt
    assert doubt == pytest.approx(np.hypot(0.32, LAW_SPREAD), abs=0.01)


def test_logs_far_apart_are_parted_between_them() -> None:
    """Quiet logs and gross faults, one of which left no trace, in logs that would have shown most."""
    rng = np.random.default_rng(0)
    roots = [*[0.0] * 15, *rng.uniform(0.0, 1.8, 6), *rng.uniform(3.5, 22.5, 99)]
    hidden = rng.uniform(0.02, 0.24, len(roots))
    logs = [scored("healthy" if k < 20 else "leakage", 0.5 * r**2) for k, r in enumerate(roots)]
    logs = [replace(x, hidden=h) for x, h in zip(logs, hidden, strict=True)]
    assert 1.5 < learnt(logs, "made up").calibration.midpoint < 4.0


def test_findings_beside_a_surer_one_come_true_as_often_as_said() -> None:
    """Drawn by a known curve, right ones twice as often as they weigh; where they teach nothing, none."""
    rng = np.random.default_rng(1)
    roots, sizes = rng.uniform(2.0, 16.0, 6000), rng.normal(-3.0, 2.0, 6000)
    right = rng.random(roots.size) < 1.0 / (1.0 + np.exp(0.5 * (7.0 - roots - 0.6 * sizes)))
    found = list(zip(np.where(right, 0.5, 1.0), roots, sizes, right, strict=True))
    learnt_curve = second_logistic([*found, *(one for one in found if one[3])])
    expected = {"second_midpoint": 7.0, "second_slope": 0.5, "second_gain": 0.6}
    assert learnt_curve == pytest.approx(expected, rel=0.1)
    against = [(1.0, 9.0, 0.0, False), (1.0, 1.0, 0.0, True)]  # no score speaks against a fault
    for taught in (against * (LEAST_LOGS // 2 - 1), against[1:] * 20, against * 20):
        assert second_logistic(taught) == {}
    shrinking = [(1.0, r, -r / 2.0, r > 6.0) for r in np.linspace(1.0, 12.0, 40)]
    assert second_logistic(shrinking)["second_gain"] == 0.0, "nor does a larger gain"


def test_pairs_of_faults_weigh_what_one_unit_in_eight_has() -> None:
    """However many a recipe draws; where there are none, or nothing else, all logs weigh the same."""
    weights = as_stated(np.arange(50) < 30)
    assert weights.sum() == pytest.approx(1.0) and weights[:30].sum() == pytest.approx(0.125, abs=0.01)
    assert [as_stated(np.full(4, alike)).tolist() for alike in (True, False)] == [[0.25] * 4] * 2


def test_too_few_logs_teach_nothing() -> None:
    few = [scored("healthy", 1.0)] * (LEAST_LOGS - 1) + [scored("leakage", 9.0)] * 20
    assert f"{LEAST_LOGS - 1} healthy and 20 faulty" in refused(lambda: learnt(few, "made up"))


def test_healthy_logs_that_all_score_alike_teach_a_tail_too() -> None:
    """Ten hours without a peak: at most one, and that by a standard deviation."""
    alike = [replace(scored("healthy", -1.0), healthy_s=3600.0)] * 10 + [scored("leakage", 9.0)] * 20
    tail = learnt(alike, "made up").tail
    assert tail.rate_per_hour == pytest.approx(0.1) and 0.0 < tail.threshold(0.01) < 30.0


def outcome(true: list[Label], said: list[FaultFinding], healthy=0.0, leakage=(0.02, 0.5)) -> Outcome:
    found = answer("faulty" if said else "healthy", *said, probabilities={"healthy": healthy})
    rest = {(m, n): (0.02, 0.5) for m in ("ekf", "svsf") for n in ("leakage", "bulk_modulus")}
    return Outcome(entry(*true), found, {**rest, ("ekf", "leakage"): leakage})


def test_the_figures_of_made_up_outcomes() -> None:
    leak, worn, air = "internal_leakage", "pump_wear", "aeration"
    outcomes = [
        outcome([label(leak)], [finding(leak)]),
        outcome([label(leak)], [finding(worn, ambiguity=[worn, leak])]),  # the group names it
        outcome([label(air)], [finding(leak, 11.5)]),  # another class
        outcome([label(air)], [finding(air, 7.0)]),  # before anything was wrong
        outcome([label(air)], [finding(air, 10.0, confidence=0.4)]),  # less likely than not
        outcome([label(leak), label(air, 20.0)], [finding(leak), finding(air, 20.0)]),
        outcome([], [], healthy=0.8),
        replace(outcome([], [finding(air)]), alarms=2),
    ]
    mean, (low, high), each = macro_f1([o.classes for o in outcomes])
    # Leakage: 3 right, 1 too many; aeration: 2 right, 2 missed, 1 too many; healthy: 1, 1, 1.
    assert each == pytest.approx({"healthy": 2 / 4, "leakage": 6 / 7, "aeration": 4 / 7})
    assert mean == pytest.approx(np.mean(list(each.values()))) and low < mean < high
    text = figures(outcomes)
    unseen = replace(outcomes[0], entry=outcomes[0].entry.model_copy(update={"visible": False}))
    assert f", {mean:.2f} of the 8 healthy and visible" in figures([*outcomes, unseen])
    assert "faulty logs found: 0.67 (0.30 to 0.90) of 6" in text
    assert "class right: 0.67 (0.21 to 0.94) of 3" in text
    assert "group that is named: 0.67 (0.21 to 0.94) of 3" in text
    assert "both named: 1.00" in text
    assert "median 0.50 s, 90 % below 1.3 s" in text
    assert "fault in their answer: 0.50" in text and "way: 2 in 1.0 h: 2.00 (0.24 to 7.22) an hour" in text
    assert "hold the true one: 1.00 (0.21 to 1.00) of 1" in text
    # Of the faulty logs 0.9 is said five times and holds three times, 0 once, wrongly; of the healthy ones
    # 0.9 once, wrongly, 0.8 once, rightly. Each kind is half of all.
    in_nines = abs(5 * 0.9 - 3) / 6 + 0.9 / 2
    sureness, ill = [o.sureness for o in outcomes], [bool(o.entry.faults) for o in outcomes]
    assert calibration_error(sureness, ill)[0] == pytest.approx((in_nines + 0.2 / 2 + 0.0) / 2)


def test_the_interval_of_macro_f1_is_that_of_logs_drawn_anew() -> None:
    rng, true = np.random.default_rng(3), np.array(["pump_wear", "aeration", "seal_wear"] * 30)
    said = np.where(rng.random(90) < 0.7, true, "aeration")
    low, high = macro_f1([({class_of(t)}, {class_of(s)}) for t, s in zip(true, said, strict=True)])[1]
    reference = bootstrap(
        (np.arange(90),), lambda k: f1_score(true[k], said[k], average="macro"), n_resamples=400, rng=1,
        method="percentile",
    )  # fmt: skip
    assert (low, high) == pytest.approx(tuple(reference.confidence_interval), abs=0.03)


def test_calibrated_statements_err_by_what_chance_makes_of_as_many_logs() -> None:
    """Of 600 sets of 80 logs, half of them healthy, 6 to 14 % lie beyond the 90 % quantile (3.3 std)."""
    rng, found = np.random.default_rng(8), []
    for _ in range(600):
        p = rng.uniform(0.5, 1.0, 80)
        found.append(calibration_error(list(zip(p, rng.random(80) < p, strict=True)), [True, False] * 40))
    error, mean, most = np.array(found).T
    assert 0.06 < np.mean(error > most) < 0.14
    assert np.mean(error - mean) == pytest.approx(0.0, abs=3.3 * np.std(error) / 600**0.5)


def test_the_severity_from_which_nine_tenths_are_found_is_that_of_the_draw() -> None:
    """Found with the logistic probability of log severity that is a half at 0.2, 0.9 at 0.2 * 9^(1/4)."""
    rng = np.random.default_rng(4)
    outcomes = []
    for severity in rng.uniform(0.05, 1.0, 1500):
        true = label("internal_leakage", severity=float(severity))
        seen = rng.random() < 1.0 / (1.0 + (0.2 / severity) ** 4)
        outcomes.append(outcome([true], [finding("internal_leakage")] if seen else []))
    assert visible_from(outcomes, "internal_leakage") == pytest.approx(0.2 * 9.0**0.25, rel=0.12)
    assert np.isnan(visible_from(outcomes, "aeration"))


@pytest.fixture(scope="module")
def tiny_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(RECIPE, tmp_path_factory.mktemp("validate") / "set", workers=1)


@pytest.mark.slow
def test_validation_compares_each_log_with_its_truth(tiny_set: Path) -> None:
    outcomes = validate(tiny_set, workers=1)
    healthy, leaking = sorted(outcomes, key=lambda o: bool(o.entry.faults))
    assert healthy.found.verdict != "faulty" and not healthy.said
    assert leaking.classes == ({"leakage"}, {"leakage"})
    assert abs(leaking.timely[0].onset_s - leaking.entry.faults[0].onset_s) < 1.0
    for each in outcomes:
        for key, (error, share) in each.errors.items():
            assert not share or error < 0.05, key
    rows = list(csv.DictReader(io.StringIO(outcomes_csv(outcomes))))
    assert [r["file"] for r in rows] == [o.entry.file for o in outcomes]
    assert summary(outcomes) in report_text(outcomes, Dataset.load(tiny_set))


@pytest.mark.parametrize("shape", [0.0, 0.2, 0.4])
def test_a_pareto_tail_is_found_again(shape: float) -> None:
    rng = np.random.default_rng(7)
    fits = [pareto(genpareto.rvs(shape, scale=2.0, size=200, random_state=rng)) for _ in range(100)]
    # One fit's shape scatters by 0.1, so what is held between 0 and 0.5 is off by up to 0.04 on average.
    np.testing.assert_allclose(np.mean(fits, axis=0), [2.0, shape], atol=0.1)


N = 4000
TIME = np.arange(N) * 0.01
LEAKAGE, BULK = 7e-12, 3e8


def truth(severity: np.ndarray | None = None, bulk: float = BULK) -> Truth:
    time = np.arange(800) * 0.05
    columns = {"leakage": np.full(time.size, LEAKAGE), "bulk_modulus": np.full(time.size, bulk)}
    return Truth(time, columns, {} if severity is None else {"aeration": np.interp(time, TIME, severity)})


def tracked(leak: np.ndarray, bulk: np.ndarray, seen: np.ndarray | None = None) -> Trajectories:
    flags = np.ones(N, dtype=bool) if seen is None else seen
    none = np.empty(0)
    return Trajectories(
        time=TIME, estimates={"ekf": {"leakage": leak, "bulk_modulus": bulk}}, stds={},
        observable={"leakage": flags, "bulk_modulus": flags}, nis={}, window_time=none, feature_names=[],
        features=none, statistic=none, threshold=0.0,
    )  # fmt: skip


def errors(found: Trajectories, of: Truth, profile: Unit | None = None) -> dict[str, tuple[float, float]]:
    axis = Unit.load("axis_a")
    return {n: e for (_, n), e in estimate_errors(found, of, profile or axis, axis).items()}


def test_an_estimates_error_is_its_median_while_it_is_observable_and_settled() -> None:
    leak = np.full(N, LEAKAGE * 1.1)
    leak[TIME <= 5.0] = 1.0  # the first five seconds do not count
    leak[TIME > 30.0] *= 1.1
    seen = TIME < 38.0
    found = errors(tracked(leak, np.full(N, 0.8 * BULK), seen), truth())
    assert found["leakage"] == (pytest.approx(0.1), pytest.approx(33.0 / 40.0, abs=1e-3))
    assert found["bulk_modulus"][0] == pytest.approx(0.2)
    none = errors(tracked(leak, leak, np.zeros(N, dtype=bool)), truth())
    assert np.isnan(none["leakage"][0]) and none["leakage"][1] == 0.0


def test_while_a_fault_changes_the_plant_and_shortly_after_no_estimate_counts() -> None:
    step = (TIME >= 20.0).astype(float)
    leak = np.where((TIME > 19.95) & (TIME < 24.9), 1.0, LEAKAGE)  # lost for as long as a filter may need
    found = errors(tracked(leak, np.full(N, BULK)), truth(step))
    assert found["leakage"][0] == 0.0
    assert found["leakage"][1] == pytest.approx((40.0 - 5.0 - 5.2) / 40.0, abs=0.01)


def test_leakage_is_compared_by_area_and_stiffness_by_volume_over_area() -> None:
    """A profile of 3 % more area and 8 % more volume gives estimates that are right for it."""
    profile = Unit.load("axis_a")
    c = profile.cylinder
    larger = {"area_1": 1.03 * c.area_1, "volume_1": 1.08 * c.volume_1, "volume_2": 1.08 * c.volume_2}
    profile.cylinder = c.model_copy(update=larger)
    found = errors(tracked(np.full(N, 1.03 * LEAKAGE), np.full(N, BULK * 1.08 / 1.03)), truth(), profile)
    assert found["leakage"][0] == pytest.approx(0.0, abs=1e-9)
    assert found["bulk_modulus"][0] == pytest.approx(0.0, abs=1e-9)


def test_bulk_modulus_is_compared_at_the_profiles_reference_pressure() -> None:
    """Of oil and free air in it, whose compliances add up (thesis eq. 5.21)."""
    axis = Unit.load("axis_a")
    oil = axis.oil
    pressures = (oil.reference_pressure, 2.0 * oil.reference_pressure)
    here, there = (float(air_compliance(p, oil.polytropic_index)) for p in pressures)
    stiff, share = 1.0 / oil.bulk_modulus - oil.air_fraction * here, oil.air_fraction + 0.004
    profile = axis.model_copy(update={"oil": oil.model_copy(update={"reference_pressure": pressures[1]})})
    seen = tracked(np.full(N, LEAKAGE), np.full(N, 1.0 / (stiff + share * there)))
    found = errors(seen, truth(bulk=1.0 / (stiff + share * here)), profile)
    assert found["bulk_modulus"][0] == pytest.approx(0.0, abs=1e-6)


def test_the_summary_counts_what_was_found_and_what_was_answered() -> None:
    leak, air = "internal_leakage", "aeration"
    text = summary([
        outcome([label(leak)], [finding(leak)], leakage=(0.01, 1.0)),
        outcome([label(leak)], [finding("pump_wear", 11.0)], leakage=(0.03, 0.5)),
        outcome([label(leak)], [], leakage=(float("nan"), 0.0)),
        outcome([label(air)], [finding(air, 5.0)], leakage=(0.05, 0.5)),  # before anything was wrong
    ])  # fmt: skip
    cells = [[c.strip() for c in x.split("|")[1:-1]] for x in text.splitlines() if x.startswith("|")]
    rows = {name: row for name, *row in cells[2:]}
    assert rows["internal leakage"][:2] == ["3", "2"]
    assert set(rows["internal leakage"][2].split(", ")) == {"internal leakage 1", "pump wear 1"}
    assert rows["internal leakage"][3] == "2.8 s", "the median of 2.5 and 3 s"
    assert rows["aeration"] == ["1", "0", "-", "-"]
    assert rows["EKF leakage"] == ["3.0 %", "4.6 %", "3 of 4", "50 %"]


def test_a_relief_valve_whose_setting_fell_may_relieve() -> None:
    """Else every log in which it shows would be drawn anew."""
    run = simulate(Unit.load("axis_a"), Scenario(
        duration=3.0, load={"name": "constant", "level": 2500.0}, duty={"name": "standstill"},
        faults=[{"fault": "relief_valve_stuck_open", "severity": 0.65, "law": "setting"}],
    ))  # fmt: skip
    assert np.mean(np.abs(run.truth["relief_flow"]) > 1e-7) > 0.5 and not _trouble(run)
    healthy = run.scenario.model_copy(update={"faults": []})
    assert "relief valve" in _trouble(replace(run, scenario=healthy))
