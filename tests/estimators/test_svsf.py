"""SVSF: its laws (contraction outside the layer, Kalman gain inside the limit) and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import SVSF, ExtendedKalmanFilter


def covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    A = rng.normal(size=(size, size))
    units = 10.0 ** rng.uniform(-1.0, 1.0, size)
    return (A @ A.T / size + np.eye(size)) * np.outer(units, units)


def wide_output(rng: np.random.Generator, m: int, n: int) -> np.ndarray:
    """A random output matrix of well-conditioned rows."""
    return np.linalg.qr(rng.normal(size=(n, n)))[0][:m] + 0.1 * rng.normal(size=(m, n))


def prepared(rng: np.random.Generator, n: int, m: int, **options) -> SVSF:
    filt = SVSF(n, m, **options)
    filt.H, filt.P, filt.R = wide_output(rng, m, n), covariance(rng, n), covariance(rng, m)
    filt.x = rng.normal(size=n)
    return filt


problem = {"seed": st.integers(0, 2**32 - 1), "n": st.integers(1, 5), "m_share": st.floats(0.0, 1.0)}


def channels(n: int, share: float) -> int:
    return 1 + round(share * (n - 1))


@settings(max_examples=80, deadline=None)
@given(**problem)
def test_the_optimal_layer_turns_the_svsf_gain_into_the_kalman_gain(seed, n, m_share) -> None:
    """The identity behind the switch, from the published formula with a full layer matrix."""
    rng = np.random.default_rng(seed)
    m = channels(n, m_share)
    svsf = prepared(rng, n, m, psi=1e12, boundary_layer="variable", gamma=0.3)
    svsf.e_post = rng.normal(size=m)
    P, H, R = svsf.P.copy(), svsf.H, svsf.R
    z = rng.normal(size=m)
    E = np.diag(np.abs(z - H @ svsf.x) + 0.3 * np.abs(svsf.e_post))
    A = H @ P @ H.T
    S = A + R
    psi = np.linalg.inv(np.linalg.inv(E) @ A @ np.linalg.inv(S))
    svsf.update(z)
    np.testing.assert_allclose(svsf.psi_k, np.diag(psi), rtol=1e-7)
    K = P @ H.T @ np.linalg.inv(A) @ E @ np.linalg.inv(psi)
    np.testing.assert_allclose(K, svsf.K, rtol=1e-6, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(**problem)
def test_unmeasured_states_follow_through_the_covariance(seed, n, m_share) -> None:
    """delta = H+ k + (I - H+ H) K_ekf e, computed in full, with its second term."""
    rng = np.random.default_rng(seed)
    m = channels(n, m_share)
    svsf = prepared(rng, n, m, psi=0.5, gamma=0.1)
    P, H, R, x = svsf.P.copy(), svsf.H, svsf.R, svsf.x.copy()
    z = rng.normal(size=m) * 2.0
    e = z - H @ x
    k = np.abs(e) * np.clip(e / 0.5, -1.0, 1.0)
    A = H @ P @ H.T
    plus = P @ H.T @ np.linalg.inv(A)
    kalman = P @ H.T @ np.linalg.inv(A + R) @ e
    delta = plus @ k + (np.eye(n) - plus @ H) @ kalman
    svsf.update(z)
    np.testing.assert_allclose(svsf.x, x + delta, rtol=1e-6, atol=1e-8)
    K = svsf.K
    I_KH = np.eye(n) - K @ H
    np.testing.assert_allclose(svsf.P, I_KH @ P @ I_KH.T + K @ R @ K.T, rtol=1e-7, atol=1e-10)


def test_two_sensors_of_one_state_are_averaged_and_not_divided_by_zero() -> None:
    svsf = SVSF(2, 2, psi=0.1, gamma=0.0)
    svsf.H, svsf.R, svsf.x = [[1.0, 0.0], [1.0, 0.0]], [1.0, 1.0], np.zeros(2)
    svsf.update([4.0, 6.0])
    assert svsf.x[0] == pytest.approx(5.0, rel=1e-4)
    assert np.linalg.eigvalsh(svsf.P).min() >= 0.0


def well_conditioned(rng: np.random.Generator, size: int) -> np.ndarray:
    return np.linalg.qr(rng.normal(size=(size, size)))[0] * rng.uniform(0.5, 2.0, size)


def filled(rng: np.random.Generator, filters: list, H: np.ndarray, F: np.ndarray | None = None) -> None:
    """The same random problem for each of the filters."""
    m, n = H.shape
    P, R, x, memory = covariance(rng, n), covariance(rng, m), rng.normal(size=n), rng.normal(size=m)
    for kf in filters:
        kf.H, kf.P, kf.R, kf.x = H, P, R, x
        kf.F = np.eye(n) if F is None else F
        if isinstance(kf, SVSF):
            kf.e_post = memory.copy()


def measured_first(rng: np.random.Generator, m: int, unseen: int) -> tuple[np.ndarray, np.ndarray]:
    """H with well-conditioned measured columns and zero ones at random places; a transition."""
    n = m + unseen
    H = np.zeros((m, n))
    H[:, rng.permutation(n)[:m]] = well_conditioned(rng, m)
    return H, rng.normal(size=(n, n))


@settings(max_examples=80, deadline=None)
@given(seed=problem["seed"], n=st.integers(1, 4), unseen=st.booleans())
def test_inside_the_limit_it_is_the_kalman_filter(seed: int, n: int, unseen: bool) -> None:
    """n measured states, and as many unmeasured ones or none."""
    rng = np.random.default_rng(seed)
    H, F = measured_first(rng, n, n * unseen)
    svsf = SVSF(n + n * unseen, n, psi=1e12, boundary_layer="variable", gamma=0.2)
    kf = ExtendedKalmanFilter(n + n * unseen, n)
    filled(rng, [svsf, kf], H, F)
    z = rng.normal(size=n)
    svsf.update(z)
    kf.update(z)
    assert not svsf.switched
    for name in ("x", "P", "K", "S"):
        np.testing.assert_array_equal(getattr(svsf, name), getattr(kf, name), err_msg=name)


@settings(max_examples=80, deadline=None)
@given(seed=problem["seed"], m=st.integers(1, 3), unseen=st.booleans())
def test_outside_the_layer_it_contracts_by_gamma(seed: int, m: int, unseen: bool) -> None:
    rng = np.random.default_rng(seed)
    H, F = measured_first(rng, m, m * unseen)
    svsf = SVSF(m + m * unseen, m, psi=1e-3, gamma=0.4)
    filled(rng, [svsf], H, F)
    before = svsf.e_post.copy()
    e = rng.choice([-1.0, 1.0], m) * rng.uniform(0.1, 2.0, m)
    svsf.update(H @ svsf.x + e)
    assert svsf.switched
    np.testing.assert_allclose(svsf.e_post, -0.4 * np.abs(before) * np.sign(e), atol=1e-7)


def test_an_innovation_of_zero_is_no_division_by_zero() -> None:
    svsf = SVSF(2, 2, psi=0.5)
    svsf.H, svsf.x, svsf.F = np.eye(2), np.zeros(2), np.eye(2)
    svsf.e_post = np.array([0.1, 0.2])
    svsf.update([0.0, 0.0])
    assert not svsf.x.any()
    assert np.isfinite(svsf.P).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"psi": 0.0}, "a boundary layer is more than 0"),
        ({"gamma": 1.0}, "give 0 <= gamma < 1"),
        ({"boundary_layer": "thick"}, "give 'fixed' or 'variable'"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        SVSF(2, 2, **{"psi": 1.0, **options})
    assert "\n" not in str(error.value)
