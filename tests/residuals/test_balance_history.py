"""The balance history's algebra against textbook forms, quadrature and least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES, ORDERS, RegressionBlock
from fdd.residuals.bins import BIN_S, COLUMNS, FRAME_BINS, FRAME_S, TAIL_BINS
from fdd.residuals.effects import Effects, first_effects
from fdd.residuals.normal_equations import NormalEquations, marginalised
from fdd.residuals.regression_accumulator import LOAD_S, RegressionAccumulator
from fdd.unit import Baseline, Unit

Array = NDArray[np.float64]
ROWS = TAIL_BINS + FRAME_BINS


def regular(rng: np.random.Generator, n: int) -> Array:
    root = rng.normal(size=(2 * n, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n)
    return np.asarray(root.T @ root)


@pytest.mark.parametrize("n", [1, 3, 7])
def test_marginalised_is_the_textbook_form_where_the_information_is_regular(n: int) -> None:
    rng = np.random.default_rng(n)
    m, std = regular(rng, n), 10.0 ** rng.uniform(-2.0, 1.0, n)
    vector = m @ rng.normal(size=n)
    wide, kept = marginalised(m, vector, std)
    expected = np.linalg.inv(np.linalg.inv(m) + np.diag(std**2))
    np.testing.assert_allclose(wide, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(
        kept, expected @ np.linalg.solve(m, vector), rtol=1e-6, atol=1e-9 * np.abs(kept).max()
    )


def test_marginalised_integrates_the_difference_out() -> None:
    """The log-likelihood, with the difference integrated out by quadrature, is the parabola that it gives."""
    m, vector, std = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([1.5, -0.7]), np.array([0.6, 0.9])
    wide, kept = marginalised(m, vector, std)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    d = np.stack(np.meshgrid(nodes * std[0], nodes * std[1], indexing="ij"), axis=-1).reshape(-1, 2)
    w = np.outer(weights, weights).ravel()

    def integrated(c: Array) -> float:
        b = c + d
        return float(np.log(w @ np.exp(b @ vector - 0.5 * np.einsum("ki,ij,kj->k", b, m, b))))

    for c in np.random.default_rng(1).uniform(-1.0, 1.0, (20, 2)):
        parabola = kept @ c - 0.5 * c @ wide @ c
        assert integrated(c) - integrated(np.zeros(2)) == pytest.approx(parabola, abs=1e-8)


def test_marginalised_of_what_tells_nothing_tells_nothing() -> None:
    column = np.array([1.0, -2.0, 0.5])
    wide, kept = marginalised(np.outer(column, column), 3.0 * column, np.array([1e-3, 10.0, 1.0]))
    across = np.array([2.0, 1.0, 0.0])
    assert across @ wide @ across == pytest.approx(0.0, abs=1e-12)
    assert across @ kept == pytest.approx(0.0, abs=1e-12)
    # Along the one thing that is known, the scalar form: variance 1 and that of the difference.
    variance = 1.0 + float(column**2 @ np.array([1e-3, 10.0, 1.0]) ** 2)
    np.testing.assert_allclose(wide, np.outer(column, column) / variance, rtol=1e-6, atol=1e-12)
    blank, none = marginalised(np.zeros((4, 3, 3)), np.zeros((4, 3)), np.ones(3))
    assert not blank.any() and not none.any()


def of_frame(rng: np.random.Generator, n: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    x = rng.normal(size=(ROWS, n)) * np.arange(1, n + 1)
    return x @ rng.normal(size=n) + 0.1 * rng.normal(size=ROWS), x, np.ones(ROWS, dtype=bool)


def least_squares(information: Array, vector: Array) -> Array:
    return np.asarray(np.linalg.solve(information, vector))


@pytest.mark.parametrize("name", ["coherence", "refeed"])
def test_a_frame_of_plain_rows_is_least_squares(name: str) -> None:
    balance, rng = BALANCES[name], np.random.default_rng(4)
    y, x, ok = of_frame(rng, len(balance.columns))
    ok[TAIL_BINS + 5 : TAIL_BINS + 12] = False
    [(information, vector, rows, variance)] = RegressionAccumulator(balance, first_effects(name)).equations(
        [RegressionBlock(y, x, ok)]
    )
    x, y = x[TAIL_BINS:][ok[TAIL_BINS:]], y[TAIL_BINS:][ok[TAIL_BINS:]]
    expected, rest, *_ = np.linalg.lstsq(x, y, rcond=None)
    assert rows == len(y) == FRAME_BINS - 7
    np.testing.assert_allclose(least_squares(information, vector), expected, rtol=1e-8)
    np.testing.assert_allclose(information, x.T @ x / variance, rtol=1e-9, atol=1e-9 * information.max())
    assert variance >= 0.99 * rest[0] / (len(y) - x.shape[1])


@pytest.mark.parametrize("name", ["torque", "reservoir"])
def test_a_frame_of_changes_is_least_squares_on_levels(name: str) -> None:
    """Each unbroken stretch has a level of its own: a dummy of least squares takes its mean out."""
    balance, rng = BALANCES[name], np.random.default_rng(5)
    n = len(balance.columns)
    y, x, ok = of_frame(rng, n)
    ok[TAIL_BINS + 20] = False
    [(information, vector, _, _)] = RegressionAccumulator(balance, first_effects(name)).equations(
        [RegressionBlock(y, x, ok)]
    )
    stretches = [slice(TAIL_BINS, TAIL_BINS + 20), slice(TAIL_BINS + 21, ROWS)]
    levels_x = [np.cumsum(x[s], axis=0) for s in stretches]
    levels_y = [np.cumsum(y[s]) for s in stretches]
    dummies = np.repeat(np.eye(2), [len(v) for v in levels_y], axis=0)
    design, aim = np.column_stack([np.concatenate(levels_x), dummies]), np.concatenate(levels_y)
    expected = np.linalg.lstsq(design, aim, rcond=None)[0][:n]
    # The first row of a stretch, which its mean makes redundant, is left out: a few per cent of the rows.
    np.testing.assert_allclose(least_squares(information, vector), expected, atol=0.05)


def test_a_frame_of_cells_is_least_squares_on_their_means_over_the_load_before() -> None:
    balance, rng = BALANCES["force"], np.random.default_rng(6)
    n, bins_per_row = len(balance.columns), BALANCES["force"].bins_per_row
    y, x, ok = of_frame(rng, n)
    y, x = np.cumsum(y), np.cumsum(x, axis=0)
    ok[TAIL_BINS + 13] = False
    regression = RegressionAccumulator(balance, first_effects("force"))
    [(information, vector, rows, _)] = regression.equations([RegressionBlock(y, x, ok)])
    means = np.column_stack([x, y])[TAIL_BINS:].reshape(-1, bins_per_row, n + 1).mean(axis=1)
    means = np.delete(means, 13 // bins_per_row, axis=0)
    before = pd.DataFrame(means).ewm(alpha=bins_per_row * BIN_S / LOAD_S, adjust=False).mean().shift(1)
    over = (means - before.to_numpy())[1:]
    assert rows == FRAME_BINS // bins_per_row - 1
    # A frame has as many cells as there are columns: its normal equations are compared, not their solution.
    squares = over[:, :n].T @ over[:, :n]
    variance = np.trace(squares) / np.trace(information)
    np.testing.assert_allclose(variance * information, squares, atol=1e-9 * np.abs(squares).max())
    np.testing.assert_allclose(variance * vector, over[:, :n].T @ over[:, n], rtol=1e-9)


@pytest.mark.parametrize("swing", [0.6, 0.0])
def test_a_line_has_its_amplitude_whatever_its_phase(swing: float) -> None:
    balance, rng = BALANCES["shaft"], np.random.default_rng(7)
    found = []
    for phase in np.linspace(0.0, 6.0, 7):
        regression = RegressionAccumulator(balance, first_effects("shaft"))
        k = np.arange(20 * FRAME_BINS + TAIL_BINS)
        angle = 0.8 * k + swing / 0.07 * np.sin(0.07 * k)
        lines = [turn(order * angle) for order in ORDERS for turn in (np.cos, np.sin)]
        x = np.column_stack([*lines, np.ones_like(angle), *rng.normal(size=(3, angle.size))])
        y = 0.2 * np.cos(angle + phase) + 0.05 * np.sin(2 * angle) + 0.3 + 0.01 * rng.normal(size=angle.size)
        for frame in range(20):
            here = slice(frame * FRAME_BINS, frame * FRAME_BINS + ROWS)
            [(information, vector, rows, _)] = regression.equations(
                [RegressionBlock(y[here], x[here], np.ones(ROWS, dtype=bool))]
            )
            assert rows
        found.append(least_squares(information, vector))
    np.testing.assert_allclose(found, np.tile([0.2, 0.05], (7, 1)), atol=0.015)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_noise_in_a_column_takes_nothing_from_a_healthy_units_coefficient(share: float) -> None:
    """A pressure with noise in compliance and sensor lag."""
    balance, rng, frames = BALANCES["volume"], np.random.default_rng(11), 400
    n, noise = len(balance.columns), np.sqrt(share)
    compliance, lag = balance.columns.index("compliance"), balance.columns.index("sensor_lag")
    healthy = np.zeros(n)
    healthy[[compliance, lag]] = 0.9, 0.4
    effects = replace(first_effects("volume"), mean=healthy)
    regression, plain = RegressionAccumulator(balance, effects), RegressionAccumulator(balance, effects)
    told = np.zeros((ROWS, 2, n))
    told[:, 0, [compliance, lag]], told[:, 1, lag] = noise, -noise
    sums = {True: [np.zeros((n, n)), np.zeros(n)], False: [np.zeros((n, n)), np.zeros(n)]}
    for _ in range(frames):
        truth = np.cumsum(rng.normal(size=ROWS + 2)) * 0.3 + rng.normal(size=ROWS + 2)
        seen = truth + noise * rng.normal(size=truth.size)
        x = np.zeros((ROWS, n))
        x[:, compliance], x[:, lag] = np.diff(seen)[1:], np.diff(seen, 2)
        y = 0.9 * np.diff(truth)[1:] + 0.4 * np.diff(truth, 2) + np.diff(rng.normal(size=ROWS + 1))
        for known, of in ((True, regression), (False, plain)):
            [(m, v, rows, variance)] = of.equations(
                [RegressionBlock(y, x, np.ones(ROWS, dtype=bool), told if known else None)]
            )
            assert rows
            sums[known][0] += m * variance
            sums[known][1] += v * variance
    pair = [compliance, lag]
    found, drawn = (least_squares(m[np.ix_(pair, pair)], v[pair]) for m, v in (sums[True], sums[False]))
    np.testing.assert_allclose(found, [0.9, 0.4], atol=0.06)
    assert np.abs(drawn - [0.9, 0.4]).max() > 0.02 + 0.2 * share, "else this shows nothing"


@pytest.mark.parametrize("name", ["volume", "coherence", "shaft"])
def test_a_noise_that_grows_is_known_after_twenty_seconds(name: str) -> None:
    """Ten seconds of memory: two of them later nine tenths of the change are in."""
    balance, rng = BALANCES[name], np.random.default_rng(13)
    regression, said = RegressionAccumulator(balance, first_effects(name)), []
    k = np.arange(ROWS)
    turned = [turn(order * (0.8 * k + 40.0 * rng.uniform())) for order in ORDERS for turn in (np.cos, np.sin)]
    for frame in range(400):
        _, x, _ = of_frame(rng, len(balance.columns))
        if name == "shaft":
            x = np.column_stack([*turned, np.ones(ROWS), *rng.normal(size=(3, ROWS))])
        y = (0.1 if frame < 200 else 0.3) * rng.normal(size=ROWS)
        y = np.diff(y, prepend=0.0) if balance.cumulative else y
        regression.equations([RegressionBlock(y, x, np.ones(ROWS, dtype=bool))])
        said.append(regression.variance_sum / regression.weight)
    before, after, later = said[199], said[240], said[399]
    assert later == pytest.approx(9.0 * before, rel=0.3)
    assert 0.8 * (later - before) < after - before


def test_too_few_rows_say_nothing() -> None:
    balance, rng = BALANCES["coherence"], np.random.default_rng(8)
    y, x, ok = of_frame(rng, len(balance.columns))
    ok[:] = False
    ok[-5:] = True
    regression = RegressionAccumulator(balance, first_effects("coherence"))
    [(information, vector, rows, variance)] = regression.equations([RegressionBlock(y, x, ok)])
    assert rows == 0.0 and not information.any() and not vector.any() and variance > 0.0


@pytest.mark.parametrize("within", [0.0, 0.3])
def test_fold_is_batch_regression(within: float) -> None:
    unit, rng = Unit.load("axis_a"), np.random.default_rng(10)
    effects = {name: first_effects(name) for name in BALANCES}
    effects = {n: replace(e, within=np.full(e.mean.size, within)) for n, e in effects.items()}
    history = BalanceHistory(unit, effects)
    kept: dict[str, list[tuple[Array, Array]]] = {n: [] for n in BALANCES}
    count, window = 40, 20
    for h in range(count):
        history.frames.append(h + 7)
        history.surroundings.append([0.0, 0.0, 0.0])
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
            reference = history.reference[name]
            std = np.sqrt(np.diag(np.linalg.inv(information)))
            np.testing.assert_allclose(
                reference.mean / std, np.linalg.solve(information, vector) / std, rtol=1e-6, atol=1e-6
            )
            np.testing.assert_allclose(
                reference.covariance, np.linalg.inv(information), rtol=1e-5, atol=1e-12
            )
        else:  # older frames tell where the unit was, not where it is
            assert (np.diag(history.reference[name].covariance) > within**2).all()


def test_what_came_since_a_fault_is_no_reference() -> None:
    """Of it the latest frames are kept, and some from before its onset, however long it stands."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(12)
    effects: dict[str, Effects] = {name: first_effects(name) for name in BALANCES}
    history, window, onset = BalanceHistory(unit, effects), 20, 30
    healthy = {}
    for h in range(200):
        history.frames.append(h)
        history.surroundings.append([0.0, 0.0, 0.0])
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
        history.frames.append(h)
        history.surroundings.append([0.0, 0.0, 0.0])
        for name in effects:
            history.equations[name].append(history.equations[name][-1])
        history.fold(window, [(onset * FRAME_S, 200 * FRAME_S)])
    assert min(history.frames) >= 200 and history.folded > onset


