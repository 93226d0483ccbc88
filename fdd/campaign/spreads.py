"""What healthy units, and the healthy logs of one unit, differ by: ``fdd train --spreads``.

The coefficients of a balance in log l of unit u are ``θ = μ_u + δ_l`` with ``μ_u ~ N(m, S)`` and
``δ_l ~ N(0, Q_l / w_l)``. ``Q_l = Σ q_k² c_lk`` goes by the log's conditions (`LogConditions`), and w_l,
gamma distributed, makes the logs' differences Student's t of ν degrees of freedom (Lange, Little and Taylor
1989, doi 10.1080/01621459.1989.10478852). S, q and ν are the likeliest, by expectation conditional
maximisation (Liu and Rubin 1995, Statistica Sinica 5, 19): a log that tells little of a coefficient says
little of its spread. Within a log the coefficients of frame h are ``θ + ω_h`` with ``ω_h ~ N(0, W)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import digamma

from fdd.campaign.dataset import Dataset, How, over_units
from fdd.diagnosis.baseline import (
    Sums,
    add_baseline,
    baseline_of,
    effects_of,
    histories_of,
    history_of,
    log_effects,
    log_equations,
)
from fdd.errors import InputError
from fdd.identification.identify import identify_unit
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import (
    BalanceSpread,
    CoefficientSpread,
    Effects,
    LogConditions,
    Spreads,
    first_effects,
    shipped_spreads,
    usual_conditions,
)
from fdd.residuals.normal_equations import marginalised
from fdd.unit import Unit

Array = NDArray[np.float64]

ITERATIONS, WANDER_ITERATIONS = 200, 40
FREEDOMS = (1.0, 30.0)
"""Range of ν: beyond it logs' differences are as good as normal."""
LEAST_SHARE = 0.02
"""Of what was assumed before, that a spread is never taken below: no population shows that units do not
differ."""
LEAST_UNITS = 20
"""Units below which nothing is said of what units differ by."""
WANDER_LOGS = 200
"""Logs that what coefficients wander by is learnt from, evenly taken among all."""
LEAST_WANDER = 0.1
"""Of what a coefficient changes by in minutes, that it wanders by at least."""
LEAST_FRAMES = 8
"""Frames of a log below which it says nothing of that."""
ASSUMED, STEADY = ("drive",), ("shaft",)
"""Balances of which a simulation teaches nothing, as no simulated drive is off its command, or not how frames
wander, as no simulated shaft runs out."""
Frames = tuple[Sums, LogConditions]
"""Of a log, in a balance: what its frames came to, and its conditions."""


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


def learnt_spread(name: str, units: Sequence[UnitLogs], first: Effects) -> Spread:
    """Fit the model to one balance, from what was assumed `first`."""
    own = BALANCES[name].own
    m, units_variance = first.mean[own], np.square(first.units[own])
    assumed = first.between_logs(usual_conditions(first.noise))[own]
    least = np.square(LEAST_SHARE) * assumed
    conditions = np.concatenate([u.conditions for u in units])
    usual = np.median(conditions, axis=0)
    usual[2:] = 1.0
    parts = 0.3 * assumed / usual[:, None]
    freedom = 4.0
    weights = [np.ones(len(u.vector)) for u in units]
    for _ in range(ITERATIONS):
        found = [
            log_effects(u.information, u.vector, u.conditions @ parts / w[:, None], m, units_variance)
            for u, w in zip(units, weights, strict=True)
        ]
        squares = np.concatenate([w[:, None] * f.squares for f, w in zip(found, weights, strict=True)])
        weights = [
            (freedom + f.told.sum(axis=1)) / (freedom + f.distance / w)
            for f, w in zip(found, weights, strict=True)
        ]
        total = conditions @ parts
        excess = (squares - total) / np.square(total)
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
    told = np.concatenate([f.told for f in found]).sum(axis=0)
    noise = float(np.sqrt(usual[1]))
    return Spread(m, np.sqrt(units_variance), np.sqrt(parts), told, freedom, noise)


def _freedom(weights: Array, told: Array, freedom: float) -> float:
    """ν for which the weights are as likely as can be."""
    half = 0.5 * (freedom + told)
    known = np.mean(np.log(weights) - weights + digamma(half) - np.log(half))

    def slope(nu: float) -> float:
        return float(np.log(0.5 * nu) - digamma(0.5 * nu) + 1.0 + known)

    low, high = FREEDOMS
    return low if slope(low) <= 0.0 else high if slope(high) > 0.0 else float(brentq(slope, low, high))


def learnt_wander(name: str, logs: Sequence[Frames], first: Effects) -> Array:
    """Std (n,) of a balance's coefficients from frame to frame, √W, of largest restricted likelihood, by
    Schall's algorithm (1991, doi 10.1093/biomet/78.4.719), from what was assumed `first`. What is the load's
    stays as it was: simulated loads are simpler than real ones."""
    own, variance = BALANCES[name].own, np.square(first.wander)
    least = np.square(LEAST_WANDER * first.within)
    priors = [np.diag(1.0 / (np.square(first.units) + first.between_logs(c))) for _, c in logs]
    for _ in range(WANDER_ITERATIONS):
        squares, expected = np.zeros((2, variance.size))
        for ((information, vector, *_), _), prior in zip(logs, priors, strict=True):
            m, v = marginalised(information, vector, np.sqrt(variance))
            covariance = np.linalg.inv(prior + m.sum(axis=0))
            scores = v - m @ (covariance @ (prior @ first.mean + v.sum(axis=0)))
            squares += np.square(scores).sum(axis=0)
            # The log's own coefficients follow its frames.
            expected += np.einsum("hii->i", m) - np.einsum("hij,hji->i", m @ covariance, m)
        learnt = own & (expected > 0.0)
        ratio = squares / np.where(learnt, expected, 1.0)
        variance = np.where(learnt, np.maximum(variance * ratio, least), variance)
    return np.sqrt(variance)


