"""What is measured of each unit of a data set: losses, identification, slips of units, faults left out."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from fdd.campaign.dataset import Dataset
from fdd.campaign.labels import Entry
from fdd.campaign.scores import wilson
from fdd.campaign.spreads import healthy_logs, identified_unit
from fdd.diagnosis.baseline import scattered
from fdd.diagnosis.departures import VAGUE, departures
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.identification import Identification
from fdd.identification.from_logs import identify_logs
from fdd.identification.log_scales import check_scales, difference_is_made
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.oil import modulus_at, viscosity
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit
from reports.writing import render

LEAST_SEVERITY = 0.3
LARGE_GAIN = 50.0
"""Nats that no log should have and be called healthy."""
TOLD = 0.3
"""Information of a coefficient in a log over that of its spread, from which its departure says something."""


class Said(NamedTuple):
    """One log's answer. score : of the whole log. gain : the largest (nats) of any fault over the variance
    of healthy stretches. faults : answered, the surest first, with groups."""

    entry: Entry
    verdict: str
    score: float
    gain: float
    faults: tuple[tuple[str, tuple[str, ...]], ...]

    @property
    def named(self) -> bool:
        """Whether a true fault is in the first answer's group."""
        return bool(self.faults) and any(f.fault in self.faults[0][1] for f in self.entry.faults)


class Departure(NamedTuple):
    """A coefficient of a healthy log over what is stated."""

    balance: str
    coefficient: str
    z: float
    stated: float
    file: str


def diagnosed(unit: Unit, log: Samples, model: Model, without: tuple[str, ...] = ()) -> Diagnosis:
    """The answer on a whole log, of the catalogue but for the faults `without`."""
    pipeline = Pipeline(unit, model, keep_trajectories=False, without=without)
    pipeline.push(log)
    return pipeline.finish()


def budget(data: Dataset, name: str, model: Model) -> list[Said | Departure]:
    """Answers on all logs, and departures of all healthy logs and twins from the unit's baseline."""
    unit, _, healthy = healthy_logs(data, name, model.spreads)
    out: list[Said | Departure] = []
    for entry in data.logs_of(name):
        pipeline = Pipeline(unit, model, keep_trajectories=False)
        pipeline.push(data.samples(entry))
        found = pipeline.finish()
        faults = tuple((f.fault, tuple(f.ambiguity)) for f in found.faults)
        gain = max((f.gain / max(f.overdispersion, 1.0) for f in pipeline.fitted), default=0.0)
        out.append(Said(entry, found.verdict, pipeline.score, gain, faults))
    for file, history in healthy:
        out += _departures(file, history)
    return out


def _departures(file: str, history: BalanceHistory) -> list[Departure]:
    """Each coefficient by itself, of any size and sign, from the log's start on."""
    out = []
    effects = history.expected()
    for name, (m, v) in history.marginalised().items():
        e = effects[name]
        own = np.flatnonzero(BALANCES[name].own).tolist()
        profiles, vague = np.ones((len(own), 1, len(m))), np.full((len(own), 1), VAGUE)
        parts = Parts(
            {name: np.eye(len(e.mean))[own][:, None]}, profiles, vague, np.zeros(len(own), np.bool_)
        )
        scatter = np.full(len(own), scattered(m, v, e)[1])
        balances = Evidence({name: (m, v)}, effects).balances
        found = departures(balances, parts, scatter, from_start=True)
        stated = np.sqrt(np.diag(e.covariance))[own]
        z = found.size * np.sqrt(found.information)
        out += [
            Departure(name, BALANCES[name].columns[own[k]], float(z[k]), float(stated[k]), file)
            for k in np.flatnonzero(found.information * np.square(stated) > TOLD)
        ]
    return out


def budget_table(found: Sequence[Said | Departure]) -> str:
    """Where visible faults are lost, and what healthy logs differ by (Markdown)."""
    faults, healthy = [], []
    said = [x for x in found if isinstance(x, Said)]
    silent = sum(s.verdict == "healthy" and s.gain > LARGE_GAIN for s in said)
    for s in said:
        faulty = s.verdict == "faulty"
        if not s.entry.faults:
            healthy.append({"file": s.entry.file, "score": s.score, "faulty": faulty})
        elif len(s.entry.faults) == 1 and s.entry.visible and s.entry.faults[0].severity >= LEAST_SEVERITY:
            true = s.entry.faults[0]
            faults.append({
                "all": "", "onset": "from the first sample" if true.onset_s <= 0.0 else "inside",
                "course": true.profile, "fault": true.fault.replace("_", " "), "load": s.entry.scenario.load,
                "structure": s.entry.structure, "faulty": faulty, "named": faulty and s.named,
            })  # fmt: skip
    off = pd.DataFrame([x for x in found if isinstance(x, Departure)], columns=Departure._fields)
    sound = pd.DataFrame(healthy, columns=["file", "score", "faulty"])
    return printed("budget", least=LEAST_SEVERITY, faults=pd.DataFrame(faults), healthy=sound, off=off,
                   large=LARGE_GAIN, silent=silent, logs=len(said))  # fmt: skip


