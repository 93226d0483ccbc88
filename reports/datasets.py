"""What is measured of each unit of a data set: identification, slips of units of measure, faults left out."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Unpack

import numpy as np

from fdd.campaign.dataset import Dataset
from fdd.campaign.scores import wilson
from fdd.campaign.train import identified_unit
from fdd.campaign.units import How, over_units
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.identification.from_logs import identify_logs
from fdd.identification.log_scales import check_scales
from fdd.identification.own_scales import difference_is_made
from fdd.identification.profile import Identification
from fdd.markdown import table
from fdd.residuals.oil import modulus_at, viscosity
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

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


@dataclass(frozen=True)
class Told:
    """What was identified of one unit from its baseline runs and its data sheet, as `fdd identify` does.

    `refusals`: why the command refuses. `single_rod`: whether one rod stands on one side. `travel`, `ratio`:
    travel per rad of the pump and area ratio over the true ones. `departures`: (identified - true) / std.
    """

    unit: str
    structure: str
    refusals: tuple[str, ...]
    single_rod: bool
    travel: float = np.nan
    ratio: float = np.nan
    departures: dict[str, float] = field(default_factory=dict)


def identification(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[Told]:
    """What the command makes of each unit's baseline runs.

    Raises `InputError`: not a data set, or one without baseline runs.
    """
    data = Dataset.load(directory)
    if not all(data.manifest.baselines.values()):
        mend = "set baseline: true in the recipe"
        raise InputError("data set without baseline runs", where=data.directory, mend=mend)
    return over_units(_identified, [directory], **how)


def _identified(data: Dataset, name: str) -> list[Told]:
    sheet, true = data.base_unit(name), data.true_unit(name)
    structure = next(e.structure for e in data.logs if e.unit == name)
    single = true.cylinder.area_2 < SINGLE_ROD * true.cylinder.area_1
    try:
        made = identify_logs(data.baseline_files(name), sheet, accept=True)
    except InputError as error:
        return [Told(name, structure, (str(error),), single)]
    reachable = counted(true, sheet)
    (travel, ratio), (true_travel, true_ratio) = (
        (u.pump.displacement / u.cylinder.area_1, u.cylinder.area_2 / u.cylinder.area_1)
        for u in (made.found.unit, reachable)
    )
    refusals, off = tuple(made.judged.refusals), departures(made.found, reachable)
    return [Told(name, structure, refusals, single, travel / true_travel, ratio / true_ratio, off)]


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


def departures(found: Identification, true: Unit) -> dict[str, float]:
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
    refused = [t for t in told if t.refusals]
    single = [t for t in told if t.single_rod]
    near = sum(abs(t.travel - 1.0) < NEAR and abs(t.ratio - 1.0) < NEAR for t in single)
    rows = []
    for quantity in dict.fromkeys(q for t in told for q in t.departures):
        z = np.array([t.departures[quantity] for t in told if quantity in t.departures])
        beyond = [wilson(int(np.sum(np.abs(z) > k)), z.size) for k in (2.0, 3.0)]
        rows.append([quantity, f"{np.sqrt(np.mean(z**2)):.2f}", f"{np.median(z):+.2f}", *beyond])
    lines = [
        "\n## Identification of sound units from their own data sheets\n",
        f"Refused: {wilson(len(refused), len(told))}\n",
        *(f"- {t.unit} ({t.structure}): {'; '.join(t.refusals)}" for t in refused),
        f"\nSingle rods with travel per rad and area ratio within {NEAR:.0%}: {wilson(near, len(single))}\n",
        *table(
            ["single rod", "structure", "travel per rad over the true one", "area ratio over the true one"],
            [[t.unit, t.structure, f"{t.travel:.4f}", f"{t.ratio:.4f}"] for t in single],
        ),
        "\n(Identified - true) / std of all units:\n",
        *table(["quantity", "rms", "median", "beyond 2", "beyond 3"], rows),
    ]
    return "\n".join(lines) + "\n"


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


def scales(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[tuple[str, str]]:
    """Slip and what is said of it (passed, warned, refused), for each healthy log and slip it can have."""
    return over_units(_scales_said, [directory], **how)


def _scales_said(data: Dataset, unit: str) -> list[tuple[str, str]]:
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
    rows = []
    for slip in (*SLIPS, SWAPPED, SOUND):
        said = [what for name, what in found if name == slip]
        shares = (wilson(said.count(x), len(said)) for x in ("refused", "warned"))
        rows.append([slip, str(len(said)), *shares])
    return "\n".join(table(["log", "logs", "refused", "warned of"], rows)) + "\n"


SAID = ("nothing", "unknown", "a neighbour", "another")


def left_out(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[tuple[str, str]]:
    """Fault and what was said without it (of `SAID`), for each log with one fault that balances tell of.

    A neighbour is one that the whole catalogue's answer names as well, as the same log's ambiguity group.
    """
    return over_units(_left_out_said, [directory], Model.load(model), **how)


def _left_out_said(data: Dataset, unit: str, model: Model) -> list[tuple[str, str]]:
    profile, out = identified_unit(data, unit), []
    for entry in data.logs_of(unit):
        if len(entry.faults) != 1 or not CATALOGUE[entry.faults[0].fault].signatures:
            continue
        true, log, named = entry.faults[0].fault, data.samples(entry), []
        for without in ((), (true,)):
            pipeline = Pipeline(profile, model, keep_trajectories=False, without=without)
            pipeline.push(log)
            named.append(pipeline.finish().faults[:1])
        whole, rest = named
        group = {g for f in whole for g in f.ambiguity}
        if not rest:
            out.append((true, "nothing"))
        elif rest[0].fault == "unknown":
            out.append((true, "unknown"))
        else:
            out.append((true, "a neighbour" if group & {*rest[0].ambiguity} else "another"))
    return out


def left_out_table(said: list[tuple[str, str]]) -> str:
    """The section of a report (Markdown)."""
    count, kinds = Counter(said), sorted({k for k, _ in said})
    rows = [[kind.replace("_", " "), *(str(count[kind, s]) for s in SAID)] for kind in kinds]
    answered = [s for _, s in said if s != "nothing"]
    right = sum(s != "another" for s in answered)
    lines = [
        "\n## Kinds that the catalogue does not have\n\nEach log with one fault, diagnosed without that "
        "fault's signatures.\n",
        *table(["left out", *SAID], rows),
        f"Unknown or a neighbour, of those with a finding: {wilson(right, len(answered))}",
    ]
    return "\n".join(lines) + "\n"
