"""Masks and Huber's limit: what is dropped or weighed down, and that the rest stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from estimators import SVSF, ExtendedKalmanFilter

problem = {"seed": st.integers(0, 2**32 - 1), "n": st.integers(1, 5), "m": st.integers(1, 4)}


def covariance(rng: np.random.Generator, size: int) -> np.ndarray:
    A = rng.normal(size=(size, size))
    return A @ A.T / size + 0.5 * np.eye(size)


def pair(rng: np.random.Generator, n: int, m: int, **options):
    plain, robust = ExtendedKalmanFilter(n, m), ExtendedKalmanFilter(n, m, **options)
    H, P, R, x = rng.normal(size=(m, n)), covariance(rng, n), covariance(rng, m), rng.normal(size=n)
    for kf in (plain, robust):
        kf.H, kf.P, kf.R, kf.x = H, P, R, x
    return plain, robust


@settings(max_examples=60, deadline=None)
@given(**problem, svsf=st.booleans())
def test_a_masked_channel_is_a_missing_channel(seed: int, n: int, m: int, svsf: bool) -> None:
    rng = np.random.default_rng(seed)
    H, P, R = rng.normal(size=(m, n)), covariance(rng, n), covariance(rng, m)
    mask, z = rng.random(m) < 0.5, rng.normal(size=m)
    make = (lambda: SVSF(n, m, psi=0.5)) if svsf else (lambda: ExtendedKalmanFilter(n, m))
    masked, holed = make(), make()
    for kf in (masked, holed):
        kf.H, kf.P, kf.R = H, P, R
    masked.update(np.where(mask, z, np.inf), mask=mask)  # whatever stands there
    holed.update(np.where(mask, z, np.nan))
    for name in ("x", "P", "K", "S", "z", "y", "nis", "log_likelihood", "channels_used"):
        np.testing.assert_array_equal(getattr(masked, name), getattr(holed, name), err_msg=name)
    assert masked.channels_used == mask.sum()


@pytest.mark.parametrize("mask", [[1, 0], [True], [True, False, True], "no"])
def test_a_mask_that_does_not_fit_is_refused(mask) -> None:
    kf = ExtendedKalmanFilter(2, 2)
    with pytest.raises(ValueError, match="give 2 bools, True to use"):
        kf.update([1.0, 1.0], mask=mask)


@settings(max_examples=60, deadline=None)
@given(**problem)
def test_samples_within_the_limit_are_the_kalman_filters(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    plain, robust = pair(rng, n, m, robust=1e6)
    z = 3.0 * rng.normal(size=m)
    plain.update(z)
    robust.update(z)
    assert robust.robust_weights.tolist() == [1.0] * m
    for name in ("x", "P", "K", "S", "nis", "log_likelihood"):
        np.testing.assert_array_equal(getattr(robust, name), getattr(plain, name), err_msg=name)


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 5), limit=st.floats(0.5, 5.0))
def test_one_channel_follows_hubers_influence_function(seed: int, n: int, limit: float) -> None:
    """The correction is the Kalman correction of the innovation clipped at the limit."""
    rng = np.random.default_rng(seed)
    plain, robust = pair(rng, n, 1, robust=limit)
    S = (plain.H @ plain.P @ plain.H.T + plain.R).item()
    e = rng.choice([-1.0, 1.0]) * rng.uniform(0.0, 20.0) * np.sqrt(S)
    clipped = float(np.clip(e, -limit * np.sqrt(S), limit * np.sqrt(S)))
    output = (plain.H @ plain.x).item()
    robust.update(output + e)
    nis = robust.nis
    plain.update(output + clipped)
    np.testing.assert_allclose(robust.x, plain.x, rtol=1e-9, atol=1e-12)
    assert nis == pytest.approx(e * e / S)  # of the noise as given
    weight = min(1.0, limit * np.sqrt(S) / max(abs(e), 1e-300))
    assert robust.robust_weights[0] == pytest.approx(weight)
    # Its covariance is that of a channel of variance S / w.
    before = pair(np.random.default_rng(seed), n, 1)[0].P
    Ph = before @ plain.H.T
    np.testing.assert_allclose(robust.P, before - Ph @ Ph.T * weight / S, rtol=1e-7, atol=1e-10)


@settings(max_examples=60, deadline=None)
@given(**problem)
def test_an_outlier_in_one_channel_leaves_the_others_their_weight(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    _, robust = pair(rng, n, m, robust=3.0)
    bad = rng.integers(m)
    z = robust.H @ robust.x
    z[bad] += 1e9
    robust.update(z)
    weights = robust.robust_weights
    assert weights[bad] < 1e-6
    assert np.delete(weights, bad).tolist() == [1.0] * (m - 1)
    # As good as left out.
    rest = ExtendedKalmanFilter(n, m)
    _, prior = pair(np.random.default_rng(seed), n, m, robust=3.0)
    rest.x, rest.P, rest.H, rest.R = prior.x, prior.P, prior.H, prior.R
    rest.update(z, mask=np.arange(m) != bad)
    np.testing.assert_allclose(robust.P, rest.P, rtol=1e-5, atol=1e-6)


def test_with_bad_samples_it_beats_the_kalman_filter_and_without_it_costs_little() -> None:
    """5 % of samples are off by some 20 standard deviations (seeded, 4000 samples)."""
    rng = np.random.default_rng(5)
    rms = {}
    for share in (0.0, 0.05):
        filters = {None: ExtendedKalmanFilter(1, 1), 2.0: ExtendedKalmanFilter(1, 1, robust=2.0)}
        for kf in filters.values():
            kf.H, kf.Q, kf.R, kf.x = [[1.0]], 1e-2, 1.0, np.zeros(1)
        x, errors = 0.0, []
        for _ in range(4000):
            x += 0.1 * rng.normal()
            z = x + rng.normal() + (20.0 * rng.normal() if rng.random() < share else 0.0)
            for kf in filters.values():
                kf.predict()
                kf.update(z)
            errors.append([kf.x.item() - x for kf in filters.values()])
        rms[share] = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[0.0][1] < 1.03 * rms[0.0][0]
    assert rms[0.05][1] < 0.5 * rms[0.05][0]


def test_the_documented_efficiency() -> None:
    """Huber's estimate of location at the normal law: P(|t| < c)^2 / E psi^2 at c = 1.345."""
    c = 1.345
    power = integrate.quad(lambda t: min(abs(t), c) ** 2 * stats.norm.pdf(t), -12.0, 12.0)[0]
    assert (stats.norm.cdf(c) - stats.norm.cdf(-c)) ** 2 / power == pytest.approx(0.95, abs=1e-4)
    assert 2.0 * stats.norm.sf(3.0) == pytest.approx(0.003, abs=5e-4)


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan])
def test_an_impossible_limit_is_refused(limit: float) -> None:
    with pytest.raises(ValueError, match="give a limit of more than 0"):
        ExtendedKalmanFilter(1, 1, robust=limit)
