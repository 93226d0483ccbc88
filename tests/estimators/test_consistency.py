"""Bands and whiteness tests against scipy and by their false-alarm rates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal, stats

from estimators import (
    autocorrelation,
    nees_band,
    nis_band,
    nis_test,
    squared_distance,
    whiteness_test,
)


@given(dim=st.integers(1, 20), n=st.integers(1, 100_000), probability=st.floats(0.01, 0.999_999))
def test_band_equals_scipys_chi_square(dim: int, n: int, probability: float) -> None:
    low, high = nis_band(dim, n, probability)
    expected = stats.chi2.interval(probability, dim * n)
    np.testing.assert_allclose([low * n, high * n], expected, rtol=1e-9)
    assert nees_band(dim, n, probability) == (low, high)


def test_squared_distance_equals_the_textbook_formula_and_ignores_units() -> None:
    rng = np.random.default_rng(2)
    A = rng.normal(size=(7, 3, 3))
    C = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(3)
    e = rng.normal(size=(7, 3))
    expected = [v @ np.linalg.inv(c) @ v for v, c in zip(e, C, strict=True)]
    np.testing.assert_allclose(squared_distance(e, C), expected)
    units = np.array([1e-9, 1.0, 1e9])
    np.testing.assert_allclose(squared_distance(e * units, C * np.outer(units, units)), expected)
    one = squared_distance(e, C[0])  # one covariance for all
    np.testing.assert_allclose(one[3], e[3] @ np.linalg.inv(C[0]) @ e[3])


def test_nis_test_allows_for_missing_channels() -> None:
    """Channels come and go: the right degrees of freedom pass, a constant number fails. Seeded, 99.9 %."""
    rng = np.random.default_rng(4)
    used = rng.integers(0, 4, size=5000)
    nis = np.where(used > 0, rng.chisquare(np.maximum(used, 1)), 0.0)
    outcome = nis_test(nis, used, 0.999)
    assert outcome.consistent
    assert outcome.n == (used > 0).sum()
    assert outcome.false_alarm_rate == pytest.approx(0.001)
    assert not nis_test(nis, 3, 0.999).consistent


def test_autocorrelation_equals_scipys_correlation() -> None:
    y = np.random.default_rng(6).normal(size=(300, 2)).cumsum(axis=0)
    rho = autocorrelation(y, 25)
    for channel in range(2):
        v = y[:, channel] - y[:, channel].mean()
        full = signal.correlate(v, v)
        np.testing.assert_allclose(rho[:, channel], full[300:325] / full[299], rtol=1e-9)
        np.testing.assert_allclose(autocorrelation(y[:, channel], 25), rho[:, channel])


def test_whiteness_test_rejects_white_noise_at_its_stated_rate() -> None:
    """2000 seeded white series: p-values uniform (Kolmogorov-Smirnov at 0.1 %), 5 % rejected to 4 sigma."""
    p = whiteness_test(np.random.default_rng(7).normal(size=(1000, 2000)), lags=10).p_value
    assert stats.kstest(p, "uniform").pvalue > 0.001
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=4 * np.sqrt(0.05 * 0.95 / 2000))


def test_statistic_is_ljung_and_boxs() -> None:
    """Worked by hand: rho = (-0.75, 0.5), n = 4: Q = 24 (0.5625/3 + 0.25/2) = 7.5."""
    outcome = whiteness_test([1.0, -1.0, 1.0, -1.0], lags=2)
    assert outcome.statistic[0] == pytest.approx(7.5)
    assert outcome.p_value[0] == pytest.approx(stats.chi2.sf(7.5, 2))


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: nis_band(0), "give at least 1 of each"),
        (lambda: nis_band(1, 1, 1.0), "give a value between 0 and 1"),
        (lambda: nis_test([], 1), "nis has 0 values"),
        (lambda: nis_test([1.0, np.nan], 1), "1 of them NaN"),
        (lambda: nis_test([1.0, 2.0, 3.0], [1, 2]), "dim has 2 values for 3 of nis"),
        (lambda: autocorrelation([1.0, np.nan, 2.0], 1), "not finite"),
        (lambda: autocorrelation([1.0, 2.0], 2), "n > lags"),
        (lambda: autocorrelation([2.0, 2.0, 2.0], 1), "constant"),
        (lambda: squared_distance([1.0, 2.0], [[1.0]]), "do not fit"),
        (lambda: squared_distance([1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]]), "not positive definite"),
        (lambda: squared_distance([1.0], [[-1.0]]), "not positive"),
    ],
)
def test_unusable_input_is_refused(act, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        act()
