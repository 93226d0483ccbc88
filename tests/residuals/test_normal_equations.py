"""Normal equations of frames against textbook forms, quadrature and least squares."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from fdd.residuals.balances import BALANCES, ORDERS, RegressionBlock
from fdd.residuals.bins import BIN_S, FRAME_BINS, TAIL_BINS
from fdd.residuals.effects import first_effects
from fdd.residuals.normal_equations import LOAD_S, RegressionAccumulator, marginalised

ROWS = TAIL_BINS + FRAME_BINS


@pytest.mark.parametrize("n", [1, 3, 7])
def test_marginalised_is_the_textbook_form_where_the_information_is_regular(n: int) -> None:
    rng = np.random.default_rng(n)
    root = rng.normal(size=(2 * n, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n)
    m, std = root.T @ root, 10.0 ** rng.uniform(-2.0, 1.0, n)
    vector = m @ rng.normal(size=n)
    wide, kept = marginalised(m, vector, std)
    expected = np.linalg.inv(np.linalg.inv(m) + np.diag(std**2))
    np.testing.assert_allclose(wide, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    right = expected @ np.linalg.solve(m, vector)
    np.testing.assert_allclose(kept, right, rtol=1e-6, atol=1e-9 * np.abs(kept).max())


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


def of_frame(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x = rng.normal(size=(ROWS, n)) * np.arange(1, n + 1)
    return x @ rng.normal(size=n) + 0.1 * rng.normal(size=ROWS), x, np.ones(ROWS, dtype=bool)


@pytest.mark.parametrize("name", ["coherence", "refeed"])
def test_a_frame_of_plain_rows_is_least_squares(name: str) -> None:
    balance, rng = BALANCES[name], np.random.default_rng(4)
    y, x, ok = of_frame(rng, len(balance.columns))
    ok[TAIL_BINS + 5 : TAIL_BINS + 12] = False
    regression = RegressionAccumulator(balance, first_effects(name))
    [(information, vector, rows, variance)] = regression.equations([RegressionBlock(y, x, ok)])
    x, y = x[TAIL_BINS:][ok[TAIL_BINS:]], y[TAIL_BINS:][ok[TAIL_BINS:]]
    expected, rest, *_ = np.linalg.lstsq(x, y, rcond=None)
    assert rows == len(y) == FRAME_BINS - 7
    np.testing.assert_allclose(np.linalg.solve(information, vector), expected, rtol=1e-8)
    np.testing.assert_allclose(information, x.T @ x / variance, rtol=1e-9, atol=1e-9 * information.max())
    assert variance >= 0.99 * rest[0] / (len(y) - x.shape[1])


@pytest.mark.parametrize("name", ["torque", "reservoir"])
def test_a_frame_of_changes_is_least_squares_on_levels(name: str) -> None:
    """Each unbroken stretch has a level of its own: a dummy of least squares takes its mean out."""
    balance, rng = BALANCES[name], np.random.default_rng(5)
    n = len(balance.columns)
    y, x, ok = of_frame(rng, n)
    ok[TAIL_BINS + 20] = False
    regression = RegressionAccumulator(balance, first_effects(name))
    [(information, vector, _, _)] = regression.equations([RegressionBlock(y, x, ok)])
    stretches = [slice(TAIL_BINS, TAIL_BINS + 20), slice(TAIL_BINS + 21, ROWS)]
    levels_x = [np.cumsum(x[s], axis=0) for s in stretches]
    levels_y = [np.cumsum(y[s]) for s in stretches]
    dummies = np.repeat(np.eye(2), [len(v) for v in levels_y], axis=0)
    design, aim = np.column_stack([np.concatenate(levels_x), dummies]), np.concatenate(levels_y)
    expected = np.linalg.lstsq(design, aim, rcond=None)[0][:n]
    # The first row of a stretch, which its mean makes redundant, is left out: a few per cent of the rows.
    np.testing.assert_allclose(np.linalg.solve(information, vector), expected, atol=0.05)


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


def line_amplitudes(y, angle):
    """Amplitudes (frames, 2) that the shaft's balance finds in a current over a shaft's angle."""
    rng = np.random.default_rng(8)
    lines = [turn(order * angle) for order in ORDERS for turn in (np.cos, np.sin)]
    x = np.column_stack([*lines, np.ones_like(angle), *rng.normal(size=(2, angle.size)), np.ones_like(angle)])
    regression, found = RegressionAccumulator(BALANCES["shaft"], first_effects("shaft")), []
    for start in range(0, angle.size - ROWS + 1, FRAME_BINS):
        here = slice(start, start + ROWS)
        block = RegressionBlock(y[here], x[here], np.ones(ROWS, dtype=bool))
        [(information, vector, rows, _)] = regression.equations([block])
        found += [np.linalg.solve(information, vector)] if rows else []
    return np.array(found)


@pytest.mark.parametrize("swing", [0.6, 0.0])
@pytest.mark.parametrize("phase", np.linspace(0.0, 6.0, 7))
def test_a_line_has_its_amplitude_whatever_its_phase(swing: float, phase: float) -> None:
    k = np.arange(40 * FRAME_BINS + TAIL_BINS)
    angle = 0.8 * k + swing / 0.07 * np.sin(0.07 * k)
    noise = 0.03 * np.random.default_rng(7).normal(size=k.size)
    y = 0.2 * np.cos(angle + phase) + 0.05 * np.sin(2 * angle) + 0.3 + noise
    found = line_amplitudes(y, angle)
    np.testing.assert_allclose(found.mean(axis=0), [0.2, 0.05], atol=0.006)


def test_a_vibration_of_another_frequency_is_no_line() -> None:
    """A stick-slip oscillation near twice a turn keeps no phase to the shaft; its modulus is not zero."""
    k = np.arange(400 * FRAME_BINS + TAIL_BINS)
    beat = np.cumsum(np.random.default_rng(9).normal(scale=0.3, size=k.size))
    found = line_amplitudes(0.1 * np.cos(1.65 * k + beat) + 0.3, 0.8 * k)
    assert np.abs(found[:, 1]).mean() > 0.03, "else this shows nothing"
    assert found[:, 1].mean() < 0.006


def test_a_lost_count_of_the_encoder_costs_a_line_a_few_frames() -> None:
    k = np.arange(80 * FRAME_BINS + TAIL_BINS)
    angle, slipped = 0.8 * k, 0.8 * k + 2.0 * (k > 40 * FRAME_BINS)
    found = line_amplitudes(0.2 * np.cos(angle) + 0.3, slipped)
    assert found[41:70, 0].min() < 0.1
    np.testing.assert_allclose(found[70:, 0], 0.2, atol=0.02)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_noise_in_a_column_takes_nothing_from_a_healthy_units_coefficient(share: float) -> None:
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
            block = RegressionBlock(y, x, np.ones(ROWS, dtype=bool), told if known else None)
            [(m, v, rows, variance)] = of.equations([block])
            assert rows
            sums[known][0] += m * variance
            sums[known][1] += v * variance
    pair = [compliance, lag]
    found, drawn = (np.linalg.solve(m[np.ix_(pair, pair)], v[pair]) for m, v in (sums[True], sums[False]))
    np.testing.assert_allclose(found, [0.9, 0.4], atol=0.06)
    assert np.abs(drawn - [0.9, 0.4]).max() > 0.02 + 0.2 * share, "else this shows nothing"


def test_a_machine_that_stood_has_the_noise_of_the_last_ten_seconds_alone() -> None:
    """Friction that changed while it stood is no noise of the strokes after it."""
    balance, rng, frames = BALANCES["force"], np.random.default_rng(12), 64
    regression = RegressionAccumulator(balance, first_effects("force"))
    x = np.zeros((TAIL_BINS + frames * FRAME_BINS, len(balance.columns)))
    x[:, 0] = 1.0
    forth = np.arange(len(x)) // 20 % 2 == 0
    x[:, -2], x[:, -1] = forth, -1.0 * ~forth
    moves = (np.arange(len(x)) // FRAME_BINS % 32) < 12
    loose = np.arange(len(x)) // FRAME_BINS >= 32
    y = np.where(loose, 0.3, 1.0) * x[:, -2:].sum(axis=1) + 0.05 * rng.normal(size=len(x))
    found = [e for e in regression.equations([RegressionBlock(y, x, moves)]) if e.rows]
    before, after = found[len(found) // 2 - 1], found[-1]
    assert len(found) >= 22 and after.variance < 2.0 * before.variance


def test_noise_of_an_axis_that_has_few_rows_for_days_stays_known() -> None:
    """Fewer rows in ten seconds than columns say nothing of it, however often."""
    balance, rng = BALANCES["force"], np.random.default_rng(1)
    regression = RegressionAccumulator(balance, first_effects("force"))
    weight, usual = regression.weight, regression.variance_sum
    n = TAIL_BINS + 4000 * FRAME_BINS
    x = rng.normal(size=(n, len(balance.columns)))
    moves = (np.arange(n) // FRAME_BINS % 40 == 0) & (np.arange(n) % FRAME_BINS < 20)
    assert sum(e.rows > 0 for e in regression.equations([RegressionBlock(x.sum(axis=1), x, moves)])) == 100
    assert (regression.weight, regression.variance_sum) == (weight, usual)