def learn_spreads(directories: Sequence[str | Path], **how: Unpack[How]) -> Spreads:
    """Learn from healthy logs and healthy twins of data sets with baselines; an InputError where one is no
    data set, or units are too few."""
    sets = [Dataset.load(d) for d in directories]
    if (number := sum(len(data.units) for data in sets)) < LEAST_UNITS:
        problem = f"{number} units: at least {LEAST_UNITS} are needed to learn what units differ by"
        raise InputError(problem, mend="leave --spreads out, or generate more units")
    units = over_units(_frames, directories, **how)
    before = shipped_spreads()
    balances = dict(before.balances)
    for name, old in before.balances.items():
        mine = [unit[name] for unit in units if name in unit]
        if len(mine) < LEAST_UNITS or name in ASSUMED:
            continue
        first = first_effects(name, before)
        if name not in STEADY:
            logs = [log for unit in mine for log in unit if np.count_nonzero(log[0][2]) >= LEAST_FRAMES]
            step = max(len(logs) // WANDER_LOGS, 1)
            first = replace(first, wander=learnt_wander(name, logs[::step], first))
        found = learnt_spread(name, [_unit_logs(name, unit, first) for unit in mine], first)
        balances[name] = _balance(name, found, old, first.wander)
    told = ", ".join(f"{d.recipe.name} (seed {d.recipe.seed}, {len(d.units)} units)" for d in sets)
    return Spreads(data=told, balances=balances)


def _unit_logs(name: str, logs: Sequence[Frames], first: Effects) -> UnitLogs:
    told = [log_equations(name, sums, conditions, first) for sums, conditions in logs]
    return UnitLogs(*(np.array(x) for x in zip(*told, strict=True)))


def _balance(name: str, spread: Spread, old: BalanceSpread, wander: Array) -> BalanceSpread:
    """What was learnt, to four digits, over what the loads' coefficients have from before."""

    def rounded(value: float) -> float:
        return float(f"{value:.4g}")

    coefficients = dict(old.coefficients)
    own = [c for c, mine in zip(BALANCES[name].columns, BALANCES[name].own, strict=True) if mine]
    for k, c in enumerate(own):
        coefficients[c] = CoefficientSpread(
            mean=rounded(spread.mean[k]), units=rounded(spread.units[k]),
            between=tuple(rounded(x) for x in spread.between[:, k]), logs=round(float(spread.logs[k]), 1),
            within=old.coefficients[c].within, wander=rounded(wander[BALANCES[name].columns.index(c)]),
        )  # fmt: skip
    return BalanceSpread(noise=rounded(spread.noise), coefficients=coefficients)


def identified_unit(data: Dataset, unit: str, spreads: Spreads | None = None) -> Unit:
    """The unit's profile from its baseline runs and the profile that it was varied from."""
    runs = data.baseline(unit)
    if not runs:
        mend = "set baseline: true in the recipe"
        raise InputError("data set without baseline runs", where=data.directory, mend=mend)
    return add_baseline(identify_unit(runs, data.base_unit(unit), unit).unit, runs, spreads)


def healthy_logs(
    data: Dataset, name: str, spreads: Spreads | None = None
) -> tuple[Unit, list[BalanceHistory], list[tuple[str, BalanceHistory]]]:
    """A unit of a data set, identified from its own baseline with a model's `spreads`, else the shipped: its
    profile, its baseline logs' balances, and its healthy logs' and twins' by file."""
    runs = data.baseline(name)
    unit = identify_unit(runs, data.base_unit(name), name).unit
    baseline = histories_of(unit, runs)
    unit.baseline = baseline_of(baseline, spreads=spreads)
    effects = effects_of(unit, spreads)
    logs = ((e.file, data.samples(e) if e.healthy else data.twin(e)) for e in data.logs_of(name))
    return unit, baseline, [(f, history_of(log, unit, effects)) for f, log in logs if log]


def _frames(data: Dataset, unit: str) -> list[dict[str, list[Frames]]]:
    profile, baseline, healthy = healthy_logs(data, unit)
    out: dict[str, list[Frames]] = {}
    for name, balance in BALANCES.items():
        known = None if profile.baseline is None else profile.baseline.balances.get(name)
        for history in [*baseline, *(x for _, x in healthy)]:
            conditions = history.conditions(name)
            if conditions is None:
                continue
            m, v, rows, variance = history.sums()[name]
            if known is not None and balance.cumulative:
                # As the baseline takes its logs: what a law errs by over a frame is its rows' noise.
                share = np.minimum(variance / known.noise**2, 1.0)
                m, v = m * share[:, None, None], v * share[:, None]
            out.setdefault(name, []).append(((m, v, rows, variance), conditions))
    return [out]
