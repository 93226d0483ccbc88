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
from scipy.optimize import minimize
from scipy.special import digamma
from scipy.stats import t as student

from fdd.diagnosis.baseline import scattered
from fdd.diagnosis.departures import LEAST_DIMENSIONS
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import Effects, LogConditions, usual_conditions
from fdd.residuals.normal_equations import widened

Array = NDArray[np.float64]

ITERATIONS = 200
TOLD = 0.3
"""Information of a coefficient in a log over that of its spread, from which its departure says something."""
ASSUMED_TAIL, ASSUMED_LOGS = (4.0, 1.0), 50
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
    runs: int
    """How many of them, the first ones, are the unit's baseline."""


@dataclass(frozen=True)
class Spread:
    """What was learnt of a balance, (n,) each.

    Attributes
    ----------
    mean, units : of units' coefficients, and their std. between : (5, n), q. logs : how many logs'
        worth of information these rest on. freedom : ν, of the whole balance. tail : of one direction
        given the others, see `fdd.residuals.effects.BalanceSpread`. noise : usual std of a row.
    """

    mean: Array
    units: Array
    between: Array
    logs: Array
    freedom: float
    tail: tuple[float, float]
    noise: float


def learnt_spread(
    name: str, units: Sequence[UnitLogs], first: Effects, iterations: int = ITERATIONS
) -> Spread:
    """Fit the model to one balance.

    Parameters
    ----------
    name : of the balance. units : each unit's logs. first : what was assumed before, where it starts from.
    """
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
    z = np.concatenate([_standardised(u, m, units_variance, parts, freedom) for u in units])
    return Spread(
        m,
        np.sqrt(units_variance),
        np.sqrt(parts),
        told.sum(axis=0),
        freedom,
        tail_of(z),
        float(np.sqrt(usual[1])),
    )


def _standardised(logs: UnitLogs, m: Array, units: Array, parts: Array, freedom: float) -> Array:
    """Departures of single coefficients of a unit's logs from its baseline, given those of the others."""
    runs, out = logs.runs, []
    q = logs.conditions @ parts
    wide, kept = [], []
    for a, b, std in zip(logs.information[:runs], logs.vector[:runs], np.sqrt(q[:runs]), strict=True):
        w, k = widened(a, b, std)
        wide.append(w)
        kept.append(k)
    known = np.linalg.inv(np.diag(1.0 / units) + np.sum(wide, axis=0))
    mean = known @ (m / units + np.sum(kept, axis=0))
    for a, b, variance in zip(logs.information[runs:], logs.vector[runs:], q[runs:], strict=True):
        prior = np.linalg.inv(known + np.diag(variance))
        inverse = np.linalg.inv(prior + a)
        drawn, by_one = inverse @ (b - a @ mean), inverse @ a
        told = np.diag(a) - np.einsum("ij,ij->j", a, by_one)
        size = (b - a @ mean - a @ drawn) / np.maximum(told, 1e-300)
        after = drawn[:, None] - size * by_one
        left = np.einsum("ij,ik,kj->j", after, prior, after)
        others = max(float(np.trace(by_one)) - 1.0, LEAST_DIMENSIONS)
        z = size * np.sqrt(told) / np.sqrt((freedom + left) / (freedom + others))
        out.append(z[told * np.diag(known + np.diag(variance)) > TOLD])
    return np.concatenate(out) if out else np.zeros(0)


def tail_of(z: Array) -> tuple[float, float]:
    """Degrees of freedom and scale of the Student's t that standardised departures follow, the likeliest.

    Few of them say nothing of a tail: `ASSUMED_TAIL` counts as much as `ASSUMED_LOGS` of them would.

    Examples
    --------
    >>> round(tail_of(np.zeros(0))[1])
    1
    """
    freedom, scale = ASSUMED_TAIL
    assumed = scale * student.ppf((np.arange(ASSUMED_LOGS) + 0.5) / ASSUMED_LOGS, freedom)
    z = np.concatenate([z, assumed])

    def misfit(p: Array) -> float:
        return -float(np.sum(student.logpdf(z, np.exp(p[0]), scale=np.exp(p[1]))))

    bounds = [(0.0, np.log(30.0)), (np.log(0.1), np.log(10.0))]
    found = np.exp(minimize(misfit, [np.log(freedom), np.log(scale)], bounds=bounds).x)
    return float(f"{found[0]:.3g}"), float(f"{found[1]:.3g}")


def log_equations(
    name: str, sums: tuple[Array, Array, Array, Array], conditions: LogConditions, effects: Effects
) -> tuple[Array, Array, LogConditions]:
    """What one log tells of the coefficients that are the unit's own: information, vector and conditions.

    What belongs to the load is marginalised.

    Parameters
    ----------
    sums : of `Ledger.sums`. conditions : of the log. effects : before anything was learnt.
    """
    m, v, _, _ = sums
    m, v = widened(m, v, effects.wander)
    _, over = scattered(m, v, effects)
    own = own_columns(name)
    total, vector = m.sum(axis=0) / over, v.sum(axis=0) / over
    if not own.all():
        spread = np.square(effects.units[~own]) + effects.between_logs(conditions)[~own]
        inside = np.linalg.inv(total[np.ix_(~own, ~own)] + np.diag(1.0 / spread))
        across = total[np.ix_(own, ~own)] @ inside
        healthy = effects.mean[~own] / spread
        vector = vector[own] - across @ (vector[~own] + healthy)
        total = total[np.ix_(own, own)] - across @ total[np.ix_(~own, own)]
    return total, vector, conditions


def own_columns(name: str) -> NDArray[np.bool_]:
    """Which coefficients of a balance are the unit's."""
    balance = BALANCES[name]
    return np.array([c not in balance.free for c in balance.columns])


@dataclass(frozen=True)
class _Unit:
    """Expectations of one unit: its mean (n,) and its variance; of each log the squares of its differences
    times its weight (l, n), the share of each that it tells (l, n), and its weight (l,)."""

    mean: Array
    variance: Array
    squares: Array
    told: Array
    weights: Array


def _unit(logs: UnitLogs, weights: Array, m: Array, units: Array, parts: Array, freedom: float) -> _Unit:
    q = logs.conditions @ parts
    scale = np.sqrt(q / weights[:, None])
    a, b = logs.information, logs.vector
    inside = np.linalg.inv(np.eye(m.size) + a * scale[:, :, None] * scale[:, None, :])
    v = inside * scale[:, :, None] * scale[:, None, :]
    va = v @ a
    wide = a - a @ va
    kept = b - np.einsum("lji,lj->li", va, b)
    p = np.linalg.inv(np.diag(1.0 / units) + wide.sum(axis=0))
    mean = p @ (m / units + kept.sum(axis=0))
    d = np.einsum("lij,lj->li", v, b - a @ mean)
    of_mean = np.einsum("lij,jk,lik->li", va, p, va)
    own = np.einsum("lii->li", v)
    told = np.clip(1.0 - own / np.square(scale), 0.0, 1.0)
    distance = np.sum((np.square(d) + of_mean) / q, axis=1)
    fresh = (freedom + told.sum(axis=1)) / (freedom + distance)
    squares = weights[:, None] * (np.square(d) + own + of_mean)
    return _Unit(mean, np.diag(p), squares, told, fresh)


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