def printed(name: str, **found: Any) -> str:
    """A command's section (Markdown)."""
    return render(Path(__file__).with_name("datasets.md.j2"), name, share=share, **found)


def share(hits: pd.Series[bool]) -> str:
    """How many hold, with its interval."""
    return wilson(int(hits.sum()), len(hits))


SINGLE_ROD = 0.95
"""Ratio of areas below which a rod stands on one side."""
COMPARED = {
    "travel per rad": "pump.displacement", "area ratio": "cylinder.area_2", "volume 1": "cylinder.volume_1",
    "volume 2": "cylinder.volume_2", "bulk modulus": "oil.bulk_modulus",
    "torque constant": "drive.torque_constant", "friction extending": "friction.forward.coulomb",
    "friction retracting": "friction.reverse.coulomb",
}  # fmt: skip
"""Quantities of a profile's table."""
NEAR = 0.02
"""Relative error of travel per rad and area ratio of a single rod that a diagnosis stands."""


class Told(NamedTuple):
    """What `fdd identify` makes of one unit's baseline runs and data sheet: why it refuses, departures
    (identified - true) / std, and travel per rad of the pump and area ratio over the true ones."""

    unit: str
    structure: str
    single_rod: bool
    refusals: tuple[str, ...]
    departures: dict[str, float]
    travel: float = np.nan
    ratio: float = np.nan


def identification(data: Dataset, name: str, model: Model) -> list[Told]:
    """What `fdd identify` makes of the unit's baseline runs.

    Raises `InputError`: a data set without baseline runs.
    """
    if not data.baseline_files(name):
        mend = "set baseline: true in the recipe"
        raise InputError("data set without baseline runs", where=data.directory, mend=mend)
    sheet, true = data.base_unit(name), data.true_unit(name)
    structure = next(e.structure for e in data.logs if e.unit == name)
    single = true.cylinder.area_2 < SINGLE_ROD * true.cylinder.area_1
    try:
        made = identify_logs(data.baseline_files(name), sheet, accept=True)
    except InputError as error:
        return [Told(name, structure, single, (str(error),), {})]
    reachable = counted(true, sheet)
    found, wanted = (
        np.array([u.pump.displacement, u.cylinder.area_2]) / u.cylinder.area_1
        for u in (made.found.unit, reachable)
    )
    off = standardised(made.found, reachable)
    return [Told(name, structure, single, tuple(made.judged.refusals), off, *(found / wanted).tolist())]


def counted(true: Unit, sheet: Unit) -> Unit:
    """The true unit as an identification can reach it: area_1 is the data sheet's, the position as measured.

    Flow tells displacement, leakage and volumes up to one area and up to the position sensor's gain.
    """
    unit = true.model_copy(deep=True)
    larger = sheet.cylinder.area_1 / true.cylinder.area_1
    stretched = larger * true.sensor("position").gain
    for part, names, factor in (
        (unit.cylinder, ("area_1", "area_2"), larger),
        (unit.cylinder, ("volume_1", "volume_2"), stretched),
        (unit.pump, ("displacement", "cross_port_leakage", "case_leakage"), stretched),
        (unit.drive, ("torque_constant",), stretched),
        # The plant's lower bound of static holds meanwhile.
        (unit.friction.forward, ("static", "coulomb", "viscous"), larger),
        (unit.friction.reverse, ("static", "coulomb", "viscous"), larger),
    ):
        for name in names:
            setattr(part, name, factor * getattr(part, name))
    return unit


