"""A unit's own log-to-log variances, moderated by the population's."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.random_effects import PRIOR_LOGS, moderation
from fdd.residuals.effects import LogConditions, first_effects

USUAL = LogConditions(1.0, 0.0, 0.0, 0.0, 0.0)
FIRST = first_effects("coherence")
COLUMNS = len(FIRST.mean)


def logs(std: float, count: int, precision: float, seed: int = 5) -> list:
    """Logs whose coefficients depart by so many of the population's standard deviations, all but known."""
    rng = np.random.default_rng(seed)
    between = np.sqrt(FIRST.between_logs(USUAL))
    information = np.diag(precision / between**2)
    drawn = FIRST.mean + std * between * rng.standard_normal((count, COLUMNS))
    return [(information, information @ theta, USUAL) for theta in drawn]


@pytest.mark.parametrize("std", [0.3, 1.0, 4.0])
def test_many_logs_tell_a_units_own_variance(std: float) -> None:
    factor = moderation("coherence", logs(std, 400, 1e4), FIRST)
    # The variance of 400 normal values scatters by 7 %.
    np.testing.assert_allclose(factor, (PRIOR_LOGS + 400 * std**2) / (PRIOR_LOGS + 400), rtol=0.25)


def test_logs_that_tell_nothing_leave_the_populations() -> None:
    np.testing.assert_allclose(moderation("coherence", logs(4.0, 3, 1e-9), FIRST), 1.0, atol=1e-3)
