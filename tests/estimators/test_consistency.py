"""Bands against scipy and by their false-alarm rates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from estimators import nees_band, nis_band, nis_test, squared_distance


@settings(max_examples=100, deadline=None)
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


def test_nis_test_finds_an_overconfident_filter() -> None:
    nis = 1.2 * np.random.default_rng(5).chisquare(2, size=2000)
    outcome = nis_test(nis, 2)
    assert outcome.mean > outcome.high
    assert not outcome.consistent
