"""SVSF: its laws (contraction outside the layer, Kalman gain inside the limit) and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimators import SVSF, ExtendedKalmanFilter
from estimators.svsf import scaled_condition


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


# The published forms: against each other, the Kalman gain, and the formulas written out


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


def written_out(svsf: SVSF, z: np.ndarray, psi: np.ndarray, psi_y: np.ndarray) -> np.ndarray:
    """Gain of the reduced form from the formulas as published, divisions by e and all."""
    H, F, gamma = svsf.H, svsf.F, svsf.gamma
    m, n = H.shape
    columns = np.flatnonzero(np.abs(H).sum(axis=0) > 0)
    others = [i for i in range(n) if i not in columns]
    H1 = H[:, columns]
    T = np.zeros((n, n))  # T x = [measured states; the others], so that H T^-1 = [H1 0]
    T[np.arange(m), columns] = 1.0
    T[np.arange(m, n), others] = 1.0
    Phi = T @ F @ np.linalg.inv(T)
    # In z = H1 x1 the blocks are those of diag(H1, I) Phi diag(H1, I)^-1.
    Phi12, Phi22 = H1 @ Phi[:m, m:], Phi[m:, m:]
    e = z - H @ svsf.x
    back = np.linalg.pinv(Phi12)
    upper = (
        np.linalg.inv(H1)
        @ np.diag((np.abs(e) + gamma * np.abs(svsf.e_post)) * np.clip(e / psi, -1.0, 1.0))
        @ np.linalg.inv(np.diag(e))
    )
    w = Phi22 @ back @ e
    lower = (
        np.diag((np.abs(w) + gamma * np.abs(back @ e)) * np.clip(w / psi_y, -1.0, 1.0))
        @ np.linalg.inv(np.diag(w))
        @ Phi22
        @ back
    )
    return np.linalg.inv(T) @ np.vstack([upper, lower])


@given(seed=problem["seed"], n=st.integers(1, 4), form=st.sampled_from(["full", "subspace", "reduced"]))
def test_inside_the_limit_every_form_is_the_kalman_filter(seed: int, n: int, form: str) -> None:
    """n measured states, and but for the full form as many unmeasured ones."""
    rng = np.random.default_rng(seed)
    unseen = 0 if form == "full" else n
    H, F = measured_first(rng, n, unseen)
    more = {"psi_y": 1e12} if form == "reduced" else {}
    svsf = SVSF(n + unseen, n, psi=1e12, boundary_layer="variable", form=form, gamma=0.2, **more)
    kf = ExtendedKalmanFilter(n + unseen, n)
    filled(rng, [svsf, kf], H, F)
    z = rng.normal(size=n)
    svsf.update(z)
    kf.update(z)
    assert not svsf.switched
    for name in ("x", "P", "K", "S"):
        np.testing.assert_array_equal(getattr(svsf, name), getattr(kf, name), err_msg=name)


@given(seed=problem["seed"], m=st.integers(1, 4), unseen=st.integers(1, 4))
def test_reduced_form_equals_the_formulas_written_out(seed: int, m: int, unseen: int) -> None:
    rng = np.random.default_rng(seed)
    H, F = measured_first(rng, m, unseen)
    psi, psi_y = rng.uniform(0.3, 2.0, m), rng.uniform(0.3, 2.0, unseen)
    svsf = SVSF(m + unseen, m, psi=psi, psi_y=psi_y, form="reduced", gamma=0.25)
    filled(rng, [svsf], H, F)
    z = H @ svsf.x + 2.0 * rng.normal(size=m)
    K, x, P, R = written_out(svsf, z, psi, psi_y), svsf.x.copy(), svsf.P.copy(), svsf.R
    svsf.update(z)
    assert svsf.form_used == "reduced"
    scale = np.abs(K).max()
    np.testing.assert_allclose(svsf.K, K, rtol=1e-6, atol=1e-9 * scale)
    np.testing.assert_allclose(svsf.x, x + K @ (z - H @ x), rtol=1e-6, atol=1e-8 * max(scale, 1.0))
    I_KH = np.eye(m + unseen) - K @ H
    joseph = I_KH @ P @ I_KH.T + K @ R @ K.T
    np.testing.assert_allclose(svsf.P, joseph, rtol=1e-6, atol=1e-8 * np.abs(joseph).max())


@given(seed=problem["seed"], m=st.integers(1, 3), form=st.sampled_from(["full", "subspace", "reduced"]))
def test_outside_the_layer_every_form_contracts_by_gamma(seed: int, m: int, form: str) -> None:
    rng = np.random.default_rng(seed)
    unseen = 0 if form == "full" else m
    H, F = measured_first(rng, m, unseen)
    more = {"psi_y": 1.0} if form == "reduced" else {}
    svsf = SVSF(m + unseen, m, psi=1e-3, gamma=0.4, form=form, **more)
    filled(rng, [svsf], H, F)
    before = svsf.e_post.copy()
    e = rng.choice([-1.0, 1.0], m) * rng.uniform(0.1, 2.0, m)
    svsf.update(H @ svsf.x + e)
    assert svsf.switched
    assert svsf.form_used == form
    np.testing.assert_allclose(svsf.e_post, -0.4 * np.abs(before) * np.sign(e), atol=1e-7)


def test_an_innovation_of_zero_is_no_division_by_zero() -> None:
    for form, n in (("full", 2), ("subspace", 2), ("reduced", 4)):
        more = {"psi_y": 0.5} if form == "reduced" else {}
        svsf = SVSF(n, 2, psi=0.5, form=form, **more)
        svsf.H, svsf.x, svsf.F = np.eye(2, n), np.zeros(n), np.eye(n) + np.eye(n, k=2)
        svsf.e_post = np.array([0.1, 0.2])
        svsf.update([0.0, 0.0])
        assert svsf.form_used == form
        assert not svsf.x.any()
        assert np.isfinite(svsf.P).all()


def test_phi12_that_tells_nothing_is_refused_and_said() -> None:
    """Before any prediction F is the identity: nothing of y reaches z. The subspace form stands in."""
    reduced, subspace = SVSF(2, 1, psi=0.5, psi_y=1.0, form="reduced"), SVSF(2, 1, psi=0.5)
    filled(np.random.default_rng(1), [reduced, subspace], np.array([[1.0, 0.0]]))
    for svsf in (reduced, subspace):
        svsf.update(4.0)
    assert (reduced.form_used, reduced.condition) == ("subspace", np.inf)
    assert np.isnan(reduced.amplification).all()
    np.testing.assert_array_equal(reduced.x, subspace.x)


def test_a_missing_channel_falls_back_to_the_subspace_form() -> None:
    for form, n in (("full", 2), ("reduced", 4)):
        more = {"psi_y": 0.5} if form == "reduced" else {}
        svsf, twin = SVSF(n, 2, psi=0.5, form=form, **more), SVSF(n, 2, psi=0.5)
        F = np.eye(n) + 0.1 * np.eye(n, k=2)
        filled(np.random.default_rng(2), [svsf, twin], np.eye(2, n), F)
        for kf in (svsf, twin):
            kf.update([np.nan, 3.0])
        assert svsf.form_used == "subspace"
        np.testing.assert_array_equal(svsf.x, twin.x)
        svsf.update([1.0, 3.0])
        assert svsf.form_used == form


def test_a_combination_of_states_can_be_measured_when_told_which_count_as_unmeasured() -> None:
    svsf = SVSF(2, 1, psi=0.1, psi_y=1.0, form="reduced")
    svsf.H = [[1.0, -1.0]]
    with pytest.raises(ValueError, match="0 states are seen by no channel, not 1; name them"):
        svsf.update(1.0)
    svsf = SVSF(2, 1, psi=0.1, psi_y=1.0, form="reduced", unmeasured=[1], gamma=0.0)
    svsf.H, svsf.F, svsf.x = [[1.0, -1.0]], [[1.0, 0.5], [0.0, 1.0]], np.zeros(2)
    svsf.update(1.0)
    assert svsf.form_used == "reduced"
    assert svsf.e_post[0] == pytest.approx(0.0, abs=1e-12)


@given(seed=problem["seed"], n=st.integers(1, 5))
def test_condition_does_not_depend_on_units(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    A = well_conditioned(rng, n)
    units = 10.0 ** rng.uniform(-12, 12, (2, n))
    ours = scaled_condition(units[0][:, None] * A * units[1])
    assert 1.0 - 1e-9 <= ours < 2.0 * scaled_condition(A)
    assert ours > 0.5 * scaled_condition(A)
    assert scaled_condition(np.outer(units[0], units[1])) > (1e10 if n > 1 else 0.99)


@pytest.mark.parametrize(
    ("sizes", "options", "message"),
    [
        ((2, 2), {"psi": 0.0}, "a boundary layer is more than 0"),
        ((2, 2), {"psi": np.nan}, "a boundary layer is more than 0"),
        ((2, 2), {"psi": [1.0, 2.0, 3.0]}, "psi has 3 values"),
        ((2, 2), {"psi": np.inf}, "psi is infinite"),
        ((2, 2), {"gamma": 1.0}, "give 0 <= gamma < 1"),
        ((2, 2), {"boundary_layer": "thick"}, "give 'fixed' or 'variable'"),
        ((2, 2), {"form": "half"}, "give 'subspace', 'full' or 'reduced'"),
        ((3, 2), {"form": "full"}, "a channel for each state, not 2 for 3"),
        ((2, 2), {"form": "reduced", "psi_y": 1.0}, "needs fewer channels than states"),
        ((3, 2), {"form": "reduced"}, "needs psi_y, the layer of the 1 unmeasured states"),
        ((3, 2), {"form": "reduced", "psi_y": -1.0}, "a boundary layer is more than 0"),
        ((3, 2), {"form": "reduced", "psi_y": [1.0, 1.0]}, "psi_y has 2 values"),
        ((3, 2), {"form": "reduced", "psi_y": np.inf}, "psi is infinite"),
        ((3, 2), {"form": "reduced", "psi_y": 1.0, "boundary_layer": "variable"}, "for n = 2 m only"),
        ((3, 2), {"form": "reduced", "psi_y": 1.0, "unmeasured": [5]}, "give 1 different indices below 3"),
        ((3, 2), {"psi_y": 1.0}, "are for the reduced form"),
    ],
)
def test_options_that_do_not_fit_are_refused(sizes: tuple, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        SVSF(*sizes, **{"psi": 1.0, **options})
    assert "\n" not in str(error.value)
