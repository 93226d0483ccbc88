"""Bounds of the EHA model's parameters: the projection against a constrained minimiser."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from estimators.eha import model as eha
from estimators.eha.bounds import HIGHEST, LOWEST, keep_in_bounds

PARAMETERS = slice(eha.LEAK, eha.STATES)
COUNT = eha.STATES - eha.LEAK
# A typical spread of each parameter, so that the random covariances mean something.
SPREAD = np.array([0.3, 0.3, 0.3, 1.0, 1.0, 3e-3, 0.3, 100.0, 30.0, 1e3, 10.0, 1e5, 30.0, 0.02])


def healthy() -> eha.Array:
    x = np.zeros(eha.STATES)
    x[[eha.LEAK, eha.FRIC, eha.AIR]] = 1.0, 1.0, 3.0
    x[[eha.VALVE1, eha.VALVE2]] = 0.5
    return x


def covariance(rng: np.random.Generator) -> eha.Array:
    """Random correlations: in the first block of states, and in that of friction and load."""
    P = np.zeros((eha.STATES, eha.STATES))
    for block in (slice(0, eha.FRIC), slice(eha.FRIC, eha.STATES)):
        size = len(range(eha.STATES)[block])
        root = rng.standard_normal((size, size + 2))
        P[block, block] = root @ root.T / size
    scale = np.ones(eha.STATES)
    scale[PARAMETERS] = SPREAD
    return P * np.outer(scale, scale)


def most_probable(x: eha.Array, P: eha.Array) -> eha.Array:
    """The minimiser of (x' - x)' P⁻¹ (x' - x) within the bounds, by a bounded least squares solver."""
    scale = np.sqrt(np.diag(P))
    whitening = np.linalg.inv(np.linalg.cholesky(P / np.outer(scale, scale)))
    found = lsq_linear(
        whitening, whitening @ (x / scale), bounds=(LOWEST / scale, HIGHEST / scale), method="bvls", tol=1e-13
    )
    return found.x * scale


def kept(x: eha.Array, P: eha.Array) -> eha.Array:
    found, before = x.copy(), P.copy()
    keep_in_bounds(found, before)
    np.testing.assert_array_equal(before, P, err_msg="nothing was measured")
    return found


@given(st.integers(0, 2**32 - 1), st.sampled_from([eha.LEAK, eha.VALVE1, eha.VALVE2, eha.FRIC, eha.GAIN]))
def test_one_bound_is_met_at_the_most_probable_point(seed: int, state: int) -> None:
    rng = np.random.default_rng(seed)
    x, P = healthy(), covariance(rng)
    x[state] = LOWEST[state] - rng.uniform(0.0, 0.5) * np.sqrt(P[state, state])
    expected = most_probable(x, P)
    # With one bound at work; two are tested below.
    assume(np.count_nonzero((expected <= LOWEST + 1e-12) | (expected >= HIGHEST - 1e-12)) == 1)
    found = kept(x, P)
    np.testing.assert_allclose((found - expected)[PARAMETERS] / SPREAD, 0.0, atol=1e-7)
    # Motion is measured to a micrometre and stays.
    np.testing.assert_array_equal(found[: eha.LEAK], x[: eha.LEAK])


def test_what_a_negative_valve_gave_to_the_leakage_is_taken_back() -> None:
    """While only the sum of the two is known, a valve at -0.2 is a leakage that reads 0.2 too high."""
    x, P = healthy(), np.diag(np.full(eha.STATES, 1e-6))
    x[[eha.LEAK, eha.VALVE1]] = 1.2, -0.2
    P[eha.LEAK, eha.LEAK] = P[eha.VALVE1, eha.VALVE1] = 0.25
    P[eha.LEAK, eha.VALVE1] = P[eha.VALVE1, eha.LEAK] = -0.25 * 0.9999
    found = kept(x, P)
    assert found[eha.VALVE1] == 0.0
    assert abs(found[eha.LEAK] - 1.0) < 1e-4


@given(st.integers(0, 2**32 - 1))
def test_several_bounds_are_all_kept(seed: int) -> None:
    """Also where one correction breaks the next bound, and where a state has no variance at all."""
    rng = np.random.default_rng(seed)
    x, P = healthy(), covariance(rng)
    x[PARAMETERS] += 3.0 * SPREAD * rng.standard_normal(COUNT)
    fixed = rng.integers(eha.LEAK, eha.STATES)
    P[fixed, :] = P[:, fixed] = 0.0
    found = kept(x, P)
    assert np.isfinite(found).all()
    assert (found >= LOWEST).all() and (found <= HIGHEST).all()
    if LOWEST[fixed] <= x[fixed] <= HIGHEST[fixed]:
        assert found[fixed] == x[fixed]
    np.testing.assert_array_equal(kept(found, P), found, err_msg="once is enough")


def test_two_bounds_at_once_are_met_near_the_most_probable_point() -> None:
    """One after the other is not the joint minimiser, but no farther from it than what had to be moved.

    In the filter a bound is passed by a small part of a standard deviation per sample, so that two at once
    are rare and the next sample sets right what is left.
    """
    rng = np.random.default_rng(7)
    excess = []
    for _ in range(300):
        x, P = healthy(), covariance(rng)
        x[[eha.VALVE1, eha.VALVE2]] = -rng.uniform(0.0, 0.02, 2)
        expected, found = most_probable(x, P), kept(x, P)
        inverse = np.linalg.inv(P[PARAMETERS, PARAMETERS])
        costs = [(d := (y - x)[PARAMETERS]) @ inverse @ d for y in (expected, found)]
        assert costs[1] > costs[0] * (1.0 - 1e-6), "none is more probable than the minimiser"
        excess.append((found - expected)[PARAMETERS] / SPREAD)
    assert np.quantile(np.abs(excess).max(axis=1), 0.9) < 0.1
