"""From a data set's healthy logs to what healthy units and logs differ by: ``fdd train --spreads``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from fdd.campaign.dataset import Dataset
from fdd.campaign.spreads import Spread, UnitLogs, learnt_spread
from fdd.campaign.units import How, for_each_unit
from fdd.diagnosis.baseline import baseline_of, effects_of, histories_of, history_of
from fdd.diagnosis.random_effects import log_equations, own_columns
from fdd.errors import InputError
from fdd.identification import identify_unit
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import BalanceSpread, CoefficientSpread, Spreads, first_effects, shipped_spreads
from fdd.unit import Unit

Array = NDArray[np.float64]

LEAST_UNITS = 20
"""Units below which nothing is said of what units differ by."""
DIGITS = 4


def learn_spreads(directories: Sequence[str], **how: Unpack[How]) -> Spreads:
    """Learn from healthy logs and healthy twins of data sets with baselines.

    Raises
    ------
    InputError : not a data set, without baselines, or too few units.
    """
    sets = [Dataset.load(d) for d in directories]
    units = [f"{k}/{unit}" for k, data in enumerate(sets) for unit in data.units]
    if len(units) < LEAST_UNITS:
        raise InputError(
            f"{len(units)} units: at least {LEAST_UNITS} are needed to learn what units differ by",
            mend="leave --spreads out, or generate more units",
        )
    places = [str(data.directory) for data in sets]
    told = for_each_unit(partial(_equations, places), units, **how)
    data = ", ".join(f"{d.recipe.name} (seed {d.recipe.seed}, {len(d.units)} units)" for d in sets)
    return spreads_of(told, data)


Equations = dict[str, UnitLogs]


def spreads_of(units: Sequence[Equations], data: str) -> Spreads:
    """Fit each balance to what units' logs tell of it; `data` says in words what they are."""
    before = shipped_spreads()
    out = {}
    for name, old in before.balances.items():
        logs = [u[name] for u in units if name in u]
        if len(logs) < LEAST_UNITS:
            out[name] = old
            continue
        spread = learnt_spread(name, logs, first_effects(name, before))
        out[name] = _balance(name, spread, old)
    return Spreads(data=data, balances=out)


def _balance(name: str, spread: Spread, old: BalanceSpread) -> BalanceSpread:
    coefficients = dict(old.coefficients)
    own = [c for c, mine in zip(BALANCES[name].columns, own_columns(name), strict=True) if mine]
    for k, c in enumerate(own):
        coefficients[c] = CoefficientSpread(
            mean=_rounded(spread.mean[k]), units=_rounded(spread.units[k]),
            between=tuple(_rounded(x) for x in spread.between[:, k]), logs=round(float(spread.logs[k]), 1),
            within=old.coefficients[c].within, wander=old.coefficients[c].wander,
        )  # fmt: skip
    return BalanceSpread(noise=_rounded(spread.noise), coefficients=coefficients)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


@dataclass(frozen=True)
class HealthyLogs:
    """A unit's profile, its baseline logs' balances, and its healthy logs' and twins' by file."""

    unit: Unit
    baseline: list[BalanceHistory]
    healthy: list[tuple[str, BalanceHistory]]


def healthy_logs(places: Sequence[str], place: str, spreads: Spreads | None = None) -> HealthyLogs:
    """A unit of one of several data sets, identified from its own baseline.

    Parameters
    ----------
    places : folders. place : ``k/unit``, of the k-th. spreads : of a model; None takes the shipped ones.
    """
    k, _, name = place.partition("/")
    data = Dataset.load(places[int(k)])
    runs = data.baseline(name)
    unit = identify_unit(runs, data.base_unit(name), name).unit
    baseline = histories_of(unit, runs)
    unit.baseline = baseline_of(baseline, spreads=spreads)
    effects = effects_of(unit, spreads)
    logs = [data.samples(e) if e.healthy else data.twin(e) for e in data.logs_of(name)]
    entries = data.logs_of(name)
    found = [(e.file, history_of(log, unit, effects)) for e, log in zip(entries, logs, strict=True) if log]
    return HealthyLogs(unit, baseline, found)


def _equations(places: list[str], place: str) -> list[Equations]:
    logs = healthy_logs(places, place)
    out: Equations = {}
    for name in BALANCES:
        known = None if logs.unit.baseline is None else logs.unit.baseline.balances.get(name)
        told = []
        for history in [*logs.baseline, *(x for _, x in logs.healthy)]:
            conditions = history.conditions(name)
            if conditions is None:
                continue
            m, v, rows, variance = history.sums()[name]
            if known is not None and BALANCES[name].cumulative:
                # As the baseline takes its logs: what a law errs by over a frame is its rows' noise.
                share = np.minimum(variance / known.noise**2, 1.0)
                m, v = m * share[:, None, None], v * share[:, None]
            told.append(log_equations(name, (m, v, rows, variance), conditions, first_effects(name)))
        if told:
            information, vector, each = (np.array(x) for x in zip(*told, strict=True))
            out[name] = UnitLogs(information, vector, each)
    return [out]
