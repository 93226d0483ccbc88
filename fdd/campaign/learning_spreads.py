"""From a data set's healthy logs to what healthy units and logs differ by: ``fdd train --spreads``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from fdd.campaign.dataset import Dataset
from fdd.campaign.spreads import Spread, UnitLogs, learnt_spread, log_equations, own_columns, tail_of
from fdd.campaign.units import Progress, for_each_unit
from fdd.diagnosis.baseline import baseline_of, effects_of, ledger_of, ledgers_of
from fdd.diagnosis.departures import VAGUE, by_others, departures
from fdd.diagnosis.evidence import Evidence, course_of
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.hypotheses import hypotheses
from fdd.errors import InputError
from fdd.identification import identify_unit
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import BalanceSpread, CoefficientSpread, Spreads, first_effects, shipped_spreads
from fdd.residuals.ledger import Ledger
from fdd.unit import Unit

Array = NDArray[np.float64]

LEAST_UNITS = 20
"""Units below which nothing is said of what units differ by."""
CHANGES_UNITS = 60
"""Units at most, about, in whose logs changes are looked for."""
CHANGES_EVERY, CHANGES_MARGIN, MOST_FRAMES = 24, 16, 320
"""Frames between the onsets at which changes are looked for, from the log's ends, and of a log."""
CHANGE_FREEDOMS = (1.0, 2.0, 4.0, 8.0, 16.0, 30.0)
DIGITS = 4


class HealthyChange(NamedTuple):
    """A hypothesis's amplitude in a healthy log, over its standard deviation; how far the other directions of
    its balance depart (squared), and of how many coefficients the log tells."""

    balance: str
    z: float
    left: float
    dimensions: float

    def given_others(self, freedom: float) -> float:
        """The same given the others, in Student's t of all of them."""
        factor = by_others(freedom, np.array([self.left]), np.array([self.dimensions]))
        return self.z / float(np.sqrt(factor[0]))


def change_law(changes: Sequence[HealthyChange]) -> tuple[float, tuple[float, float]]:
    """Likeliest `BalanceSpread.change_freedom` and `change_tail`."""
    left, dimensions = (np.array([getattr(c, name) for c in changes]) for name in ("left", "dimensions"))
    z = np.array([c.z for c in changes])
    best = -np.inf, 0.0, (0.0, 0.0)
    for freedom in CHANGE_FREEDOMS:
        factor = by_others(freedom, left, dimensions)
        tail = tail_of(z / np.sqrt(factor))
        likely = student.logpdf(z / np.sqrt(factor), tail[0], scale=tail[1]) - 0.5 * np.log(factor)
        best = max(best, (float(likely.sum()), freedom, tail))
    return best[1:]


