"""A unit's healthy balances: mean and covariance of their coefficients, from its healthy logs.

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

from fdd.errors import InputError
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import BLOCK_FRAMES, FRAME_S, BinMaker
from fdd.residuals.compiled import Array
from fdd.residuals.effects import Effects, LogConditions, Spreads, first_effects, usual_conditions, with_logs
from fdd.residuals.normal_equations import marginalised
from fdd.samples import Samples
from fdd.unit import BalanceBaseline, Baseline, Unit

Sums = tuple[Array, Array, Array, Array]
"""Of a log: what `BalanceHistory.sums` gives of a balance."""

LEAST_BASELINE_FRAMES = 10
BASELINE_VERSION = "17"
RESCALED = {"refeed": {str(version) for version in range(16)}}
"""Balance to versions whose columns had another scale: what they learnt of it counts for nothing."""
PRIOR_LOGS = 3.0
"""Logs that the population's variance counts for in a unit's own: see `moderation`."""
ITERATIONS = 5
MODERATION = (0.05, 100.0)
"""Bounds of a unit's variance over the population's."""


def history_of(samples: Samples, unit: Unit, effects: dict[str, Effects]) -> BalanceHistory:
    """The balances of one whole log."""
    maker, history = BinMaker(unit), BalanceHistory(unit, effects)
    for first, bins in maker.stretches(samples):
        history.push(first, bins)
    history.push(*maker.push(None))
    return history


def histories_of(unit: Unit, logs: Sequence[Samples]) -> list[BalanceHistory]:
    """The balances of healthy logs, as the data sheet has them, for `baseline_of`."""
    plain = unit.model_copy(deep=True)
    plain.baseline = None
    effects = {name: first_effects(name, unit=unit) for name in BALANCES}
    histories = [history_of(log, plain, effects) for log in logs]
    if sum(len(x.frames) for x in histories) < LEAST_BASELINE_FRAMES:
        return histories
    # The attenuation by errors in variables is proportional to the coefficient: repeat with that estimate.
    for name, known in baseline_of(histories).balances.items():
        effects[name] = replace(effects[name], mean=np.array(known.mean))
    return [history_of(log, plain, effects) for log in logs]


def add_baseline(unit: Unit, logs: Sequence[Samples], spreads: Spreads | None = None) -> Unit:
    """A copy of the unit with the baseline of these healthy logs, which it was identified from; see
    `baseline_of`. Raises InputError: the logs are too short."""
    out = unit.model_copy(deep=True)
    out.baseline = baseline_of(histories_of(unit, logs), spreads=spreads)
    return out


def baseline_of(histories: Sequence[BalanceHistory], spreads: Spreads | None = None) -> Baseline:
    """The baseline of the balance histories of healthy logs, by `histories_of`.

    Each log's coefficients are a draw of what differs from log to log about the unit's own, so three short
    logs determine a unit better than one long one. `spreads` are what healthy units and logs differ by; None
    takes the shipped ones.

    Raises
    ------
    InputError : the logs are too short.
    """
    seconds = FRAME_S * sum(len(x.frames) for x in histories)
    if seconds < (least := LEAST_BASELINE_FRAMES * FRAME_S):
        problem = f"healthy logs of {seconds:.0f} s in all are too short"
        raise InputError(problem, mend=f"record at least {least:.0f} s of healthy motion")
    found: dict[str, BalanceBaseline] = {}
    for name in BALANCES:
        logs = [(x.sums()[name], c) for x in histories if (c := x.conditions(name)) is not None]
        if logs:
            sums, conditions = zip(*logs, strict=True)
            effects = first_effects(name, spreads, histories[0].unit)
            found[name] = _balance(effects, name, sums, conditions)
    return Baseline(version=BASELINE_VERSION, seconds=round(seconds, 1), balances=found)


def _balance(
    effects: Effects, name: str, sums: Sequence[Sums], conditions: Sequence[LogConditions]
) -> BalanceBaseline:
    information = np.linalg.inv(effects.known)
    vector = information @ effects.mean
    total, scatter = np.zeros_like(information), np.zeros_like(information)
    frames = np.concatenate([s[r > 0] for _, _, r, s in sums])
    noise = float(np.median(np.sqrt(frames))) ** 2
    if BALANCES[name].cumulative:  # a load's errors are those of its log, a chamber's those of the unit
        noise = structural_variance(sums, effects, noise)
    weighted = []
    for m, v, rows, variance in sums:
        share = np.minimum(variance / noise, 1.0)
        weighted.append((m * share[:, None, None], v * share[:, None], rows, variance))
    logs = [log_equations(name, s, c, effects) for s, c in zip(weighted, conditions, strict=True)]
    factor = moderation(name, logs, effects)
    effects = moderated(effects, factor)
    for (m, v, _, _), each in zip(weighted, conditions, strict=True):
        spread = np.sqrt(effects.between_logs(each))
        m, v = marginalised(m, v, effects.wander)
        scores, over = scattered(m, v, effects)
        total, scatter = total + m.sum(axis=0), scatter + scores
        # A log that the law fits badly counts for less than its rows: divided by its overdispersion.
        m, v = marginalised(m.sum(axis=0) / over, v.sum(axis=0) / over, spread)
        information, vector = information + m, vector + v
    covariance = np.linalg.inv(information)
    return BalanceBaseline(
        columns=list(BALANCES[name].columns), mean=_rounded(covariance @ vector),
        covariance=[_rounded(row) for row in 0.5 * (covariance + covariance.T)],
        information=[_rounded(row) for row in total], scatter=[_rounded(row) for row in scatter],
        moderation=_rounded(factor, 4), noise=float(f"{np.sqrt(noise):.5g}"),
        hops=frames.size,
    )  # fmt: skip


def structural_variance(sums: Sequence[Sums], effects: Effects, found: float) -> float:
    """Effective variance of a row when the model error is correlated over a frame.

    A frame's own least squares follows such errors and leaves small residuals. The distance of its
    coefficients from the log's, in units of a row's variance and per coefficient, is the mean square between
    groups of an analysis of variance; the median over frames is taken. `effects` are those before any log was
    seen, `found` is the variance to start from.
    """
    std = np.sqrt(np.diag(effects.covariance))
    prior = 1.0 / np.square(std)
    seen = [(m[r > 0], v[r > 0], s[r > 0]) for m, v, r, s in sums]
    least = 0.01 * found  # a log without noise leaves nothing between its frames either
    for _ in range(3):
        squares = []
        for m, v, s in seen:
            gram, moment = m * s[:, None, None], v * s[:, None]
            total = gram.sum(axis=0) / found + np.diag(prior)
            solution = np.linalg.solve(total, moment.sum(axis=0) / found + prior * effects.mean)
            values, vectors = np.linalg.eigh(gram * std * std[:, None])
            turned = (np.swapaxes(vectors, -1, -2) @ ((moment - gram @ solution) * std)[..., None])[..., 0]
            identified = values > 1e-6 * values.max(axis=1, keepdims=True)
            square = np.where(identified, np.square(turned) / np.where(identified, values, 1.0), 0.0)
            squares.append(square.sum(axis=1) / identified.sum(axis=1).clip(1))
        found = max(float(np.median(np.concatenate(squares))), least)
    return found


def _rounded(values: Array, digits: int = 8) -> list[float]:
    return [float(f"{v:.{digits}g}") for v in values]


def effects_of(unit: Unit, spreads: Spreads | None = None) -> dict[str, Effects]:
    """The prior for a log of the unit: from its baseline, or from the population where it has none.

    `spreads` are what healthy units differ by, of a model; None takes the shipped ones.
    """
    out = {name: first_effects(name, spreads, unit) for name in BALANCES}
    if unit.baseline is None:
        return out
    version = unit.baseline.version
    for name, known in unit.baseline.balances.items():
        columns = BALANCES[name].columns if name in BALANCES else ()
        if known.columns != list(columns) or version in RESCALED.get(name, ()):
            continue
        mean, covariance = np.array(known.mean), np.array(known.covariance)
        effects = replace(out[name], mean=mean, known=covariance, noise=known.noise)
        if known.information and version == BASELINE_VERSION:  # of another version it is about another wander
            information, scatter = np.array(known.information), np.array(known.scatter)
            effects = replace(effects, information=information, scatter=scatter)
        if known.moderation:
            effects = moderated(effects, np.array(known.moderation))
        out[name] = with_logs(effects, usual_conditions(known.noise))
    return out


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
    name: str, sums: Sums, conditions: LogConditions, effects: Effects
) -> tuple[Array, Array, LogConditions]:
    """What one log tells of the coefficients that are the unit's own: information, vector and conditions.

    What belongs to the load is marginalised. `effects` are those before anything was learnt.
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
    """Expectations of a unit's random effects, by information (l, n, n) and vectors (l, n) of its logs, the
    variances (l, n) of their departures, and mean and variance (n,) of units' coefficients."""
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

    Its likeliest value under an inverse gamma prior about 1, by expectation maximisation over logs as
    `log_equations` gives them: those that tell nothing leave it at 1.
    """
    own = BALANCES[name].own
    information, vector = (np.array([log[k] for log in logs]) for k in (0, 1))
    usual = np.array([effects.between_logs(log[2])[own] for log in logs])
    factor = np.ones(usual.shape[1])
    mean, units = effects.mean[own], np.square(effects.units[own])
    for _ in range(ITERATIONS):
        found = log_effects(information, vector, usual * factor, mean, units)
        factor = (PRIOR_LOGS + np.sum(found.squares / usual, axis=0)) / (PRIOR_LOGS + len(logs))
        factor = factor.clip(*MODERATION)
    out = np.ones(own.size)
    out[own] = factor
    return out


def moderated(effects: Effects, factor: Array) -> Effects:
    """The effects of a unit whose variances, from log to log and within one, are so much the population's,
    (columns,): air that goes in and out of solution does both."""
    root = np.sqrt(factor)
    return replace(effects, between=effects.between * root, within=effects.within * root)
