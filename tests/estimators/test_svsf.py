"""SVSF: its laws (contraction outside the layer, Kalman gain inside the limit) and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimators import SVSF


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


sizes = st.integers(1, 5).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n)))
problem = {"seed": st.integers(0, 2**32 - 1), "n_and_m": sizes}


@settings(max_examples=80, deadline=None)
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


@settings(max_examples=60, deadline=None)
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


@settings(max_examples=80, deadline=None)
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
