"""What healthy units and logs differ by, learnt from logs drawn with known spreads."""

from __future__ import annotations

import numpy as np

from fdd.campaign.spreads import UnitLogs, learnt_spread
from fdd.diagnosis.random_effects import log_equations, own_columns, scattered
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import LogConditions, first_effects, usual_conditions
from fdd.residuals.normal_equations import marginalised

NAME = "torque"
LOGS = 9


def drawn(seed: int, units: int, freedom: float) -> tuple[list[UnitLogs], np.ndarray, np.ndarray, np.ndarray]:
    """Units' logs, with the mean, the std of units and q (5, n) that they were drawn with."""
    rng, first = np.random.default_rng(seed), first_effects(NAME)
    n = first.mean.size
    mean = first.mean + first.units
    spread = 0.5 * first.units
    always = 0.3 * np.sqrt(first.between_logs(usual_conditions(first.noise)))
    q = np.array([always, always / first.noise, *np.zeros((3, n))])
    out = []
    for _ in range(units):
        own = mean + spread * rng.normal(size=n)
        information, vector, conditions = [], [], []
        for _ in range(LOGS):
            each = LogConditions(1.0, float(first.noise**2 * rng.uniform(0.2, 4.0)), 0.0, 0.0, 0.0)
            weight = rng.gamma(0.5 * freedom, 2.0 / freedom)
            std = np.sqrt(np.array(each) @ np.square(q) / weight)
            theta = own + std * rng.normal(size=n)
            x = rng.normal(size=(40, n)) / (0.5 * always)
            information.append(x.T @ x)
            vector.append(x.T @ (x @ theta + rng.normal(size=40)))
            conditions.append(each)
        out.append(UnitLogs(np.array(information), np.array(vector), np.array(conditions)))
    return out, mean, spread, q


def test_spreads_are_those_that_logs_were_drawn_with() -> None:
    """Test: 80 units of nine logs, Student's t of five degrees of freedom.

    Expected: each std within 25 %, six times what 720 logs leave, the units' mean within four of its own,
    and the degrees of freedom between three and nine.
    """
    units, mean, spread, q = drawn(1, 80, 5.0)
    found = learnt_spread(NAME, units, first_effects(NAME))
    usual = np.array(usual_conditions(first_effects(NAME).noise))
    np.testing.assert_allclose(usual @ np.square(found.between), usual @ np.square(q), rtol=0.5)
    np.testing.assert_allclose(found.units, spread, rtol=0.35)
    assert np.all(np.abs(found.mean - mean) < 4.0 * spread / np.sqrt(80.0))
    assert 3.0 < found.freedom < 9.0
    assert np.all(found.logs > 0.5 * 80 * LOGS)


def test_what_belongs_to_the_load_is_marginalised() -> None:
    """Test: the force balance's normal equations. Expected: those of the joint normal density's marginal."""
    rng, first = np.random.default_rng(4), first_effects("force")
    own = own_columns("force")
    n = own.size
    assert not own[list(BALANCES["force"].columns).index("spring")] and own.sum() == 2
    x = rng.normal(size=(8, 60, n)) / np.sqrt(np.diag(first.covariance))
    m = np.einsum("hki,hkj->hij", x, x)
    v = np.einsum("hki,hk->hi", x, x @ first.mean + rng.normal(size=(8, 60)))
    conditions = LogConditions(1.0, first.noise**2, 0.0, 0.0, 0.0)
    sums = m, v, np.full(8, 60.0), np.full(8, first.noise**2)
    information, vector, told = log_equations("force", sums, conditions, first)
    assert told == conditions
    # The same by the dense joint covariance of all coefficients: a flat prior on the unit's own ones.
    wide, kept = marginalised(m, v, first.wander)
    over = scattered(wide, kept, first)[1]
    total, right = wide.sum(axis=0) / over, kept.sum(axis=0) / over
    prior = np.where(own, 0.0, 1.0 / (np.square(first.units) + first.between_logs(conditions)))
    covariance = np.linalg.inv(total + np.diag(prior))
    mean = covariance @ (right + prior * first.mean)
    inside = covariance[np.ix_(own, own)]
    np.testing.assert_allclose(np.linalg.inv(information), inside, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.solve(information, vector), mean[own], rtol=1e-6)
