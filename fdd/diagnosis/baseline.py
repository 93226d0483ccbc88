"""A unit's healthy balances: what its coefficients are, and how surely its healthy logs tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import Effects, first_effects
from fdd.residuals.ledger import Ledger, widened
from fdd.residuals.rows import BLOCK_HOPS, HOP_S, RowMaker
from fdd.samples import Samples
from fdd.unit import BalanceBaseline, Baseline, Unit

Array = NDArray[np.float64]

LEAST_HOPS = 10
BASELINE_VERSION = "6"


def ledger_of(samples: Samples, unit: Unit, effects: dict[str, Effects]) -> Ledger:
    """The balances of one whole log."""
    maker, ledger = RowMaker(unit), Ledger(unit, effects)
    ledger.push(*maker.push(samples))
    ledger.push(*maker.push(None))
    return ledger


def add_baseline(unit: Unit, logs: Sequence[Samples]) -> Unit:
    """A copy of the unit with the baseline of these healthy logs.

    Each log's coefficients are the unit's own and a draw of what differs from log to log
    (`Effects.between`), so three short
    logs know a unit better than one long one.

    Parameters
    ----------
    unit : identified profile. logs : the healthy logs that it was identified from.

    Raises
    ------
    InputError : the logs are too short.
    """
    plain = unit.model_copy(deep=True)
    plain.baseline = None
    first = {name: first_effects(name) for name in BALANCES}
    ledgers = [ledger_of(log, plain, first) for log in logs]
    hops = sum(len(x.hops) for x in ledgers)
    if hops < LEAST_HOPS:
        raise InputError(
            f"healthy logs of {hops * HOP_S:.0f} s in all are too short",
            mend=f"record at least {LEAST_HOPS * HOP_S:.0f} s of healthy motion",
        )
    found: dict[str, BalanceBaseline] = {}
    for name, effects in first.items():
        information = np.linalg.inv(effects.covariance)
        vector = information @ effects.mean
        told, scatter = np.zeros_like(information), np.zeros_like(information)
        sums = [s for s in (ledger.sums()[name] for ledger in ledgers) if s[2].any()]
        if not sums:
            continue
        noise = float(np.median(np.concatenate([s[r > 0] for _, _, r, s in sums])))
        if BALANCES[name].cumulative:  # a load's errors are those of its log, a chamber's those of the unit
            noise = structural_variance(sums, effects, noise)
        for m, v, _, variance in sums:
            share = np.minimum(variance / noise, 1.0)
            m, v = widened(m * share[:, None, None], v * share[:, None], effects.wander)
            told += m.sum(axis=0)
            scatter += scattered(m, v, effects)
            m, v = widened(m.sum(axis=0), v.sum(axis=0), effects.between)
            information, vector = information + m, vector + v
        covariance = np.linalg.inv(information)
        found[name] = BalanceBaseline(
            columns=list(BALANCES[name].columns),
            mean=_rounded(covariance @ vector),
            covariance=[_rounded(row) for row in 0.5 * (covariance + covariance.T)],
            information=[_rounded(row) for row in told],
            scatter=[_rounded(row) for row in scatter],
            noise=float(f"{np.sqrt(noise):.5g}"),
        )
    out = unit.model_copy(deep=True)
    out.baseline = Baseline(version=BASELINE_VERSION, seconds=round(hops * HOP_S, 1), balances=found)
    return out


def structural_variance(
    sums: Sequence[tuple[Array, Array, Array, Array]], effects: Effects, found: float
) -> float:
    """Variance of a row as coefficients see it: what a law leaves out hangs together over a hop.

    A hop's own best coefficients follow such errors and leave next to nothing. How far they lie from those
    of the whole log, in rows' units and per coefficient, is what a row is worth: the mean square between
    groups, as an analysis of variance takes it, as its median over hops.

    Parameters
    ----------
    sums : of each log, as `Ledger.sums` gives them. effects : before any log was seen. found : variance to
        start from.
    """
    std = np.sqrt(np.diag(effects.covariance))
    prior = 1.0 / np.square(std)
    seen = [(m[r > 0], v[r > 0], s[r > 0]) for m, v, r, s in sums]
    least = 0.01 * found  # a log without noise leaves nothing between its hops either
    for _ in range(3):
        squares = []
        for m, v, s in seen:
            gram, moment = m * s[:, None, None], v * s[:, None]
            total = gram.sum(axis=0) / found + np.diag(prior)
            solution = np.linalg.solve(total, moment.sum(axis=0) / found + prior * effects.mean)
            values, vectors = np.linalg.eigh(gram * std * std[:, None])
            turned = (np.swapaxes(vectors, -1, -2) @ ((moment - gram @ solution) * std)[..., None])[..., 0]
            told = values > 1e-6 * values.max(axis=1, keepdims=True)
            square = np.where(told, np.square(turned) / np.where(told, values, 1.0), 0.0)
            squares.append(square.sum(axis=1) / told.sum(axis=1).clip(1))
        found = max(float(np.median(np.concatenate(squares))), least)
    return found


def scattered(information: Array, vector: Array, effects: Effects) -> Array:
    """Sum of squares (n, n) of the scores of a log's stretches about its own coefficients."""
    prior = np.linalg.inv(effects.covariance)
    solution = np.linalg.solve(prior + information.sum(axis=0), prior @ effects.mean + vector.sum(axis=0))
    rest = vector - information @ solution
    starts = np.arange(0, len(rest), BLOCK_HOPS)
    scores = np.add.reduceat(rest, starts, axis=0)
    return np.asarray(scores.T @ scores)


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{v:.8g}") for v in values]


def effects_of(unit: Unit) -> dict[str, Effects]:
    """The effects that a log of the unit is held against: of its baseline, or of its data sheet alone."""
    out = {}
    for name in BALANCES:
        effects = first_effects(name)
        known = None if unit.baseline is None else unit.baseline.balances.get(name)
        if known is not None and known.columns == list(BALANCES[name].columns):
            covariance = np.array(known.covariance) + np.diag(effects.between**2)
            effects = replace(
                effects,
                mean=np.array(known.mean),
                covariance=covariance,
                noise=known.noise,
                information=np.array(known.information) if known.information else effects.information,
                scatter=np.array(known.scatter) if known.scatter else effects.scatter,
            )
        out[name] = effects
    return out
