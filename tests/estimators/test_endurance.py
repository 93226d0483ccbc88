"""Ten million steps with worst-case scaling: covariances stay symmetric and positive.

Each case is run in compiled code, in raw units over 24 decades, with masks that change at every
step and blind stretches; the covariance is looked at every 5000 steps. The factors are run through
all cases; the Joseph form through those that a covariance in double precision can hold at all, and
one test shows where it cannot. How far each can be trusted is measured against exact rationals.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
import pytest
from consistent_axis import njit
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from estimators import ExtendedKalmanFilter
from estimators.kernels import kalman_update, predict_covariance
from estimators.square_root import ud_covariance, ud_factors, ud_predict, ud_transform, ud_update

STEPS = 10_000_000
EVERY = 5000
UNITS = np.array([1e-12, 1.0, 1e12, 1e-4])
CHAIN = np.array([[1, 0.1, 0, 0], [0, 1, 0.1, 0], [0, 0, 0.99, 0], [0, 0, 0, 1.0]])
UNSTABLE = np.array([[1.05, 0.1, 0, 0], [0, 1.02, 0.1, 0], [0, 0, 0.99, 0], [0, 0, 0, 1.0]])
COMMON = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1], [0, 0, 0, 1.0]])
SINGLE = [[1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0]]
SUMS = [[1, 1, 0, 0], [1, -1, 1, 0], [0, 1, 1, 1]]
MIXED = [[1, 0, 0, 0], [0, 1, 1, 0], [1, 0, 1, 0]]
ALIKE = [[1, 1, 0, 0], [1, 1, 1e-6, 0], [1, 1, 0, 0]]
DIFFERENCES = [[1, -1, 0, 0], [0, 1, -1, 0], [1, 0, -1, 0]]
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
    "perfect sums, static": Case(np.eye(4), [0.0] * 4, SUMS, [1e-24, 1e24, 1e-24], 1e12, False),
    "sums alike": Case(np.eye(4), [1e-20] * 4, ALIKE, [1e-24, 1e-20, 1e24], 1e12, False),
    "unstable, perfect sum": Case(UNSTABLE, [1e-12] * 4, SUMS, [1e-24, 1e-6, 1e12], 1e12, False),
    "common drift": Case(COMMON, [1e-12] * 3 + [1e-3], DIFFERENCES, [1e-12, 1e-12, 1e12], 1.0, False),
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


@njit()
def endure_factors(steps, every, F, Q, H, R, P, rng):
    """Covariances along a run of the factors, and how often a D was not positive."""
    n, m = P.shape[0], H.shape[0]
    x, y, mask = np.zeros(n), np.zeros(m), np.empty(m, np.bool_)
    U, D = np.empty((n, n)), np.empty(n)
    ud_factors(P, U, D)
    kept = np.empty((steps // every, n, n))
    blind, bad = 0, 0
    for i in range(steps):
        ud_predict(U, D, F, Q)
        blind = _channels(rng, blind, mask)
        ud_update(x, U, D, y, H, R, mask)
        for j in range(n):
            if not 0.0 < D[j] < np.inf:
                bad += 1
        if i % every == every - 1:
            ud_covariance(U, D, P)
            kept[i // every] = P
    return kept, bad


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


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_factors_endure(name: str) -> None:
    """The covariance is its factors: D > 0 at every step is positive definite. Multiplied out it is
    rounded, and its least eigenvalue may be off by the rounding of n^2 elements."""
    case = CASES[name]
    kept, bad = endure_factors(STEPS // len(CASES), EVERY, *case.in_raw_units(), np.random.default_rng(1))
    assert bad == 0
    assert lowest_eigenvalues(kept).min() > -16.0 * np.finfo(float).eps


@pytest.mark.parametrize("name", JOSEPH)
def test_factors_and_joseph_form_agree(name: str) -> None:
    """To rounding of the factors: correlations to eps sqrt(P / R) of the most exact channel."""
    case, rngs = JOSEPH[name], [np.random.default_rng(2) for _ in range(2)]
    factors, _ = endure_factors(200_000, EVERY, *case.in_raw_units(), rngs[0])
    joseph = endure_joseph(200_000, EVERY, *case.in_raw_units(), rngs[1])
    variance = np.diagonal(joseph, axis1=1, axis2=2)
    both = np.sqrt(variance[:, :, None] * variance[:, None, :])
    exact = int(np.argmin(case.R))
    seen = np.array(case.H[exact]) != 0.0
    ratio = float((variance / case.units**2)[:, seen].max()) / case.R[exact]
    bound = 10.0 * np.finfo(float).eps * np.sqrt(ratio) + 1e-8
    assert np.abs((factors - joseph) / both).max() < bound < 1e-3


@pytest.mark.parametrize("name", ["diffuse", "perfect sums"])
def test_joseph_form_fails_where_a_variance_shrinks_by_more_than_its_digits(name: str) -> None:
    """Why there are factors: without this failure the cases above would prove nothing about them.

    Two perfect positions give the difference of two states known to 1e6, the speed, to 1e-4.
    """
    kept = endure_joseph(100_000, EVERY, *CASES[name].in_raw_units(), np.random.default_rng(1))
    assert (np.diagonal(kept, axis1=1, axis2=2) < 0.0).any()


def exact_updates(P: np.ndarray, H: np.ndarray, R: np.ndarray) -> list[list[Fraction]]:
    """Covariance after one update per channel, in rationals: no rounding."""
    n = len(P)
    A = [[Fraction(float(v)) for v in row] for row in P]
    for h, r in zip([[Fraction(float(v)) for v in row] for row in H], R, strict=True):
        Ph = [sum((A[i][j] * h[j] for j in range(n)), Fraction(0)) for i in range(n)]
        s = sum((h[i] * Ph[i] for i in range(n)), Fraction(float(r)))
        A = [[A[i][j] - Ph[i] * Ph[j] / s for j in range(n)] for i in range(n)]
    return A


def variance_along(h: np.ndarray, P: list[list[Fraction]]) -> Fraction:
    g = [Fraction(float(v)) for v in h]
    return sum((g[i] * P[i][j] * g[j] for i in range(len(g)) for j in range(len(g))), Fraction(0))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), decades=st.integers(4, 36))
def test_factors_resolve_twice_the_decades(seed: int, decades: int) -> None:
    """Three sums of states measured: the variance along the last, against exact rationals. The Joseph
    form has it to eps P, the factors to eps^2 P; both hold over up to 36 decades of P / R."""
    rng = np.random.default_rng(seed)
    H = rng.integers(1, 5, (3, 4)) * rng.choice([-1.0, 1.0], (3, 4))
    assume(np.linalg.svd(H, compute_uv=False)[-1] > 0.5)
    R, P = np.full(3, 10.0 ** (6 - decades)), 1e6 * np.eye(4)
    along = variance_along(H[2], exact_updates(P, H, R))
    U, D = np.empty((4, 4)), np.empty(4)
    ud_factors(P, U, D)
    ud_update(np.zeros(4), U, D, np.zeros(3), H, R, np.ones(3, bool))
    assert (D > 0.0).all()
    terms = [[[Fraction(U[i, k]) * Fraction(D[k]) * Fraction(U[j, k]) for k in range(4)] for j in range(4)]
             for i in range(4)]  # fmt: skip
    formed = [[sum(products, Fraction(0)) for products in row] for row in terms]
    error = abs(float(variance_along(H[2], formed) - along))
    eps = np.finfo(float).eps
    assert error <= 1e3 * (eps * float(along) + eps**2 * 1e6)
    assert error / float(along) < 1e-3 or decades > 24
    joseph = P.copy()
    kalman_update(np.zeros(4), joseph, np.zeros(3), H, R, np.ones(3, bool))
    rows = [[Fraction(v) for v in row] for row in joseph.tolist()]
    assert abs(float(variance_along(H[2], rows) - along)) <= 1e3 * eps * 1e6


def test_class_with_square_root_survives_what_the_class_without_does_not() -> None:
    F, Q, H, R, P = CASES["perfect sums"].in_raw_units()
    outcome = {}
    for root in (False, True):
        kf = ExtendedKalmanFilter(4, 3, square_root=root)
        kf.x, kf.P, kf.F, kf.Q, kf.H, kf.R = np.zeros(4), P, F, Q, H, R
        rng = np.random.default_rng(0)
        lowest = np.inf
        with np.errstate(all="ignore"):
            for _ in range(500):
                try:
                    kf.predict()
                    kf.update(np.zeros(3), mask=rng.random(3) < 0.7)
                except ValueError:  # a negative variance
                    lowest = -np.inf
                    break
                lowest = min(lowest, float((np.diag(kf.P) / UNITS**2).min()))
        outcome[root] = lowest
    assert outcome[False] < 0.0 < outcome[True]


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6), m=st.integers(1, 4), column=st.booleans())
def test_square_root_equals_joseph_where_both_are_good(seed: int, n: int, m: int, column: bool) -> None:
    """Full Q and R, missing channels, and a P that is set anew in mid-run."""
    rng = np.random.default_rng(seed)
    one, other = ExtendedKalmanFilter(n, m), ExtendedKalmanFilter(n, m, square_root=True)

    def covariance(size: int) -> np.ndarray:
        A = rng.normal(size=(size, size))
        return A @ A.T / size + 0.5 * np.eye(size)

    values = {"x": rng.normal(size=(n, 1) if column else n), "P": covariance(n), "Q": covariance(n)}
    values |= {"R": covariance(m), "H": rng.normal(size=(m, n)), "F": rng.normal(size=(n, n)) / n}
    for kf in (one, other):
        for name, value in values.items():
            setattr(kf, name, value.copy())
    again = covariance(n)
    for i in range(12):
        z = np.where(rng.random(m) < 0.7, rng.normal(size=m), np.nan)
        for kf in (one, other):
            if i == 6:
                kf.P = again.copy()
            kf.predict()
            kf.update(z)
        for name in ("x", "P", "K", "nis", "log_likelihood", "P_prior"):
            np.testing.assert_allclose(
                getattr(other, name), getattr(one, name), rtol=1e-8, atol=1e-10, err_msg=name
            )
    formed = np.empty((n, n))
    ud_covariance(other.U, other.D, formed)
    np.testing.assert_array_equal(formed, other.P)


def test_factors_of_what_is_no_covariance_are_refused() -> None:
    U, D = np.eye(2), np.ones(2)
    indefinite = np.array([[1.0, 2.0], [2.0, 1.0]])
    assert not ud_factors(indefinite, np.empty((2, 2)), np.empty(2))
    assert not ud_transform(U, D, np.eye(2), np.eye(2), indefinite)
    np.testing.assert_array_equal(U, np.eye(2))
    kf = ExtendedKalmanFilter(2, 1, square_root=True)
    kf.P = indefinite
    with pytest.raises(ValueError, match="P is not positive"):
        kf.predict()
    kf.P, kf.Q = np.eye(2), indefinite
    with pytest.raises(ValueError, match="Q is not positive"):
        kf.predict()


def test_semi_definite_covariance_can_be_factored() -> None:
    """Perfectly correlated states, and one that is known exactly."""
    v = np.array([1.0, 2.0, 0.0])
    U, D, P = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    assert ud_factors(np.outer(v, v), U, D)
    ud_covariance(U, D, P)
    np.testing.assert_allclose(P, np.outer(v, v), atol=1e-14)
    assert np.count_nonzero(D) == 1
