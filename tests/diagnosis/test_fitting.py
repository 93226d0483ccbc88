"""Pieces of the fit beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_evidence import FRAMES, LEAK, drawn
from scipy.special import log_ndtr
from scipy.stats import t

from fdd.diagnosis.departures import departures
from fdd.diagnosis.evidence import time_profile_of
from fdd.diagnosis.fitting import Parts, as_normal, freedom, heavy_tailed, log_normal, quasi_likely


@pytest.mark.parametrize("z", [-1e4, -200.0, -30.01, -30.0, -29.99, -8.0, -1.0, -0.0, 0.0, 0.5, 3.0, 7.0])
def test_the_normal_distribution_function_is_scipys(z: float) -> None:
    assert log_normal(z) == pytest.approx(float(log_ndtr(z)), rel=1e-12)


def test_the_fading_filter_is_scipys() -> None:
    from scipy.signal import lfilter

    from fdd.diagnosis.baseline import effects_of
    from fdd.residuals.balance_history import BalanceHistory
    from fdd.residuals.bins import BIN_S
    from fdd.residuals.regression_accumulator import LOAD_S
    from fdd.unit import Unit

    unit = Unit.load("axis_a")
    regression = next(
        a for a in BalanceHistory(unit, effects_of(unit)).regressions.values() if a.balance.bins_per_row > 1
    )
    rows = np.random.default_rng(1).normal(size=(30, regression.level.shape[1]))
    decay = 1.0 - regression.balance.bins_per_row * BIN_S / LOAD_S
    wanted, _ = lfilter([1.0, -1.0], [1.0, -decay], rows, axis=0, zi=-rows[:1])
    found = np.concatenate([regression._passed(part) for part in (rows[:10], rows[10:10], rows[10:])])
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("onset", [0, 40])
def test_a_quasi_likelihood_counts_what_stretches_scatter_beyond_their_noise(onset: int) -> None:
    """Test: an overdispersion of three. Expected: from the start a quarter of the information; within a log
    that of rows of four times the variance, beside what healthy logs change by."""
    evidence = drawn(3, [(LEAK, 0.5, onset)])
    time_profile = time_profile_of("step", FRAMES, onset)[None, None]
    parts = Parts(
        {"volume": LEAK.columns["volume"][None, None]}, time_profile, np.full((1, 1), 1e3), np.ones(1, bool)
    )
    three, start = np.full(1, 3.0), onset == 0
    found = quasi_likely(evidence.balances, parts, three, from_start=start)
    one, four = (
        departures(evidence.balances, parts, k, from_start=start) for k in (three / 3.0, 1.0 + three)
    )
    wanted = (one.size, one.information / 4.0) if start else four[:2]
    np.testing.assert_allclose((found.size, found.information), wanted)


def test_heavy_tailed_is_students_t_of_welchs_degrees_of_freedom() -> None:
    """Beside SciPy's densities: few stretches and healthy logs have four degrees of freedom, noise of many
    stretches is normal."""
    z = np.array([0.5, 3.0, 12.0])
    ratio, one = 0.5 * z**2, np.ones(3)
    for healthy, blocks, nu in ((1.0, 9.0, 4.0), (0.0, 1.0, 4.0), (0.0, 5.0, 20.0), (0.5, 1e9, 16.0)):
        found = freedom(healthy * one, blocks * one)
        np.testing.assert_allclose(found, nu)
        by_t = t.logpdf(0.0, nu) - t.logpdf(z, nu)
        np.testing.assert_allclose(heavy_tailed(ratio, found), by_t)
        np.testing.assert_allclose(as_normal(by_t, found), ratio)
    np.testing.assert_allclose(heavy_tailed(ratio, freedom(0.0 * one, 1e9 * one)), ratio, rtol=1e-3)
