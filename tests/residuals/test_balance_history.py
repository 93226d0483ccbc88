"""What logs may differ by; the history of frames: what older ones teach, stops, misfits, state; epochs."""

from dataclasses import replace

import numpy as np
import pytest

from fdd.diagnosis.hypotheses import HealthyUnit
from fdd.faults import CATALOGUE
from fdd.residuals.balance_history import SURROUNDINGS, BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S
from fdd.residuals.effects import (
    UNKNOWN_VISCOSITY,
    LogConditions,
    first_effects,
    usual_conditions,
    viscous_change,
    with_logs,
)
from fdd.residuals.epochs import BalanceSums, Epochs
from fdd.residuals.normal_equations import NormalEquations
from fdd.residuals.quantities import Scales
from fdd.sections import Provenance
from fdd.unit import Baseline, Unit

EFFECTS = {name: first_effects(name) for name in BALANCES}
MINUTE = round(60.0 / FRAME_S)


def began(history: BalanceHistory, frame: int) -> None:
    history.frames.append(frame)
    history.surroundings.append([0.0] * SURROUNDINGS)


@pytest.mark.parametrize("within", [0.0, 0.3])
def test_fold_is_batch_regression(within: float) -> None:
    unit, rng = Unit.load("axis_a"), np.random.default_rng(10)
    effects = {n: replace(e, within=np.full(e.mean.size, within)) for n, e in EFFECTS.items()}
    history = BalanceHistory(unit, effects)
    kept: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {n: [] for n in BALANCES}
    count, window = 40, 20
    for h in range(count):
        began(history, h + 7)
        for name, e in effects.items():
            n = e.mean.size
            x = rng.normal(size=(30, n)) / np.sqrt(np.diag(e.covariance))
            information, vector = x.T @ x, x.T @ (x @ e.mean + rng.normal(size=30))
            kept[name].append((information, vector))
            history.equations[name].append(NormalEquations(information, vector, 30.0, e.noise**2))
    folded = history.fold(window)
    part = window // 5
    assert folded == history.folded and folded % part == 0 and count - folded <= window + part
    assert history.frames == [h + 7 for h in range(folded, count)]
    for name, e in effects.items():
        assert len(history.equations[name]) == count - folded
        # Batch: one stacked least squares of the prior and of each frame, a frame's own wander in its
        # covariance.
        information, vector = np.linalg.inv(e.covariance), np.linalg.solve(e.covariance, e.mean)
        if within == 0.0:
            for m, v in kept[name][:folded]:
                frame = np.linalg.inv(np.linalg.inv(m) + np.diag(e.wander**2))
                information, vector = information + frame, vector + frame @ np.linalg.solve(m, v)
            reference, covariance = history.reference[name], np.linalg.inv(information)
            std, mean = np.sqrt(np.diag(covariance)), np.linalg.solve(information, vector)
            np.testing.assert_allclose(reference.mean / std, mean / std, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(reference.covariance, covariance, rtol=1e-5, atol=1e-12)
        else:  # older frames tell where the unit was, not where it is
            assert (np.diag(history.reference[name].covariance) > within**2).all()


def test_what_came_since_a_fault_is_no_reference() -> None:
    """Of it the latest frames are kept, and some from before its onset, however long it stands."""
    rng, effects = np.random.default_rng(12), dict(EFFECTS)
    history, window, onset = BalanceHistory(Unit.load("axis_a"), effects), 20, 30
    healthy = {}
    for h in range(200):
        began(history, h)
        for name, e in effects.items():
            x = rng.normal(size=(30, e.mean.size)) / np.sqrt(np.diag(e.covariance))
            history.equations[name].append(NormalEquations(x.T @ x, x.T @ (x @ e.mean), 30.0, 1.0))
        history.fold(window, [(onset * FRAME_S, np.inf)] if h >= onset else [])
        if h == onset + window:
            healthy = dict(history.reference)
    before = [h for h in history.frames if h < onset]
    assert before == list(range(onset - window // 5, onset))
    assert history.frames[-1] == 199 and len(history.frames) <= window + window // 5
    assert history.frames[len(before) :] == list(range(200 - len(history.frames) + len(before), 200))
    for name, e in history.reference.items():
        np.testing.assert_array_equal(e.mean, healthy[name].mean)
    assert history.folded == onset - window // 5
    # Once it is over, what is healthy is learnt again, and what was not is left out.
    for h in range(200, 260):
        began(history, h)
        for name in effects:
            history.equations[name].append(history.equations[name][-1])
        history.fold(window, [(onset * FRAME_S, 200 * FRAME_S)])
    assert min(history.frames) >= 200 and history.folded > onset


def told_of(frames: int) -> BalanceHistory:
    """Frames from the eleventh on, each of rows about other coefficients than the unit's."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(13)
    unit.baseline = Baseline(version="", seconds=1.0, balances={})
    history = BalanceHistory(unit, dict(EFFECTS))
    history.frames, history.last, history.taken = list(range(10, 10 + frames)), 9 + frames, frames
    history.surroundings = [[0.0] * SURROUNDINGS] * frames
    for name, e in history.effects.items():
        for _ in range(frames):
            x = rng.normal(size=(30, e.mean.size)) / np.sqrt(np.diag(e.covariance))
            b = e.mean + np.sqrt(np.diag(e.covariance)) * rng.normal(size=e.mean.size)
            history.equations[name].append(NormalEquations(x.T @ x, x.T @ x @ b, 30.0, 1.0))
    return history


def test_after_a_stop_a_unit_is_held_against_its_baseline_again() -> None:
    history = told_of(33)
    history.folded = 7
    sums = {n: sum(m for m, _ in history._marginalised(n)) for n in BALANCES}
    history.begin_anew([(6.0, 9.0)], 10)
    assert history.frames == [] and not any(history.equations.values())
    assert history.reference is history.effects and history.folded == 0
    assert history.taken == 40, "the next frame is the first that is looked at together with others"
    kept = history.epochs._sums[-1]
    for name, total in sums.items():
        np.testing.assert_allclose(kept[name][0], total, err_msg="its life has them all, whatever stood")


def test_a_stretch_that_is_forgotten_leaves_the_other_frames_as_they_were() -> None:
    history, whole = told_of(12), told_of(12)
    history.marginalised()
    history.forget(6.0, 8.5)
    assert history.frames == [10, 11, *range(17, 22)], "with its first frame, without the one at its end"
    keep = np.array(history.frames) - 10
    for name, parts in history.marginalised().items():
        for one, other in zip(parts, whole.marginalised()[name], strict=True):
            np.testing.assert_array_equal(one, other[keep])


@pytest.mark.parametrize("sharpness", [1e-2, 1.0, 1e4])
@pytest.mark.parametrize("overdispersion", [1.0, 9.0])
def test_a_healthy_frames_misfit_is_about_one(sharpness: float, overdispersion: float) -> None:
    """Of the unit's prior, and errors as the information says or stretches scatter: four errors of 3 %."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(5)
    history = BalanceHistory(unit, dict(EFFECTS))
    e = history.effects["reservoir"]
    usual = np.hypot(e.wander, np.sqrt(np.diag(e.covariance)))
    m = np.diag(sharpness / usual**2)
    history.effects["reservoir"] = replace(e, information=m, scatter=overdispersion * m)
    wanders, errs = rng.normal(size=(2, 500, usual.size))
    off = usual * wanders + errs / np.sqrt(np.diag(m))
    frames = [NormalEquations(m, m @ (e.mean + np.sqrt(overdispersion) * d), 30.0, 1.0) for d in off]
    assert np.mean(np.square(history._misfit("reservoir", frames))) == pytest.approx(1.0, abs=0.12)


def told(seed: int, *names: str) -> BalanceSums:
    """Normal equations of some balances, of many rows."""
    rng, out = np.random.default_rng(seed), {}
    for name in names:
        x = rng.normal(size=(200, len(BALANCES[name].columns)))
        out[name] = x.T @ x, x.T @ rng.normal(size=200)
    return out


def minutes(epochs: Epochs, start: int, count: int, what: BalanceSums) -> None:
    epochs.add(range(start * MINUTE, (start + count) * MINUTE), what)


def test_a_stop_ends_an_epoch_of_two_minutes_in_motion_or_more() -> None:
    epochs, one, other = Epochs(), told(1, "refeed"), told(2, "refeed")
    minutes(epochs, 10, 1, one)
    epochs.stop()
    assert len(epochs) == epochs.completed == 0, "too short: the next flight goes on with it"
    minutes(epochs, 500, 1, other)
    assert len(epochs) == 0, "nor before the stop"
    epochs.stop()
    assert len(epochs) == epochs.completed == 1
    assert epochs.starts().tolist() == [600.0]
    # One draw of what differs between logs, however many frames it has: variances add up.
    m, v = (a + b for a, b in zip(one["refeed"], other["refeed"], strict=True))
    wide, kept = epochs.marginalised(EFFECTS)["refeed"]
    between = EFFECTS["refeed"].between_logs(usual_conditions(EFFECTS["refeed"].noise))
    right = np.linalg.inv(np.linalg.inv(m) + np.diag(between))
    np.testing.assert_allclose(wide, right[None], rtol=1e-8)
    np.testing.assert_allclose(kept[0], right @ np.linalg.solve(m, v), rtol=1e-8)
    epochs.stop()
    assert epochs.completed == 1, "a stop alone is no epoch"


def hours(*starts: int) -> Epochs:
    epochs = Epochs()
    for start in starts:
        minutes(epochs, 60 * start, 60, told(start, "refeed", *["torque"] * (start > 2)))
    return epochs


def test_epochs_that_began_while_a_fault_stood_are_forgotten() -> None:
    epochs = hours(0, 1, 2, 3, 4)
    minutes(epochs, 300, 5, told(9, "refeed"))
    epochs.forget(3600.0, 3 * 3600.0)
    assert (epochs.starts() / 3600.0).tolist() == [0.0, 3.0, 4.0], "with its onset, up to its end"
    expected = hours(0, 3, 4).marginalised(EFFECTS)
    for name, parts in epochs.marginalised(EFFECTS).items():
        for one, other in zip(parts, expected[name], strict=True):
            np.testing.assert_array_equal(one, other)
    epochs.forget(0.0, 1e9)
    assert len(epochs) == 0
    epochs.stop()
    assert epochs.starts().tolist() == [18_000.0], "what is not complete yet was not looked at"


def test_beyond_sixteen_of_one_length_the_two_oldest_become_one_of_twice_it() -> None:
    epochs, value = Epochs(), (np.eye(4), np.ones(4))
    for hour in range(70):
        minutes(epochs, 60 * hour, 60, {"refeed": value})
        lengths = np.diff([*(epochs.starts() / 3600.0), hour + 1]).astype(int).tolist()
        assert lengths == sorted(lengths, reverse=True), "the older, the longer"
        assert set(lengths) <= {1, 2, 4} and all(lengths.count(n) <= 16 for n in (1, 2, 4))
        if hour in (16, 17):
            assert lengths == [2] + [1] * (hour - 1)
        sums = [float(each["refeed"][0][0, 0]) for each in epochs._sums]
        assert sums == lengths, "each has the hours that it spans"


@pytest.mark.parametrize("name", ["volume", "torque"])
def test_unknown_viscosity_moves_coefficients_as_other_oil_does(name: str) -> None:
    """Half the viscosity against the derivative by its logarithm; what goes by the inverse: 1/0.5 - 1 = 1."""
    thin = next(s for s in CATALOGUE["oil_degradation"].signatures if s.label == "thin")
    columns = thin.columns(HealthyUnit(EFFECTS, Scales.of(Unit.load("axis_a"))))[name]
    wanted = np.array([columns.get(c, 0.0) for c in BALANCES[name].columns])
    change = -viscous_change(name, first_effects(name).mean)
    np.testing.assert_allclose(wanted / np.abs(wanted).max(), change / np.abs(change).max(), atol=1e-12)
    if name == "volume":
        np.testing.assert_allclose(wanted, change)


def test_without_a_thermometer_a_log_may_be_of_any_viscosity() -> None:
    """One more draw along the viscosity's direction, no other."""
    first = first_effects("volume")
    change = viscous_change("volume", first.mean)
    warm = usual_conditions(first.noise)
    blind = LogConditions(*warm[:4], 1.0)
    more = with_logs(first, blind, change).covariance - with_logs(first, blind).covariance
    np.testing.assert_allclose(more, UNKNOWN_VISCOSITY**2 * np.outer(change, change))
    one, other = with_logs(first, warm, change), with_logs(first, warm)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_a_profiles_doubt_about_its_displacement_is_the_gains() -> None:
    unit, gain = Unit.load("axis_a"), BALANCES["volume"].columns.index("gain")
    sure = first_effects("volume", unit=unit).units[gain]
    assert sure == first_effects("volume").units[gain]
    unit.pump.provenance["displacement"] = Provenance(std=0.03 * unit.pump.displacement)
    assert first_effects("volume", unit=unit).units[gain] == pytest.approx(np.hypot(sure, 0.03))
