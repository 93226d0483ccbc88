"""SVSF: its laws (contraction outside the layer, Kalman gain inside the limit) and its limits."""

from __future__ import annotations

import filterpy.kalman
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import SVSF, ExtendedKalmanFilter
from estimators.kernels import svsf_gain
from estimators.linalg import joseph_update


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
def test_inside_its_limit_the_variable_layer_gives_the_kalman_gain(seed, n, m_share) -> None:
    rng = np.random.default_rng(seed)
    m = channels(n, m_share)
    svsf = prepared(rng, n, m, psi=1e12, boundary_layer="variable")
    kf = ExtendedKalmanFilter(n, m)
    kf.H, kf.P, kf.R, kf.x = svsf.H, svsf.P, svsf.R, svsf.x
    z = rng.normal(size=m)
    svsf.update(z)
    kf.update(z)
    assert not svsf.switched
    S = kf.H @ kf.P_prior @ kf.H.T
    for name in ("x", "P", "K", "S"):
        np.testing.assert_array_equal(getattr(svsf, name), getattr(kf, name), err_msg=name)
    assert np.isfinite(S).all()
    assert svsf.log_likelihood == kf.log_likelihood


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


@settings(max_examples=80, deadline=None)
@given(**problem)
def test_outside_the_layer_the_posterior_error_contracts_by_gamma(seed, n, m_share) -> None:
    rng = np.random.default_rng(seed)
    m = channels(n, m_share)
    svsf = prepared(rng, n, m, psi=1e-3, gamma=0.4)
    svsf.e_post = rng.normal(size=m)
    previous = svsf.e_post.copy()
    e = rng.choice([-1.0, 1.0], m) * rng.uniform(0.1, 2.0, m)
    svsf.update(svsf.H @ svsf.x + e)
    assert svsf.switched
    assert svsf.outside.all()
    np.testing.assert_allclose(svsf.e_post, -0.4 * np.abs(previous) * np.sign(e), atol=1e-8)


def test_full_measurement_does_not_depend_on_the_covariance() -> None:
    """With as many channels as states the correction is H^-1 k, whatever P says."""
    rng = np.random.default_rng(5)
    H, x = wide_output(rng, 3, 3), rng.normal(size=3)
    e, memory, psi, gamma = (
        np.array([0.4, -3.0, 0.1]),
        np.array([0.5, 0.2, 0.0]),
        np.array([1.0, 1.0, 0.5]),
        0.2,
    )
    size = np.abs(e) + gamma * np.abs(memory)
    k = size * np.clip(e / psi, -1.0, 1.0)
    for seed in (1, 2):
        svsf = SVSF(3, 3, psi=psi, gamma=gamma)
        svsf.x, svsf.H, svsf.P = x, H, covariance(np.random.default_rng(seed), 3)
        svsf.e_post = memory.copy()
        svsf.update(H @ x + e)
        np.testing.assert_allclose(svsf.x, x + np.linalg.solve(H, k), rtol=1e-9)
        assert svsf.outside.tolist() == [False, True, False]


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


def test_covariance_of_any_gain_equals_the_sample_covariance() -> None:
    """Joseph form of a deliberately wrong gain, against 400 000 simulated errors (seeded, 2 %)."""
    rng = np.random.default_rng(8)
    P, R, H, K = covariance(rng, 3), covariance(rng, 2), rng.normal(size=(2, 3)), rng.normal(size=(3, 2))
    error = rng.multivariate_normal(np.zeros(3), P, 400_000)
    noise = rng.multivariate_normal(np.zeros(2), R, 400_000)
    after = error - (error @ H.T + noise) @ K.T
    joseph_update(P, K, H, R)
    scale = np.sqrt(np.outer(np.diag(P), np.diag(P)))
    np.testing.assert_allclose(np.cov(after.T) / scale, P / scale, atol=0.02)


def test_a_step_in_the_plant_is_followed_where_the_kalman_filter_lags() -> None:
    """Expected result: posterior error within the layer one sample after the step, and reported."""
    rng = np.random.default_rng(12)
    kf, svsf = ExtendedKalmanFilter(1, 1), SVSF(1, 1, psi=0.5, gamma=0.1)
    error = {}
    for name, filt in (("kf", kf), ("svsf", svsf)):
        filt.H, filt.Q, filt.R = [[1.0]], 1e-6, 1e-2
        for i in range(400):
            filt.predict()
            filt.update((5.0 if i >= 200 else 0.0) + 0.1 * rng.normal())
            if i == 202:
                error[name] = abs(filt.x.item() - 5.0)
    assert error["kf"] > 4.0
    assert error["svsf"] < 0.6
    # Samples are at 0.1 in a layer of 0.5: outside once, at the step.
    assert svsf.chattering[0] == pytest.approx(1 / 400)


def test_chattering_counts_only_measured_samples() -> None:
    svsf = SVSF(2, 2, psi=1.0)
    svsf.H, svsf.x = np.eye(2), np.zeros(2)
    assert np.isnan(svsf.chattering).all()
    svsf.update([5.0, np.nan])
    svsf.update([svsf.x[0], np.nan])
    assert svsf.chattering[0] == 0.5
    assert np.isnan(svsf.chattering[1])


def test_works_in_filterpys_imm() -> None:
    rng = np.random.default_rng(13)
    filters = []
    for rate in (1.0, 0.8):
        svsf = SVSF(1, 1, psi=5.0, boundary_layer="variable")
        svsf.F, svsf.H, svsf.Q, svsf.R = [[rate]], [[1.0]], 0.01, 0.01
        svsf.P = np.eye(1)
        filters.append(svsf)
    imm = filterpy.kalman.IMMEstimator(filters, [0.5, 0.5], np.array([[0.98, 0.02], [0.02, 0.98]]))
    x = 20.0
    for _ in range(15):
        x = 0.8 * x + 0.1 * rng.normal()
        imm.predict()
        imm.update(np.array([[x + 0.1 * rng.normal()]]))
    assert imm.mu[1] > 0.95
    assert imm.x.item() == pytest.approx(x, abs=0.5)


def test_gain_at_the_edge_of_the_layer_is_continuous() -> None:
    K, psi_k, outside = np.empty((1, 1)), np.empty(1), np.empty(1, dtype=bool)
    one = np.eye(1)
    gains = []
    for e in (1.0, np.nextafter(1.0, 2.0)):
        svsf_gain(one, one, one, np.array([e]), np.array([0.3]), 0.5, np.ones(1), False, K, psi_k, outside)
        gains.append(K.item())
    assert outside[0]
    assert gains[0] == pytest.approx(gains[1], rel=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"psi": 0.0}, "a boundary layer is more than 0"),
        ({"psi": np.nan}, "a boundary layer is more than 0"),
        ({"psi": [1.0, 2.0, 3.0]}, "psi has 3 values"),
        ({"psi": np.inf}, "psi is infinite"),
        ({"psi": 1.0, "gamma": 1.0}, "give 0 <= gamma < 1"),
        ({"psi": 1.0, "boundary_layer": "thick"}, "give 'fixed' or 'variable'"),
    ],
)
def test_unusable_options_are_refused(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SVSF(2, 2, **options)