def learn_spreads(
    directories: Sequence[str], *, workers: int | None = 2, progress: Progress | None = None
) -> Spreads:
    """Learn from healthy logs and healthy twins of data sets with baselines.

    Parameters
    ----------
    directories : of the data sets. workers : processes. progress : (done, total) units.

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

    def half(done: int, total: int) -> None:
        if progress is not None:
            progress(done, 2 * total)

    def rest(done: int, total: int) -> None:
        if progress is not None:
            progress(total + done, 2 * total)

    told = for_each_unit(partial(_equations, places), units, workers=workers, progress=half)
    data = ", ".join(f"{d.recipe.name} (seed {d.recipe.seed}, {len(d.units)} units)" for d in sets)
    found = spreads_of(told, data)
    some = units[:: max(len(units) // CHANGES_UNITS, 1)]
    changes = for_each_unit(partial(_changes, places, found), some, workers=workers, progress=rest)
    for name, spread in found.balances.items():
        mine = [c for c in changes if c.balance == name]
        if len(mine) > LEAST_UNITS:
            spread.change_freedom, spread.change_tail = change_law(mine)
    return found


Equations = dict[str, UnitLogs]


def spreads_of(units: Sequence[Equations], data: str) -> Spreads:
    """Fit each balance to what units' logs tell of it.

    Parameters
    ----------
    units : balance to logs, of each unit. data : what they are, in words.
    """
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
    noise = _rounded(spread.noise)
    return BalanceSpread(
        noise=noise, freedom=_rounded(spread.freedom), tail=spread.tail, change_tail=old.change_tail,
        coefficients=coefficients,
    )  # fmt: skip


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


@dataclass(frozen=True)
class HealthyLogs:
    """A unit's profile, its baseline logs' balances, and its healthy logs' and twins' by file."""

    unit: Unit
    baseline: list[Ledger]
    healthy: list[tuple[str, Ledger]]


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
    baseline = ledgers_of(unit, runs)
    unit.baseline = baseline_of(baseline, spreads=spreads)
    effects = effects_of(unit, spreads)
    logs = [data.samples(e) if e.healthy else data.twin(e) for e in data.logs_of(name)]
    entries = data.logs_of(name)
    found = [(e.file, ledger_of(log, unit, effects)) for e, log in zip(entries, logs, strict=True) if log]
    return HealthyLogs(unit, baseline, found)


def _equations(places: list[str], place: str) -> list[Equations]:
    logs = healthy_logs(places, place)
    out: Equations = {}
    for name in BALANCES:
        known = None if logs.unit.baseline is None else logs.unit.baseline.balances.get(name)
        told = []
        for ledger in [*logs.baseline, *(x for _, x in logs.healthy)]:
            conditions = ledger.conditions(name)
            if conditions is None:
                continue
            m, v, rows, variance = ledger.sums()[name]
            if known is not None and BALANCES[name].cumulative:
                # As the baseline takes its logs: what a law errs by over a frame is its rows' noise.
                share = np.minimum(variance / known.noise**2, 1.0)
                m, v = m * share[:, None, None], v * share[:, None]
            told.append(log_equations(name, (m, v, rows, variance), conditions, first_effects(name)))
        if told:
            runs = sum(x.conditions(name) is not None for x in logs.baseline)
            information, vector, each = (np.array(x) for x in zip(*told, strict=True))
            out[name] = UnitLogs(information, vector, each, runs)
    return [out]


def _changes(places: list[str], spreads: Spreads, place: str) -> list[HealthyChange]:
    logs = healthy_logs(places, place, spreads)
    return [x for _, ledger in logs.healthy for x in healthy_changes(logs.unit, ledger, spreads)]


def healthy_changes(unit: Unit, ledger: Ledger, spreads: Spreads | None) -> list[HealthyChange]:
    """Changes of each hypothesis of one balance, over onsets in a healthy log."""
    each = [h for h in hypotheses(unit, effects_of(unit, spreads)) if len(h.columns) == 1]
    frames = min(len(ledger.hops), MOST_FRAMES)
    wide = {n: (m[:frames], v[:frames]) for n, (m, v) in ledger.widened().items()}
    evidence = Evidence(wide, ledger.expected(), from_start=True)
    mine = [h for h in each if evidence.shared(h)]
    out = []
    for onset in range(CHANGES_MARGIN, frames - CHANGES_MARGIN, CHANGES_EVERY):
        fits = evidence.fitted([(h, "step", onset, np.zeros(0)) for h in mine], [])
        for h, f in zip(mine, fits, strict=True):
            if f.size == 0.0:  # where a fault's sign is against it, its scores say nothing of the noise
                continue
            ((name, column),) = h.columns.items()
            course = course_of("step", frames, onset)[None, None]
            parts = Parts({name: column[None, None]}, course, np.full((1, 1), VAGUE), np.zeros(1, np.bool_))
            found = departures(evidence.balances, parts, np.array([f.kappa]), from_start=False)
            (part,) = found.parts
            left = max(float(part.split(found.size[:, None])[0][0]), 0.0)
            z = float(found.size[0] * np.sqrt(found.information[0]))
            out.append(HealthyChange(name, z, left, float(part.dimensions[0])))
    return out
