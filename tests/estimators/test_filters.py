"""Both filters: against filterpy, scipy and the chi-square law; the SVSF's own laws and limits; endurance."""

import copy
import math
from pathlib import Path

import filterpy.kalman
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import estimators
from estimators import SVSF, ExtendedKalmanFilter
from estimators.compiled import compiler
from estimators.kernels import kalman_update_correlated
from estimators.linalg import symmetrise


def covariance(rng: np.random.Generator, size: int, spread: float = 1.0) -> np.ndarray:
    """A random well-conditioned covariance whose units differ by up to 10**±spread."""
    A = rng.normal(size=(size, size))
    units = 10.0 ** rng.uniform(-spread, spread, size)
    full = (A @ A.T / size + np.eye(size)) * np.outer(units, units)
    return 0.5 * (full + full.T)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6), m=st.integers(1, 5))
def test_random_linear_problems_equal_both_of_filterpys_filters(seed: int, n: int, m: int) -> None:
    """KalmanFilter, and ExtendedKalmanFilter with h and its Jacobian handed to update."""
    rng = np.random.default_rng(seed)
    F, H = 0.9 * np.linalg.qr(rng.normal(size=(n, n)))[0], rng.normal(size=(m, n))
    values = {"P": covariance(rng, n), "Q": covariance(rng, n), "R": covariance(rng, m), "F": F}
    values["x"] = rng.normal(size=(n, 1))
    ours, peer = ExtendedKalmanFilter(n, m), filterpy.kalman.KalmanFilter(n, m)
    ours.H, peer.H = H, H
    extended = ExtendedKalmanFilter(n, m, h=lambda x: H @ x, H_jacobian=lambda x: H)
    theirs = filterpy.kalman.ExtendedKalmanFilter(n, m)
    for kf in (ours, peer, extended, theirs):
        for name, value in values.items():
            setattr(kf, name, value.copy())
    for _ in range(8):
        z = rng.normal(size=(m, 1))
        for kf in (ours, peer, extended, theirs):
            kf.predict()
        for kf in (ours, peer, extended):
            kf.update(z)
        theirs.update(z, lambda x: H, lambda x: H @ x)
    for one, other in ((ours, peer), (extended, theirs), (extended, peer)):
        scale = np.sqrt(np.outer(np.diag(other.P), np.diag(other.P)))
        spread = np.sqrt(np.diag(other.P))[:, None] + np.abs(other.x)
        np.testing.assert_allclose(one.P / scale, other.P / scale, atol=1e-7)
        np.testing.assert_allclose(one.x / spread, other.x / spread, atol=1e-7)
        np.testing.assert_allclose(one.K, other.K, rtol=1e-6, atol=1e-7 * np.abs(other.K).max())
        assert one.log_likelihood == pytest.approx(peer.log_likelihood, rel=1e-6, abs=1e-6)


def radar(x):
    """Slant range and elevation of a target at height x[2] and ground distance x[0]."""
    return np.array([np.hypot(x[0], x[2]), np.arctan2(x[2], x[0])])


def radar_jacobian(x):
    d, height = float(np.ravel(x)[0]), float(np.ravel(x)[2])
    r = math.hypot(d, height)
    return np.array([[d / r, 0.0, height / r], [-height / r**2, 0.0, d / r**2]])


