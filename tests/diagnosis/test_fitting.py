"""Pieces of the fit beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import log_ndtr
from scipy.stats import t

from fdd.diagnosis.fitting import as_normal, freedom, heavy_tailed, log_normal


@pytest.mark.parametrize("z", [-1e4, -200.0, -30.01, -30.0, -29.99, -8.0, -1.0, -0.0, 0.0, 0.5, 3.0, 7.0])
def test_the_normal_distribution_function_is_scipys(z: float) -> None:
    assert log_normal(z) == pytest.approx(float(log_ndtr(z)), rel=1e-12)


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
