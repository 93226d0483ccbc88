"""Bounds of the EHA model's parameters: the projection against a constrained minimiser."""

from __future__ import annotations

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from estimators.eha import model as eha
from estimators.eha.bounds import HIGHEST, LOWEST, keep_in_bounds

PARAMETERS = slice(eha.LEAK, eha.STATES)
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
