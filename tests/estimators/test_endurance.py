"""Ten million steps with worst-case scaling: covariances of the Joseph form stay symmetric and positive.

Each case is run in compiled code, in raw units over 24 decades, with masks that change at every
step and blind stretches; the covariance is looked at every 5000 steps. Cases that a covariance in double
precision cannot hold show where it ends.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from consistent_axis import njit

from estimators.kernels import kalman_update, predict_covariance

STEPS = 10_000_000
EVERY = 5000
UNITS = np.array([1e-12, 1.0, 1e12, 1e-4])
CHAIN = np.array([[1, 0.1, 0, 0], [0, 1, 0.1, 0], [0, 0, 0.99, 0], [0, 0, 0, 1.0]])
UNSTABLE = np.array([[1.05, 0.1, 0, 0], [0, 1.02, 0.1, 0], [0, 0, 0.99, 0], [0, 0, 0, 1.0]])
SINGLE = [[1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]]
SUMS = [[1, 1, 0, 0], [1, -1, 1, 0], [0, 1, 1, 1]]
MIXED = [[1, 0, 0, 0], [0, 1, 1, 0], [1, 0, 1, 0]]
SMALL_NOISE = [1e-10, 1e-8, 1e-6, 1e-9]


@dataclass(frozen=True)
class Case:
    """A problem in balanced units; ``joseph``: no update shrinks a variance by 1e13 or more."""

    F: np.ndarray
    Q: list[float]
    H: list[list[float]]
    R: list[float]
    P: float
    joseph: bool
    units: np.ndarray = field(default_factory=lambda: UNITS)

    def in_raw_units(self) -> tuple[np.ndarray, ...]:
        u = self.units
        F = np.ascontiguousarray(self.F * u[:, None] / u)
        return F, np.array(self.Q) * u**2, np.array(self.H) / u, np.array(self.R), np.diag(self.P * u**2)


CASES = {
    # The last state of CHAIN and of UNSTABLE is seen by no channel of SINGLE: it wanders, or stays.
    "units": Case(CHAIN, SMALL_NOISE, SINGLE, [1e-6, 1e12, 1.0], 1e4, True),
    "perfect and useless": Case(CHAIN, SMALL_NOISE, SINGLE, [1e-24, 1e24, 1.0], 1.0, True),
    "no process noise": Case(np.eye(4), [0.0] * 4, MIXED, [1e-6, 1.0, 1e12], 1e4, True),
    "unstable": Case(UNSTABLE, [1e-6] * 4, MIXED, [1e-12, 1.0, 1e12], 1e4, True),
    "useless alone": Case(UNSTABLE, [1e-6] * 4, [[1, 0, 0, 0], [0, 1, 0, 0]], [1e6, 1e6], 1e4, True),
    "diffuse": Case(CHAIN, SMALL_NOISE, SINGLE, [1e-24, 1e24, 1.0], 1e12, False),
    "perfect sums": Case(CHAIN, SMALL_NOISE, SUMS, [1e-24, 1e24, 1e-24], 1e12, False),
}
JOSEPH = {name: case for name, case in CASES.items() if case.joseph}


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
    x, y, mask = np.zeros(n), np.zeros(m), np.empty(m, np.bool_)
    kept = np.empty((steps // every, n, n))
    blind = 0
    for i in range(steps):
        predict_covariance(P, F, Q, P)
        blind = _channels(rng, blind, mask)
        kalman_update(x, P, y, H, R, mask)
        if i % every == every - 1:
            kept[i // every] = P
    return kept


def lowest_eigenvalues(kept: np.ndarray) -> np.ndarray:
    """Least eigenvalue of each covariance as a correlation matrix, so that units do not hide it."""
    np.testing.assert_array_equal(kept, np.swapaxes(kept, 1, 2))
    assert np.isfinite(kept).all()
    variance = np.diagonal(kept, axis1=1, axis2=2)
    assert (variance > 0.0).all()
    scale = np.sqrt(variance)
    return np.linalg.eigvalsh(kept / (scale[:, :, None] * scale[:, None, :]))[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize("name", JOSEPH)
def test_joseph_form_endures(name: str) -> None:
    case = JOSEPH[name]
    kept = endure_joseph(STEPS // len(JOSEPH), EVERY, *case.in_raw_units(), np.random.default_rng(1))
    assert lowest_eigenvalues(kept).min() > 1e-12
