"""What healthy units, and the healthy logs of one unit, differ by: a hierarchical model of many units' logs.

The coefficients of a balance in log l of unit u are ``θ = μ_u + δ_l`` with ``μ_u ~ N(m, S)`` and
``δ_l ~ N(0, Q_l / w_l)``. ``Q_l = Σ q_k² c_lk`` goes by the log's conditions (`LogConditions`), and w_l,
gamma distributed, makes the logs' differences Student's t of ν degrees of freedom (Lange, Little and Taylor
1989, doi 10.1080/01621459.1989.10478852). S, q and ν are the likeliest, by expectation conditional
maximisation (Liu and Rubin 1995, Statistica Sinica 5, 19): a log that tells little of a coefficient says
little of its spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import digamma

from fdd.diagnosis.random_effects import log_effects, own_columns
from fdd.residuals.effects import Effects, usual_conditions

Array = NDArray[np.float64]

ITERATIONS = 200
FREEDOMS = (1.0, 30.0)
"""Range of ν: beyond it logs' differences are as good as normal."""
LEAST_SHARE = 0.02
"""Of what was assumed before, that a spread is never taken below: no population shows that units do not
differ."""


@dataclass(frozen=True)
class UnitLogs:
    """One balance in a unit's healthy logs.

    Attributes
    ----------
    information, vector : (l, n, n) and (l, n), what each log tells of its coefficients, over its own
        overdispersion. conditions : (l, 5), `LogConditions`.
    """

    information: Array
    vector: Array
    conditions: Array


@dataclass(frozen=True)
class _Unit:
    """Expectations of one unit: its mean (n,) and its variance; of each log the squares of its differences
    times its weight (l, n), the share of each that it tells (l, n), and its weight (l,)."""

    mean: Array
    variance: Array
    squares: Array
    told: Array
    weights: Array


@dataclass(frozen=True)
class Spread:
    """What was learnt of a balance, (n,) each.

    Attributes
    ----------
    mean, units : of units' coefficients, and their std. between : (5, n), q. logs : how many logs'
        worth of information these rest on. freedom : ν, of the whole balance. noise : usual std of a row.
    """

    mean: Array
    units: Array
    between: Array
    logs: Array
    freedom: float
    noise: float


def learnt_spread(
    name: str, units: Sequence[UnitLogs], first: Effects, iterations: int = ITERATIONS
) -> Spread:
    """Fit the model to one balance, from what was assumed `first`."""
    own = own_columns(name)
    m, units_variance = first.mean[own], np.square(first.units[own])
    assumed = first.between_logs(usual_conditions(first.noise))[own]
    least = np.square(LEAST_SHARE) * assumed
    conditions = np.concatenate([u.conditions for u in units])
    usual = np.median(conditions, axis=0)
    usual[2:] = 1.0
    parts = 0.3 * assumed / usual[:, None]
    freedom = 4.0
    weights = [np.ones(len(u.vector)) for u in units]
    for _ in range(iterations):
        found = [_unit(u, w, m, units_variance, parts, freedom) for u, w in zip(units, weights, strict=True)]
        weights = [f.weights for f in found]
        total = conditions @ parts
        excess = (np.concatenate([f.squares for f in found]) - total) / np.square(total)
        for k, part in enumerate(parts):
            has = conditions[:, k] > 0.0
            if has.any():
                moved = part + np.square(part) * np.mean(conditions[has, k, None] * excess[has], axis=0)
                parts[k] = np.maximum(moved, least / usual[k] * (1.0 if k == 0 else 1e-3))
        means = np.array([f.mean for f in found])
        m = means.mean(axis=0)
        scatter = np.square(means - m) + np.array([f.variance for f in found])
        units_variance = np.maximum(scatter.mean(axis=0), least)
        freedom = _freedom(
            np.concatenate(weights), np.concatenate([f.told.sum(axis=1) for f in found]), freedom
        )
    told = np.concatenate([f.told for f in found])
    return Spread(
        m,
        np.sqrt(units_variance),
        np.sqrt(parts),
        told.sum(axis=0),
        freedom,
        float(np.sqrt(usual[1])),
    )


def _unit(logs: UnitLogs, weights: Array, m: Array, units: Array, parts: Array, freedom: float) -> _Unit:
    found = log_effects(logs.information, logs.vector, logs.conditions @ parts / weights[:, None], m, units)
    distance = found.distance / weights
    fresh = (freedom + found.told.sum(axis=1)) / (freedom + distance)
    return _Unit(found.mean, found.variance, weights[:, None] * found.squares, found.told, fresh)


def _freedom(weights: Array, told: Array, freedom: float) -> float:
    """ν for which the weights are as likely as can be, by bisection of its logarithm."""
    known = np.mean(
        np.log(weights) - weights + digamma(0.5 * (freedom + told)) - np.log(0.5 * (freedom + told))
    )
    low, high = np.log(FREEDOMS)
    for _ in range(40):
        half = 0.5 * (low + high)
        nu = 0.5 * np.exp(half)
        low, high = (half, high) if np.log(nu) - digamma(nu) + 1.0 + known > 0.0 else (low, half)
    return float(np.exp(0.5 * (low + high)))
