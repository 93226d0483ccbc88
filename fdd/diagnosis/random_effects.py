"""A unit's own log-to-log variances, moderated by the population's.

The coefficients of a balance in log l of unit u are ``θ = μ_u + δ_l`` with ``μ_u ~ N(m, S)`` and
``δ_l ~ N(0, Q_l)``. A population tells Q (`fdd.campaign.spreads`), but units differ in it: one's law fits
better than another's. Of a unit with three healthy logs the variances are moderated towards the population's
(Smyth 2004, doi 10.2202/1544-6115.1027).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import BLOCK_FRAMES
from fdd.residuals.effects import Effects, LogConditions
from fdd.residuals.normal_equations import marginalised

Array = NDArray[np.float64]

PRIOR_LOGS = 3.0
"""Logs that the population's variance counts for in a unit's own: see `moderation`."""
ITERATIONS = 5
MODERATION = (0.05, 100.0)
"""Bounds of a unit's variance over the population's."""


def scattered(information: Array, vector: Array, effects: Effects) -> tuple[Array, float]:
    """Sum of squares (n, n) of the scores of a log's stretches at its own coefficients, and their
    overdispersion, at least 1.

    The latter is the dispersion of a quasi-likelihood (McCullagh 1983, doi 10.1214/aos/1176346056), averaged
    over the coefficients by the log's information.
    """
    prior, total = np.linalg.inv(effects.covariance), information.sum(axis=0)
    inverse = np.linalg.inv(prior + total)
    rest = vector - information @ (inverse @ (prior @ effects.mean + vector.sum(axis=0)))
    starts = np.arange(0, len(rest), BLOCK_FRAMES)
    scores = np.add.reduceat(rest, starts, axis=0)
    squares = np.asarray(scores.T @ scores)
    freedom = float(np.sum(inverse * total))  # effective number of coefficients
    return squares, max(float(np.sum(inverse * squares)) / freedom, 1.0) if freedom > 0.0 else 1.0


def log_equations(
    name: str, sums: tuple[Array, Array, Array, Array], conditions: LogConditions, effects: Effects
) -> tuple[Array, Array, LogConditions]:
    """What one log tells of the coefficients that are the unit's own: information, vector and conditions.

    What belongs to the load is marginalised.

    Parameters
    ----------
    sums : of `BalanceHistory.sums`. conditions : of the log. effects : before anything was learnt.
    """
    m, v, _, _ = sums
    m, v = marginalised(m, v, effects.wander)
    _, over = scattered(m, v, effects)
    own = BALANCES[name].own
    total, vector = m.sum(axis=0) / over, v.sum(axis=0) / over
    if not own.all():
        spread = np.square(effects.units[~own]) + effects.between_logs(conditions)[~own]
        inside = np.linalg.inv(total[np.ix_(~own, ~own)] + np.diag(1.0 / spread))
        across = total[np.ix_(own, ~own)] @ inside
        healthy = effects.mean[~own] / spread
        vector = vector[own] - across @ (vector[~own] + healthy)
        total = total[np.ix_(own, own)] - across @ total[np.ix_(~own, own)]
    return total, vector, conditions


class LogEffects(NamedTuple):
    """Posterior of one unit's mean and of its logs' departures from it.

    Attributes
    ----------
    mean, variance : (n,) of the unit. squares : (l, n) expected squares of the departures. told : (l, n),
        share of each that the log tells. distance : (l,) expected squares over their variances, summed.
    """

    mean: Array
    variance: Array
    squares: Array
    told: Array
    distance: Array


def log_effects(information: Array, vector: Array, variances: Array, mean: Array, units: Array) -> LogEffects:
    """Expectations of a unit's random effects.

    Parameters
    ----------
    information, vector : (l, n, n) and (l, n) of its logs. variances : (l, n) of their departures.
    mean, units : (n,) of units' coefficients, and their variance.
    """
    scale = np.sqrt(variances)
    inside = np.linalg.inv(np.eye(mean.size) + information * scale[:, :, None] * scale[:, None, :])
    v = inside * scale[:, :, None] * scale[:, None, :]
    va = v @ information
    wide = information - information @ va
    kept = vector - np.einsum("lji,lj->li", va, vector)
    p = np.linalg.inv(np.diag(1.0 / units) + wide.sum(axis=0))
    own_mean = p @ (mean / units + kept.sum(axis=0))
    d = np.einsum("lij,lj->li", v, vector - information @ own_mean)
    of_mean = np.einsum("lij,jk,lik->li", va, p, va)
    own = np.einsum("lii->li", v)
    told = np.clip(1.0 - own / variances, 0.0, 1.0)
    distance = np.sum((np.square(d) + of_mean) / variances, axis=1)
    return LogEffects(own_mean, np.diag(p), np.square(d) + own + of_mean, told, distance)


def moderation(name: str, logs: Sequence[tuple[Array, Array, LogConditions]], effects: Effects) -> Array:
    """A unit's log-to-log variance of each coefficient over the population's, (columns,); 1 for the load's.

    Its likeliest value under an inverse gamma prior about 1, by expectation maximisation: logs that tell
    nothing leave it at 1.

    Parameters
    ----------
    logs : by `log_equations`.
    """
    own = BALANCES[name].own
    information, vector = (np.array([log[k] for log in logs]) for k in (0, 1))
    usual = np.array([effects.between_logs(log[2])[own] for log in logs])
    factor = np.ones(usual.shape[1])
    for _ in range(ITERATIONS):
        found = log_effects(
            information, vector, usual * factor, effects.mean[own], np.square(effects.units[own])
        )
        factor = (PRIOR_LOGS + np.sum(found.squares / usual, axis=0)) / (PRIOR_LOGS + len(logs))
        factor = factor.clip(*MODERATION)
    out = np.ones(own.size)
    out[own] = factor
    return out


def moderated(effects: Effects, factor: Array) -> Effects:
    """The effects of a unit whose log-to-log variances are so much the population's, (columns,)."""
    return replace(effects, between=effects.between * np.sqrt(factor))
