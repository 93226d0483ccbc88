"""Student's t and its pieces beside SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_evidence import EFFECTS, FRAMES, LEAK, NAME, drawn
from scipy.special import log_ndtr
from scipy.stats import t

from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.students_t import as_normal, freedom, heavy_tailed, log_normal, unusual


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


def test_a_log_is_as_unusual_as_it_is_across_the_fault() -> None:
    """Beside the posterior mean of the scale of a multivariate t: a log that tells its coefficients exactly,
    off by so many standard deviations; the leak acts along the first."""
    frames = drawn(1, steady=True).balances[NAME].information
    std = np.sqrt(np.diag(EFFECTS.covariance))
    columns, one = {NAME: LEAK.columns[NAME][None, None]}, np.ones((1, 1))
    parts = Parts(columns, np.ones((1, 1, FRAMES)), one, np.ones(1, np.bool_))
    for off, kappa in (((9.0, 0.0, 0.0), 0.5), ((0.0, 3.0, 4.0), 0.5), ((5.0, 3.0, 4.0), 2.0)):
        vector = frames @ (EFFECTS.mean + np.array(off) * std)
        evidence = Evidence({NAME: (frames, vector)}, {NAME: EFFECTS})
        square = (off[1] ** 2 + off[2] ** 2) / (1.0 + kappa)
        scale = max((4.0 + square) / (4.0 + 2.0), 1.0)
        found = unusual(evidence.balances, parts, np.full(1, kappa))
        np.testing.assert_allclose(found, scale - 1.0, rtol=1e-3, atol=1e-6)
