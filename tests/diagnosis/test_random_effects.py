"""A unit's own log-to-log variances, moderated by the population's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdd.diagnosis.random_effects import PRIOR_LOGS, moderation
from fdd.residuals.balances import BALANCES
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


def test_three_logs_move_it_no_further_than_their_weight() -> None:
    alike = moderation("coherence", logs(0.0, 3, 1e6), replace(FIRST, units=np.full(COLUMNS, 1e-9)))
    np.testing.assert_allclose(alike, PRIOR_LOGS / (PRIOR_LOGS + 3), rtol=0.01)


def test_what_belongs_to_the_load_is_left_alone() -> None:
    first = first_effects("force")
    own = np.array([c not in BALANCES["force"].free for c in BALANCES["force"].columns])
    information = np.eye(int(own.sum())) * 1e4
    many = [(information, information @ (first.mean[own] + k), USUAL) for k in (-3.0, 0.0, 3.0)]
    factor = moderation("force", many, first)
    assert (factor[~own] == 1.0).all() and (factor[own] > 1.0).all()