def told_of(frames: int, *, baseline: bool = True) -> BalanceHistory:
    """Frames from the eleventh on, each of rows about other coefficients than the unit's."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(13)
    unit.baseline = Baseline(version="", seconds=1.0, balances={}) if baseline else None
    history = BalanceHistory(unit, {name: first_effects(name) for name in BALANCES})
    history.frames, history.last, history.taken = list(range(10, 10 + frames)), 9 + frames, frames
    history.surroundings = [[0.0, 0.0, 0.0]] * frames
    for name, e in history.effects.items():
        for _ in range(frames):
            x = rng.normal(size=(30, e.mean.size)) / np.sqrt(np.diag(e.covariance))
            b = e.mean + np.sqrt(np.diag(e.covariance)) * rng.normal(size=e.mean.size)
            history.equations[name].append(NormalEquations(x.T @ x, x.T @ x @ b, 30.0, 1.0))
    return history


def learnt(history: BalanceHistory, frames: Sequence[int], name: str) -> tuple[Array, Array]:
    """Mean and covariance of the unit's own prior and some frames, by one batch."""
    e = history.effects[name]
    information, vector = np.linalg.inv(e.covariance), np.linalg.solve(e.covariance, e.mean)
    for frame in frames:
        m, v = history.equations[name][frame - 10][:2]
        wide, kept = marginalised(m, v, e.wander)
        information, vector = information + wide, vector + kept
    covariance = np.linalg.inv(information)
    return covariance @ vector, covariance + np.diag(e.within**2)


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


