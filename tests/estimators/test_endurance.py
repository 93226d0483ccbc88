"""Ten million steps with worst-case scaling: covariances of the Joseph form stay symmetric and positive.

Each case is run in compiled code, in raw units over 24 decades, with masks that change at every step and
blind stretches; no update shrinks a variance by 1e13 or more. The covariance is looked at every 5000 steps.
"""

from pathlib import Path

import numpy as np
import pytest

import estimators
from estimators.compiled import compiler
from estimators.kernels import kalman_update_correlated
from estimators.linalg import symmetrise

njit = compiler(Path(estimators.__file__).parent, Path(__file__).parent)
STEPS = 10_000_000
EVERY = 5000
UNITS = np.array([1e-12, 1.0, 1e12, 1e-4])
CHAIN = np.array([[1, 0.1, 0, 0], [0, 1, 0.1, 0], [0, 0, 0.99, 0], [0, 0, 0, 1.0]])
UNSTABLE = np.array([[1.05, 0.1, 0, 0], [0, 1.02, 0.1, 0], [0, 0, 0.99, 0], [0, 0, 0, 1.0]])
SINGLE = [[1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]]
MIXED = [[1, 0, 0, 0], [0, 1, 1, 0], [1, 0, 1, 0]]
SMALL_NOISE = [1e-10, 1e-8, 1e-6, 1e-9]
# F, Q, H, R and P in balanced units. The last state of CHAIN and of UNSTABLE is seen by no channel of SINGLE.
CASES = {
    "units": (CHAIN, SMALL_NOISE, SINGLE, [1e-6, 1e12, 1.0], 1e4),
    "perfect and useless": (CHAIN, SMALL_NOISE, SINGLE, [1e-24, 1e24, 1.0], 1.0),
    "no process noise": (np.eye(4), [0.0] * 4, MIXED, [1e-6, 1.0, 1e12], 1e4),
    "unstable": (UNSTABLE, [1e-6] * 4, MIXED, [1e-12, 1.0, 1e12], 1e4),
    "useless alone": (UNSTABLE, [1e-6] * 4, [[1, 0, 0, 0], [0, 1, 0, 0]], [1e6, 1e6], 1e4),
}


@njit()
def _channels(rng, blind, mask):
    """Draw the channels of a step: all missing for up to 100 steps now and then, else 7 in 10 are there."""
    if blind > 0:
        blind -= 1
    elif rng.random() < 0.002:
        blind = rng.integers(0, 100)
    for c in range(mask.shape[0]):
        mask[c] = blind == 0 and rng.random() < 0.7
    return blind


@njit()
def endure_joseph(steps, every, F, Q, H, R, P, rng):
    """Covariances (steps // every, n, n) along a run of the Joseph form."""
    n, m = P.shape[0], H.shape[0]
    x, y, mask, K = np.zeros(n), np.zeros(m), np.empty(m, np.bool_), np.empty((n, m))
    kept = np.empty((steps // every, n, n))
    blind = 0
    for i in range(steps):
        P[:] = F @ P @ F.T + Q
        symmetrise(P)
        blind = _channels(rng, blind, mask)
        kalman_update_correlated(x, P, y, H, R, mask, K)
        if i % every == every - 1:
            kept[i // every] = P
    return kept


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_joseph_form_endures(name: str) -> None:
    F, Q, H, R, P = CASES[name]
    raw = np.ascontiguousarray(F * UNITS[:, None] / UNITS), np.diag(Q * UNITS**2), np.array(H) / UNITS
    rng, prior = np.random.default_rng(1), np.diag(P * UNITS**2)
    kept = endure_joseph(STEPS // len(CASES), EVERY, *raw, np.diag(R), prior, rng)
    np.testing.assert_array_equal(kept, np.swapaxes(kept, 1, 2))
    assert np.isfinite(kept).all()
    variance = np.diagonal(kept, axis1=1, axis2=2)
    assert (variance > 0.0).all()
    scale = np.sqrt(variance)
    # As correlations, so that units do not hide the least eigenvalue.
    lowest = np.linalg.eigvalsh(kept / (scale[:, :, None] * scale[:, None, :]))[:, 0]
    assert lowest.min() > 1e-12