@pytest.mark.parametrize("own_jacobian", [True, False])
def test_nonlinear_filter_equals_filterpy(own_jacobian: bool) -> None:
    rng = np.random.default_rng(4)
    F = np.eye(3)
    F[0, 1] = 0.05
    ours = ExtendedKalmanFilter(3, 2, h=radar, H_jacobian=radar_jacobian if own_jacobian else None)
    peer = filterpy.kalman.ExtendedKalmanFilter(3, 2)
    for kf in (ours, peer):
        kf.x = np.array([-90.0, 90.0, 1100.0])
        kf.F, kf.Q, kf.R, kf.P = F, 0.1 * np.eye(3), np.diag([25.0, 1e-4]), 50.0 * np.eye(3)
    x = np.array([-100.0, 100.0, 1000.0])
    for _ in range(200):
        x = F @ x
        z = radar(x) + rng.normal(size=2) * [5.0, 0.01]
        ours.predict()
        peer.predict()
        ours.update(z)
        peer.update(z, radar_jacobian, radar)
        np.testing.assert_allclose(ours.x, peer.x, rtol=1e-6)
        np.testing.assert_allclose(ours.P, peer.P, rtol=1e-6, atol=1e-8)
    assert np.abs(ours.x - x).max() < 30.0


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6), m=st.integers(1, 5), full=st.booleans())
def test_missing_channels_equal_an_update_without_those_rows(seed: int, n: int, m: int, full: bool) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random(m) < 0.6
    H, R, P = rng.normal(size=(m, n)), covariance(rng, m), covariance(rng, n)
    R = R if full else np.diag(np.diag(R))
    x, z = rng.normal(size=n), np.where(mask, rng.normal(size=m), np.nan)
    holed = ExtendedKalmanFilter(n, m)
    holed.x, holed.P, holed.H, holed.R = x, P, H, R
    holed.update(z)
    assert holed.channels_used == mask.sum()
    assert np.isnan(holed.y).tolist() == (~mask).tolist()
    assert not holed.K[:, ~mask].any()
    if not mask.any():
        np.testing.assert_array_equal(holed.x, x)
        np.testing.assert_array_equal(holed.P, P)
        assert (holed.nis, holed.likelihood) == (0.0, 1.0)
        return
    cut = ExtendedKalmanFilter(n, int(mask.sum()))
    cut.x, cut.P, cut.H, cut.R = x, P, H[mask], R[np.ix_(mask, mask)]
    cut.update(z[mask])
    np.testing.assert_allclose(holed.x, cut.x, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(holed.P, cut.P, rtol=1e-10, atol=1e-12)
    assert holed.nis == pytest.approx(cut.nis)
    assert holed.log_likelihood == pytest.approx(cut.log_likelihood)


def test_diffuse_prior_and_two_precise_sensors() -> None:
    """S is singular to rounding (P/R = 1e20): the update must still average the sensors."""
    kf = ExtendedKalmanFilter(2, 2)
    kf.P, kf.R, kf.H = 1e12, 1e-8, [[1.0, 0.0], [1.0, 0.0]]
    kf.update([1.0, 3.0])
    assert kf.x[0, 0] == pytest.approx(2.0, rel=1e-6)
    assert kf.P[0, 0] == pytest.approx(0.5e-8, rel=1e-6)
    assert kf.P[1, 1] == 1e12


def test_perfectly_correlated_noise_cancels_in_the_difference() -> None:
    """R of rank 1: a combination of the channels is free of noise, and its state is known exactly."""
    v = np.array([0.1, 0.3, 0.7])
    kf = ExtendedKalmanFilter(2, 3)
    kf.x, kf.P, kf.R = np.zeros(2), [4.0, 9.0], np.outer(v, v)
    kf.H = [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]
    truth, noise = np.array([1.5, -2.0]), 0.8
    kf.update(np.asarray(kf.H) @ truth + v * noise)
    np.testing.assert_allclose(kf.x, truth, atol=1e-9)
    assert np.abs(kf.P).max() < 1e-9


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda kf: kf.update([1.0, 2.0, 3.0]), "z has 3 values, the filter expects 2"),
        (lambda kf: kf.update([1.0, np.inf]), "z is infinite in channel 1"),
        (lambda kf: kf.update([1.0, 2.0], Hx=lambda x: [np.nan, 0.0]), "innovation z - h.x. is not finite"),
        (lambda kf: kf.predict(F=np.eye(2)), r"F has shape \(2, 2\), the filter expects \(3, 3\)"),
    ],
)
def test_unusable_input_is_refused_in_one_line_and_changes_nothing(act, message: str) -> None:
    kf = ExtendedKalmanFilter(3, 2)
    kf.H = np.eye(2, 3)
    kf.update([1.0, 1.0])
    before = copy.deepcopy(vars(kf))
    with pytest.raises(ValueError, match=message) as error:
        act(kf)
    assert "\n" not in str(error.value)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(kf, name), value, err_msg=name)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 5), limit=st.floats(0.5, 5.0))