def test_a_unit_of_which_nothing_else_is_known_is_held_against_its_healthy_frames() -> None:
    history = told_of(20, baseline=False)
    history.folded = 7
    healthy = [h for h in range(10, 30) if not 6.0 <= h * FRAME_S < 9.0]
    expected = {name: learnt(history, healthy, name) for name in BALANCES}
    history.begin_anew([(6.0, 9.0)], 10)
    assert history.frames == [] and history.folded == 7 and history.taken == 20
    for name, (mean, covariance) in expected.items():
        found = history.reference[name]
        np.testing.assert_allclose(found.mean, mean, rtol=1e-6, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-12, err_msg=name)


def test_a_fault_that_stands_is_held_against_what_came_before_it_after_a_stop_too() -> None:
    history = told_of(33)
    history.begin_anew([(1.0, 2.0), (8.0, np.inf)], 10)
    assert history.frames == list(range(10, 43)) and history.taken == 40
    assert history.reference is history.effects


def test_a_stop_is_ten_minutes_or_more_without_a_frame() -> None:
    history = told_of(5)
    assert history.last == 14
    assert not history.stopped(14 + round(600.0 / FRAME_S)) and history.stopped(15 + round(600.0 / FRAME_S))
    assert not BalanceHistory(history.unit, history.effects).stopped(5000), (
        "nothing came before the first frame"
    )


