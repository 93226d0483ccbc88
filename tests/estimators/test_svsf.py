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
@given(seed=problem["seed"], n=st.integers(1, 5), fixed=st.booleans())
def test_where_all_is_measured_it_is_the_original_gain(seed: int, n: int, fixed: bool) -> None:
    """K = H^-1 diag(r), whatever the covariance."""
    rng = np.random.default_rng(seed)
    psi, H = rng.uniform(0.1, 3.0, n), well_conditioned(rng, n)
    svsf = SVSF(n, n, psi=psi, gamma=0.3, boundary_layer="fixed" if fixed else "variable")
    filled(rng, [svsf], H)
    e, memory = 2.0 * rng.normal(size=n), svsf.e_post.copy()
    svsf.update(H @ svsf.x + e)
    if svsf.switched:
        size = np.abs(e) + 0.3 * np.abs(memory)
        original = np.linalg.inv(H) @ np.diag(size / np.maximum(np.abs(e), psi))
        np.testing.assert_allclose(svsf.K, original, rtol=1e-7, atol=1e-9)
    assert svsf.switched or not fixed


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
        ({"psi": np.nan}, "a boundary layer is more than 0"),
        ({"psi": [1.0, 2.0, 3.0]}, "psi has 3 values"),
        ({"psi": np.inf}, "psi is infinite"),
        ({"gamma": 1.0}, "give 0 <= gamma < 1"),
        ({"boundary_layer": "thick"}, "give 'fixed' or 'variable'"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        SVSF(2, 2, **{"psi": 1.0, **options})
    assert "\n" not in str(error.value)


def pushed(make, channels: int, dt: float) -> tuple[np.ndarray, SVSF | ExtendedKalmanFilter]:
    """Rms errors in mm and mm/s, healthy and pushed, of the guide's mass on a spring (seeded)."""

    def spring(x, u, dt):
        speed = x[1] + dt * (u - 40.0 * x[0] - 3.0 * x[1]) / 2.0
        return [x[0] + dt * speed, speed]

    kf = make(f=spring, h=lambda x: x[:channels])
    kf.x, kf.P, kf.Q = np.zeros(2), [1e-4, 1e-2], [1e-12, 1e-5 * dt]
    kf.R = [1e-6, 25e-6][:channels]
    rng, truth, errors, steps = np.random.default_rng(0), np.zeros(2), [], round(2.0 / dt)
    for i in range(steps):
        u = 10.0 * np.sin(10.0 * i * dt)
        truth = np.array(spring(truth, u + (30.0 if i >= steps // 2 else 0.0), dt))
        z = truth + [1e-3, 5e-3] * rng.normal(size=2)
        kf.predict(u, dt)
        kf.update(z[:channels])
        errors.append(1e3 * (kf.x - truth))
    parts = errors[steps // 4 : steps // 2], errors[steps // 2 :]
    return np.concatenate([np.sqrt(np.mean(np.square(part), axis=0)) for part in parts]), kf


@pytest.mark.parametrize(
    ("channels", "rate", "kalman", "expected"),
    [
        (2, 1000, True, (0.07, 0.6, 51, 660)),
        (2, 1000, False, (0.54, 2.5, 0.5, 7)),
        (1, 100, True, (0.12, 0.4, 368, 2000)),
        (1, 100, False, (0.57, 0.9, 1.0, 14000)),
        (1, 1000, True, (0.12, 0.6, 135, 1645)),
        (1, 1000, False, (0.54, 0.3, 1.1, 18400)),
    ],
)
def test_the_guides_table(channels: int, rate: int, kalman: bool, expected: tuple) -> None:
    def make(**model):
        if kalman:
            return ExtendedKalmanFilter(2, channels, **model)
        return SVSF(2, channels, psi=[0.005, 0.025][:channels], **model)

    np.testing.assert_allclose(pushed(make, channels, 1.0 / rate)[0], expected, rtol=0.08, atol=0.05)
