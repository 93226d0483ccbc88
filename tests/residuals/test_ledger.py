"""The ledger's algebra against textbook forms, quadrature and least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from fdd.residuals.balances import BALANCES, ORDERS, Strand
from fdd.residuals.effects import Effects, first_effects
from fdd.residuals.ledger import LOAD_S, Account, Entry, Ledger, calibration, widened
from fdd.residuals.rows import HOP_ROWS, HOP_S, ROW_S, TAIL_ROWS
from fdd.unit import Unit

Array = NDArray[np.float64]
ROWS = TAIL_ROWS + HOP_ROWS


def regular(rng: np.random.Generator, n: int) -> Array:
    root = rng.normal(size=(2 * n, n)) * 10.0 ** rng.uniform(-2.0, 2.0, n)
    return np.asarray(root.T @ root)


@pytest.mark.parametrize("n", [1, 3, 7])
def test_widened_is_the_textbook_form_where_the_information_is_regular(n: int) -> None:
    rng = np.random.default_rng(n)
    m, std = regular(rng, n), 10.0 ** rng.uniform(-2.0, 1.0, n)
    vector = m @ rng.normal(size=n)
    wide, kept = widened(m, vector, std)
    expected = np.linalg.inv(np.linalg.inv(m) + np.diag(std**2))
    np.testing.assert_allclose(wide, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(
        kept, expected @ np.linalg.solve(m, vector), rtol=1e-6, atol=1e-9 * np.abs(kept).max()
    )


def test_widened_marginalises_the_difference() -> None:
    """The log-likelihood, with the difference integrated out by quadrature, is the parabola that it gives."""
    m, vector, std = np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([1.5, -0.7]), np.array([0.6, 0.9])
    wide, kept = widened(m, vector, std)
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    d = np.stack(np.meshgrid(nodes * std[0], nodes * std[1], indexing="ij"), axis=-1).reshape(-1, 2)
    w = np.outer(weights, weights).ravel()

    def integrated(c: Array) -> float:
        b = c + d
        return float(np.log(w @ np.exp(b @ vector - 0.5 * np.einsum("ki,ij,kj->k", b, m, b))))

    for c in np.random.default_rng(1).uniform(-1.0, 1.0, (20, 2)):
        parabola = kept @ c - 0.5 * c @ wide @ c
        assert integrated(c) - integrated(np.zeros(2)) == pytest.approx(parabola, abs=1e-8)


def test_widened_of_what_tells_nothing_tells_nothing() -> None:
    column = np.array([1.0, -2.0, 0.5])
    wide, kept = widened(np.outer(column, column), 3.0 * column, np.array([1e-3, 10.0, 1.0]))
    across = np.array([2.0, 1.0, 0.0])
    assert across @ wide @ across == pytest.approx(0.0, abs=1e-12)
    assert across @ kept == pytest.approx(0.0, abs=1e-12)
    # Along the one thing that is known, the scalar form: variance 1 and that of the difference.
    variance = 1.0 + float(column**2 @ np.array([1e-3, 10.0, 1.0]) ** 2)
    np.testing.assert_allclose(wide, np.outer(column, column) / variance, rtol=1e-6, atol=1e-12)
    blank, none = widened(np.zeros((4, 3, 3)), np.zeros((4, 3)), np.ones(3))
    assert not blank.any() and not none.any()


def of_hop(rng: np.random.Generator, n: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    x = rng.normal(size=(ROWS, n)) * np.arange(1, n + 1)
    return x @ rng.normal(size=n) + 0.1 * rng.normal(size=ROWS), x, np.ones(ROWS, dtype=bool)


def least_squares(information: Array, vector: Array) -> Array:
    return np.asarray(np.linalg.solve(information, vector))


@pytest.mark.parametrize("name", ["coherence", "refeed"])
def test_a_hop_of_plain_rows_is_least_squares(name: str) -> None:
    balance, rng = BALANCES[name], np.random.default_rng(4)
    y, x, ok = of_hop(rng, len(balance.columns))
    ok[TAIL_ROWS + 5 : TAIL_ROWS + 12] = False
    information, vector, rows, variance = Account(balance, first_effects(name)).hop([Strand(y, x, ok)])
    x, y = x[TAIL_ROWS:][ok[TAIL_ROWS:]], y[TAIL_ROWS:][ok[TAIL_ROWS:]]
    expected, rest, *_ = np.linalg.lstsq(x, y, rcond=None)
    assert rows == len(y) == HOP_ROWS - 7
    np.testing.assert_allclose(least_squares(information, vector), expected, rtol=1e-8)
    np.testing.assert_allclose(information, x.T @ x / variance, rtol=1e-9, atol=1e-9 * information.max())
    assert variance >= 0.99 * rest[0] / (len(y) - x.shape[1])


@pytest.mark.parametrize("name", ["torque", "reservoir"])
def test_a_hop_of_changes_is_least_squares_on_levels(name: str) -> None:
    """Each unbroken stretch has a level of its own: a dummy of least squares takes its mean out."""
    balance, rng = BALANCES[name], np.random.default_rng(5)
    n = len(balance.columns)
    y, x, ok = of_hop(rng, n)
    ok[TAIL_ROWS + 20] = False
    information, vector, _, _ = Account(balance, first_effects(name)).hop([Strand(y, x, ok)])
    stretches = [slice(TAIL_ROWS, TAIL_ROWS + 20), slice(TAIL_ROWS + 21, ROWS)]
    levels_x = [np.cumsum(x[s], axis=0) for s in stretches]
    levels_y = [np.cumsum(y[s]) for s in stretches]
    dummies = np.repeat(np.eye(2), [len(v) for v in levels_y], axis=0)
    design, aim = np.column_stack([np.concatenate(levels_x), dummies]), np.concatenate(levels_y)
    expected = np.linalg.lstsq(design, aim, rcond=None)[0][:n]
    # The first row of a stretch, which its mean makes redundant, is left out: a few per cent of the rows.
    np.testing.assert_allclose(least_squares(information, vector), expected, atol=0.05)


def test_a_hop_of_cells_is_least_squares_on_their_means_over_the_load_before() -> None:
    balance, rng = BALANCES["force"], np.random.default_rng(6)
    n, cell = len(balance.columns), BALANCES["force"].cell
    y, x, ok = of_hop(rng, n)
    y, x = np.cumsum(y), np.cumsum(x, axis=0)
    ok[TAIL_ROWS + 13] = False
    account = Account(balance, first_effects("force"))
    information, vector, rows, _ = account.hop([Strand(y, x, ok)])
    means = np.column_stack([x, y])[TAIL_ROWS:].reshape(-1, cell, n + 1).mean(axis=1)
    means = np.delete(means, 13 // cell, axis=0)
    before = pd.DataFrame(means).ewm(alpha=cell * ROW_S / LOAD_S, adjust=False).mean().shift(1)
    over = (means - before.to_numpy())[1:]
    expected = np.linalg.lstsq(over[:, :n], over[:, n], rcond=None)[0]
    assert rows == HOP_ROWS // cell - 1
    np.testing.assert_allclose(least_squares(information, vector), expected, rtol=1e-5)


@pytest.mark.parametrize("swing", [0.6, 0.0])
def test_a_line_has_its_amplitude_whatever_its_phase(swing: float) -> None:
    balance, rng = BALANCES["shaft"], np.random.default_rng(7)
    found = []
    for phase in np.linspace(0.0, 6.0, 7):
        account = Account(balance, first_effects("shaft"))
        k = np.arange(20 * HOP_ROWS + TAIL_ROWS)
        angle = 0.8 * k + swing / 0.07 * np.sin(0.07 * k)
        lines = [turn(order * angle) for order in ORDERS for turn in (np.cos, np.sin)]
        x = np.column_stack([*lines, np.ones_like(angle), *rng.normal(size=(3, angle.size))])
        y = 0.2 * np.cos(angle + phase) + 0.05 * np.sin(2 * angle) + 0.3 + 0.01 * rng.normal(size=angle.size)
        for hop in range(20):
            here = slice(hop * HOP_ROWS, hop * HOP_ROWS + ROWS)
            information, vector, rows, _ = account.hop([Strand(y[here], x[here], np.ones(ROWS, dtype=bool))])
            assert rows
        found.append(least_squares(information, vector))
    np.testing.assert_allclose(found, np.tile([0.2, 0.05], (7, 1)), atol=0.015)


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
def test_noise_in_a_column_draws_its_coefficient_no_nearer_to_zero(share: float) -> None:
    """A pressure with noise in compliance and sensor lag."""
    balance, rng, hops = BALANCES["volume"], np.random.default_rng(11), 400
    n, noise = len(balance.columns), np.sqrt(share)
    compliance, lag = balance.columns.index("compliance"), balance.columns.index("sensor_lag")
    account, plain = (Account(balance, first_effects("volume")) for _ in range(2))
    told = np.zeros((ROWS, 2, n))
    told[:, 0, [compliance, lag]], told[:, 1, lag] = noise, -noise
    sums = {True: [np.zeros((n, n)), np.zeros(n)], False: [np.zeros((n, n)), np.zeros(n)]}
    for _ in range(hops):
        truth = np.cumsum(rng.normal(size=ROWS + 2)) * 0.3 + rng.normal(size=ROWS + 2)
        seen = truth + noise * rng.normal(size=truth.size)
        x = np.zeros((ROWS, n))
        x[:, compliance], x[:, lag] = np.diff(seen)[1:], np.diff(seen, 2)
        y = 0.9 * np.diff(truth)[1:] + 0.4 * np.diff(truth, 2) + np.diff(rng.normal(size=ROWS + 1))
        for known, of in ((True, account), (False, plain)):
            m, v, rows, variance = of.hop([Strand(y, x, np.ones(ROWS, dtype=bool), told if known else None)])
            assert rows
            sums[known][0] += m * variance
            sums[known][1] += v * variance
    pair = [compliance, lag]
    found, drawn = (least_squares(m[np.ix_(pair, pair)], v[pair]) for m, v in (sums[True], sums[False]))
    np.testing.assert_allclose(found, [0.9, 0.4], atol=0.06)
    assert np.abs(drawn - [0.9, 0.4]).max() > 0.02 + 0.2 * share, "else this shows nothing"


def test_a_column_that_noise_alone_moves_tells_nothing() -> None:
    """Of two columns that go together one is nothing but noise: the other is what is left of both."""
    gram = np.array([[50.0, 0.0, 3.0], [0.0, 20.0, 0.0], [3.0, 0.0, 7.0]])
    turn = calibration(gram, np.diag([50.0 - 9.0 / 7.0, 0.0, 0.0]))
    np.testing.assert_allclose(turn, [[0, 0, 0], [0, 1, 0], [3 / 7, 0, 1]], atol=1e-6)


def test_too_few_rows_say_nothing() -> None:
    balance, rng = BALANCES["coherence"], np.random.default_rng(8)
    y, x, ok = of_hop(rng, len(balance.columns))
    ok[:] = False
    ok[-5:] = True
    account = Account(balance, first_effects("coherence"))
    information, vector, rows, variance = account.hop([Strand(y, x, ok)])
    assert rows == 0.0 and not information.any() and not vector.any() and variance > 0.0


@pytest.mark.parametrize("within", [0.0, 0.3])
def test_fold_is_batch_regression(within: float) -> None:
    unit, rng = Unit.load("axis_a"), np.random.default_rng(10)
    effects = {name: first_effects(name) for name in BALANCES}
    effects = {n: replace(e, within=np.full(e.mean.size, within)) for n, e in effects.items()}
    ledger = Ledger(unit, effects)
    kept: dict[str, list[tuple[Array, Array]]] = {n: [] for n in BALANCES}
    count, window = 40, 20
    for h in range(count):
        ledger.hops.append(h + 7)
        for name, e in effects.items():
            n = e.mean.size
            x = rng.normal(size=(30, n)) / np.sqrt(np.diag(e.covariance))
            information, vector = x.T @ x, x.T @ (x @ e.mean + rng.normal(size=30))
            kept[name].append((information, vector))
            ledger.entries[name].append(Entry(information, vector, 30.0, 1.0))
    folded = ledger.fold(window)
    part = window // 5
    assert folded == ledger.folded and folded % part == 0 and count - folded <= window + part
    assert ledger.hops == [h + 7 for h in range(folded, count)]
    for name, e in effects.items():
        assert len(ledger.entries[name]) == count - folded
        # Batch: one stacked least squares of the prior and of each hop, a hop's own wander in its covariance.
        information, vector = np.linalg.inv(e.covariance), np.linalg.solve(e.covariance, e.mean)
        if within == 0.0:
            for m, v in kept[name][:folded]:
                hop = np.linalg.inv(np.linalg.inv(m) + np.diag(e.wander**2))
                information, vector = information + hop, vector + hop @ np.linalg.solve(m, v)
            reference = ledger.reference[name]
            std = np.sqrt(np.diag(np.linalg.inv(information)))
            np.testing.assert_allclose(
                reference.mean / std, np.linalg.solve(information, vector) / std, rtol=1e-6, atol=1e-6
            )
            np.testing.assert_allclose(
                reference.covariance, np.linalg.inv(information), rtol=1e-5, atol=1e-12
            )
        else:  # older hops tell where the unit was, not where it is
            assert (np.diag(ledger.reference[name].covariance) > within**2).all()


def test_what_came_since_a_fault_is_no_reference() -> None:
    """Of it the latest hops are kept, and some from before its onset, however long it stands."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(12)
    effects: dict[str, Effects] = {name: first_effects(name) for name in BALANCES}
    ledger, window, onset = Ledger(unit, effects), 20, 30
    healthy = {}
    for h in range(200):
        ledger.hops.append(h)
        for name, e in effects.items():
            x = rng.normal(size=(30, e.mean.size)) / np.sqrt(np.diag(e.covariance))
            ledger.entries[name].append(Entry(x.T @ x, x.T @ (x @ e.mean), 30.0, 1.0))
        ledger.fold(window, [(onset * HOP_S, np.inf)] if h >= onset else [])
        if h == onset + window:
            healthy = dict(ledger.reference)
    before = [h for h in ledger.hops if h < onset]
    assert before == list(range(onset - window // 5, onset))
    assert ledger.hops[-1] == 199 and len(ledger.hops) <= window + window // 5
    assert ledger.hops[len(before) :] == list(range(200 - len(ledger.hops) + len(before), 200))
    for name, e in ledger.reference.items():
        np.testing.assert_array_equal(e.mean, healthy[name].mean)
    assert ledger.folded == onset - window // 5
    # Once it is over, what is healthy is learnt again, and what was not is left out.
    for h in range(200, 260):
        ledger.hops.append(h)
        for name in effects:
            ledger.entries[name].append(ledger.entries[name][-1])
        ledger.fold(window, [(onset * HOP_S, 200 * HOP_S)])
    assert min(ledger.hops) >= 200 and ledger.folded > onset


def test_state_goes_on_with_the_same_hops() -> None:
    """Every part of an account that a later hop depends on is in the state."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(11)
    effects: dict[str, Effects] = {name: first_effects(name) for name in BALANCES}
    one, other = Ledger(unit, effects), Ledger(unit, effects)

    def feed(ledger: Ledger, seed: int) -> None:
        rng = np.random.default_rng(seed)
        for name, balance in BALANCES.items():
            for _ in range(4):
                y, x, ok = of_hop(rng, _design(name))
                ledger.entries[name].append(ledger.accounts[name].hop([Strand(y, x, ok)]))
            assert balance.name == name
        ledger.hops += [len(ledger.hops) + k for k in range(4)]

    feed(one, int(rng.integers(1000)))
    other.restore(one.state())
    feed(one, 99)
    feed(other, 99)
    for name in BALANCES:
        for a, b in zip(one.sums()[name], other.sums()[name], strict=True):
            np.testing.assert_array_equal(a, b, err_msg=name)


def _design(name: str) -> int:
    return 8 if name == "shaft" else len(BALANCES[name].columns)