def test_a_stretch_that_is_forgotten_leaves_the_other_frames_as_they_were() -> None:
    history, whole = told_of(12), told_of(12)
    history.marginalised()
    history.forget(6.0, 8.5)
    assert history.frames == [10, 11, *range(17, 22)], "with its first frame, without the one at its end"
    keep = np.array(history.frames) - 10
    for name, parts in history.marginalised().items():
        for one, other in zip(parts, whole.marginalised()[name], strict=True):
            np.testing.assert_array_equal(one, other[keep])


def test_a_frames_misfit_is_how_many_usual_changes_it_is_off() -> None:
    """Known sharply: the root mean square of its coefficients' own distances; known badly: next to none."""
    history = told_of(1)
    for name, e in history.effects.items():
        usual = np.hypot(e.wander, np.sqrt(np.diag(e.covariance)))
        signs = np.where(np.arange(e.mean.size) % 2, 1.0, -1.0)
        off = e.mean + 3.0 * usual * signs
        sharp, blurred = (np.diag(k / usual**2) for k in (1e6, 1e-3))
        told = [
            NormalEquations(sharp, sharp @ off, 30.0, 1.0),
            NormalEquations(sharp, sharp @ e.mean, 30.0, 1.0),
            NormalEquations(blurred, blurred @ off, 30.0, 1.0),
            NormalEquations(sharp, sharp @ off, 0.0, 1.0),
        ]
        far, near, unknown, nothing = history._misfit(name, told)
        assert far == pytest.approx(3.0, rel=1e-3), name
        assert near == pytest.approx(0.0, abs=1e-6) and unknown < 0.1 and np.isnan(nothing)