def test_one_channel_follows_hubers_influence_function(seed: int, n: int, limit: float) -> None:
    """The correction is the Kalman correction of the innovation clipped at the limit."""
    rng = np.random.default_rng(seed)
    H, P, R, x = rng.normal(size=(1, n)), covariance(rng, n), covariance(rng, 1), rng.normal(size=n)
    plain, robust = ExtendedKalmanFilter(n, 1), ExtendedKalmanFilter(n, 1, robust=limit)
    for kf in (plain, robust):
        kf.H, kf.P, kf.R, kf.x = H, P, R, x
    std, output = np.sqrt((H @ P @ H.T + R).item()), (H @ x).item()
    e = rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 20.0) * std
    robust.update(output + e)
    plain.update(output + float(np.clip(e, -limit * std, limit * std)))
    np.testing.assert_allclose(robust.x, plain.x, rtol=1e-9, atol=1e-12)
    assert robust.nis == pytest.approx((e / std) ** 2)  # of the noise as given
    weight = min(1.0, limit * std / max(abs(e), 1e-300))
    assert robust.robust_weights[0] == pytest.approx(weight)
    # Its covariance is that of a channel of variance S / w.
    Ph = P @ H.T
    np.testing.assert_allclose(robust.P, P - Ph @ Ph.T * weight / std**2, rtol=1e-7, atol=1e-10)


def prepared(rng: np.random.Generator, n: int, m: int, **options) -> SVSF:
    """A filter of a random output matrix of well-conditioned rows."""
    filt = SVSF(n, m, **options)
    filt.H = np.linalg.qr(rng.normal(size=(n, n)))[0][:m] + 0.1 * rng.normal(size=(m, n))
    filt.P, filt.R = covariance(rng, n), covariance(rng, m)
    filt.x = rng.normal(size=n)
    return filt


sizes = st.integers(1, 5).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n)))
problem = {"seed": st.integers(0, 2**32 - 1), "n_and_m": sizes}


@settings(max_examples=80)
@given(**problem)
def test_the_optimal_layer_turns_the_svsf_gain_into_the_kalman_gain(seed, n_and_m) -> None:
    """The identity behind the switch, from the published formula with a full layer matrix."""
    rng, (n, m) = np.random.default_rng(seed), n_and_m
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


@settings(max_examples=60)
@given(**problem)
def test_unmeasured_states_follow_through_the_covariance(seed, n_and_m) -> None:
    """delta = H+ k + (I - H+ H) K_ekf e, computed in full, with its second term."""
    rng, (n, m) = np.random.default_rng(seed), n_and_m
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
    K, I_KH = svsf.K, np.eye(n) - svsf.K @ H
    np.testing.assert_allclose(svsf.P, I_KH @ P @ I_KH.T + K @ R @ K.T, rtol=1e-7, atol=1e-10)


@settings(max_examples=80)
@given(**problem)
def test_outside_the_layer_it_contracts_by_gamma(seed, n_and_m) -> None:
    rng, (n, m) = np.random.default_rng(seed), n_and_m
    svsf = prepared(rng, n, m, psi=1e-3, gamma=0.4)
    svsf.e_post = before = rng.normal(size=m)
    e = rng.choice([-1.0, 1.0], m) * rng.uniform(0.1, 2.0, m)
    svsf.update(svsf.H @ svsf.x + e)
    assert svsf.switched
    np.testing.assert_allclose(svsf.e_post, -0.4 * np.abs(before) * np.sign(e), atol=1e-7)


def test_two_sensors_of_one_state_are_averaged_and_not_divided_by_zero() -> None:
    svsf = SVSF(2, 2, psi=0.1, gamma=0.0)
    svsf.H, svsf.R, svsf.x = [[1.0, 0.0], [1.0, 0.0]], [1.0, 1.0], np.zeros(2)
    svsf.update([4.0, 6.0])
    assert svsf.x[0] == pytest.approx(5.0, rel=1e-4)
    assert np.linalg.eigvalsh(svsf.P).min() >= 0.0


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


# Ten million steps with worst-case scaling: covariances of the Joseph form stay symmetric and positive.
# Each case is run in compiled code, in raw units over 24 decades, with masks that change at every step and
# blind stretches; no update shrinks a variance by 1e13 or more. The covariance is looked at every 5000 steps.

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