def standardised(found: Identification, true: Unit) -> dict[str, float]:
    """(identified - true) / std of each number that was identified; `true` as `counted` gives it."""
    cylinder, oil = found.unit.cylinder, found.unit.oil
    rows = {r.quantity: r for r in found.table if r.identified is not None and r.std is not None}
    beta = modulus_at(true.oil, oil.reference_pressure)
    if "cylinder.volume_1" not in rows:
        # Where the volumes stay the data sheet's, volume over bulk modulus is all that is told.
        known = true.cylinder.volume_1 + true.cylinder.volume_2
        beta *= (cylinder.volume_1 + cylinder.volume_2) / known
    out = {}
    for quantity, path in COMPARED.items():
        if (row := rows.get(path)) is not None and row.identified is not None and row.std is not None:
            value = beta if path == "oil.bulk_modulus" else attrgetter(path)(true)
            out[quantity] = (row.identified - value) / row.std
    # At the logs' own temperature; where nobody measures it, the truth there is not known either.
    if found.leakage is not None and "oil.reference_temperature" in rows:
        thinner = viscosity(true.oil, true.oil.reference_temperature)
        thinner /= viscosity(true.oil, oil.reference_temperature)
        wanted = true.pump.total_leakage * float(thinner)
        out["leakage"] = (found.leakage.value - wanted) / found.leakage.std
    return out


def identification_table(told: list[Told]) -> str:
    """The section of a report (Markdown)."""
    departures = pd.DataFrame([t.departures for t in told])
    return printed("identification", told=pd.DataFrame(told), departures=departures, near=NEAR)


CHAMBERS = ("pressure_1", "pressure_2")
SLIPS: dict[str, tuple[float, tuple[str, ...]]] = {
    "bar read as psi": (0.0689476, PRESSURES),
    "bar read as MPa": (10.0, PRESSURES),
    "bar read as kPa": (0.01, PRESSURES),
    "one chamber in MPa read as bar": (0.1, CHAMBERS[:1]),
    "mm read as inches": (25.4, ("position",)),
    "mm read as cm": (10.0, ("position",)),
    "rpm read as rad/s": (30.0 / np.pi, ("pump_speed",)),
    "degrees read as rad": (180.0 / np.pi, ("pump_angle",)),
    "ms read as s": (1e3, ("time",)),
}
SWAPPED, SOUND = "chambers swapped", "as it is"


def scales(data: Dataset, unit: str, model: Model) -> list[tuple[str, str]]:
    """Slip and what is said of it (passed, warned, refused), for each healthy log and slip it can have."""
    profile, out = identified_unit(data, unit), []
    for entry in data.logs_of(unit):
        log = data.samples(entry) if entry.healthy else data.twin(entry)
        if log is None:
            continue
        for slip, wrong in (*slipped(log).items(), (SOUND, log)):
            try:
                out.append((slip, "warned" if check_scales(wrong, profile, entry.file) else "passed"))
            except InputError:
                out.append((slip, "refused"))
    return out


def slipped(log: Samples) -> dict[str, Samples]:
    """A log under each slip that its channels can have."""
    out = {}
    for slip, (factor, channels) in SLIPS.items():
        mine = {c: factor * log[c] for c in channels if c in log}
        if channels == ("time",):
            out[slip] = Samples(factor * log.time, log.columns)
        elif mine:
            if difference_is_made(log) and channels == CHAMBERS[:1]:  # a reader makes it of what it reads
                mine["pressure_difference"] = mine[CHAMBERS[0]] - log[CHAMBERS[1]]
            out[slip] = log.with_columns(mine)
    if all(c in log for c in CHAMBERS):
        one, other = CHAMBERS
        out[SWAPPED] = log.with_columns({one: log[other], other: log[one]})
    return out


def scales_table(found: list[tuple[str, str]]) -> str:
    """The report (Markdown)."""
    frame = pd.DataFrame(found, columns=["slip", "said"])
    return printed("scales", found=frame, slips=[*SLIPS, SWAPPED, SOUND])


SAID = ("nothing", "unknown", "a neighbour", "another")


def left_out(data: Dataset, unit: str, model: Model) -> list[tuple[str, str]]:
    """Fault and what was said without it (of `SAID`), for each log with one fault that balances tell of.

    A neighbour is one that the whole catalogue's answer names as well, as the same log's ambiguity group.
    """
    profile, said = identified_unit(data, unit), []
    for entry in data.logs_of(unit):
        if len(entry.faults) != 1 or not CATALOGUE[entry.faults[0].fault].signatures:
            continue
        true, log = entry.faults[0].fault, data.samples(entry)
        whole, rest = (diagnosed(profile, log, model, out).faults[:1] for out in ((), (true,)))
        group = {g for f in whole for g in f.ambiguity}
        if not rest or rest[0].fault == "unknown":
            said.append((true, "unknown" if rest else "nothing"))
        else:
            said.append((true, "a neighbour" if group & {*rest[0].ambiguity} else "another"))
    return said


def left_out_table(said: list[tuple[str, str]]) -> str:
    """The section of a report (Markdown)."""
    return printed("left_out", found=pd.DataFrame(said, columns=["fault", "said"]), kinds=SAID)