@pytest.mark.parametrize("sharpness", [1e-2, 1.0, 1e4])
@pytest.mark.parametrize("overdispersion", [1.0, 9.0])
def test_a_healthy_frames_misfit_is_about_one(sharpness: float, overdispersion: float) -> None:
    """Test: coefficients drawn from the unit's prior, vectors with errors as large as the information says,
    or as the baseline's stretches scatter. Expected: mean square one, within four standard errors of 3 %."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(5)
    history = BalanceHistory(unit, {name: first_effects(name) for name in BALANCES})
    e = history.effects["reservoir"]
    usual = np.hypot(e.wander, np.sqrt(np.diag(e.covariance)))
    m = np.diag(sharpness / usual**2)
    history.effects["reservoir"] = replace(e, information=m, scatter=overdispersion * m)
    wanders, errs = rng.normal(size=(2, 500, usual.size))
    off = usual * wanders + errs / np.sqrt(np.diag(m))
    frames = [NormalEquations(m, m @ (e.mean + np.sqrt(overdispersion) * d), 30.0, 1.0) for d in off]
    assert np.mean(np.square(history._misfit("reservoir", frames))) == pytest.approx(1.0, abs=0.12)


def test_misfits_are_told_at_the_ends_of_frames() -> None:
    unit = Unit.load("axis_a")
    rows = np.full((3 * FRAME_BINS, len(COLUMNS)), np.nan)
    history = BalanceHistory(unit, {name: first_effects(name) for name in BALANCES})
    assert [len(x) for x in history.misfits()] == [0, 0, 0]
    history.push(40, rows)
    ends, names, values = history.misfits()
    np.testing.assert_allclose(ends, [20.5, 21.0, 21.5])
    assert names == [] and values.shape == (3, 0), "no balance said anything"


@pytest.mark.parametrize(("rho", "worth"), [(0.0, 1.0), (0.5, 3.0), (0.8, 9.0)])
def test_rows_that_hang_together_are_worth_fewer(rho: float, worth: float) -> None:
    """A mean of n errors of a first-order autoregression varies by (1 + rho) / (1 - rho) of σ² / n."""
    rng, regression = (
        np.random.default_rng(14),
        RegressionAccumulator(BALANCES["force"], first_effects("force")),
    )
    n, sigma, found = regression.size, 40.0, []
    for _ in range(60):
        error = np.zeros(FRAME_BINS)
        for k in range(FRAME_BINS):
            before = error[k - 1] if k else rng.normal() * sigma
            error[k] = rho * before + np.sqrt(1.0 - rho**2) * sigma * rng.normal()
        x = rng.normal(size=(FRAME_BINS, n))
        found.append(regression._coloured(np.column_stack([x, 100.0 * x.sum(axis=1) + error])))
    assert np.median(found[20:]) == pytest.approx(worth * sigma**2, rel=0.2)
    assert len(regression.recent) == 20, "ten seconds of them"
    assert regression._coloured(np.zeros((FRAME_BINS, n + 1))) >= regression.least > 0.0


def test_state_goes_on_with_the_same_frames() -> None:
    """Every part of an regression that a later frame depends on is in the state."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(11)
    effects: dict[str, Effects] = {name: first_effects(name) for name in BALANCES}
    one, other = BalanceHistory(unit, effects), BalanceHistory(unit, effects)

    def feed(history: BalanceHistory, seed: int) -> None:
        rng = np.random.default_rng(seed)
        for name, balance in BALANCES.items():
            for _ in range(4):
                y, x, ok = of_frame(rng, _design(name))
                history.equations[name] += history.regressions[name].equations([RegressionBlock(y, x, ok)])
            assert balance.name == name
        history.frames += [len(history.frames) + k for k in range(4)]

    feed(one, int(rng.integers(1000)))
    other.restore(one.state())
    feed(one, 99)
    feed(other, 99)
    for name in BALANCES:
        for a, b in zip(one.sums()[name], other.sums()[name], strict=True):
            np.testing.assert_array_equal(a, b, err_msg=name)


def test_a_reference_that_older_frames_made_goes_on_with_the_state() -> None:
    one, other = told_of(40), told_of(0)
    one.fold(20)
    other.restore({k: np.array(v) for k, v in one.state().items()})
    assert (other.frames, other.folded, other.taken, other.last) == (one.frames, 16, one.taken, one.last)
    for name, e in one.reference.items():
        np.testing.assert_array_equal(other.reference[name].mean, e.mean)
        np.testing.assert_array_equal(other.reference[name].covariance, e.covariance)
        assert (e.mean != one.effects[name].mean).any(), name
        for a, b in zip(one.marginalised()[name], other.marginalised()[name], strict=True):
            np.testing.assert_array_equal(a, b)


def _design(name: str) -> int:
    return 8 if name == "shaft" else len(BALANCES[name].columns)
