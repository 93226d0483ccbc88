"""Whether ``fdd identify`` accepts sound units, and whether its standard deviations come true.

Each unit's healthy baseline runs are identified from its own data sheet, as the command does it. Flow tells
displacement, leakage and volumes up to one area, which stays the data sheet's, and up to the gain of the
position sensor: the truth that an identification can reach is that of the unit counted so.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Unpack

import numpy as np

from fdd.campaign.dataset import Dataset
from fdd.campaign.scores import wilson
from fdd.campaign.units import How, over_units
from fdd.errors import InputError
from fdd.identification.from_logs import identify_logs
from fdd.identification.profile import Identification
from fdd.markdown import table as markdown
from fdd.residuals.oil import modulus_at, viscosity
from fdd.unit import Unit

SINGLE_ROD = 0.95
"""Ratio of areas below which a rod stands on one side."""
NEAR = 0.02
"""Relative error of travel per rad and area ratio of a single rod that a diagnosis stands."""


@dataclass(frozen=True)
class Told:
    """What was identified of one unit.

    `refusals`: why the command refuses, or why nothing could be identified; empty where it accepts.
    `single_rod`: whether one rod stands on one side. `travel`, `ratio`: travel per rad of the pump and area
    ratio over the true ones, NaN where nothing was identified. `departures`: quantity to (identified - true)
    / std, one for each number with a standard deviation.
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
    return over_units(_told, [directory], **how)


def _told(data: Dataset, name: str) -> list[Told]:
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
    """The true unit as an identification counts it: area_1 is the data sheet's, the position as measured."""
    unit = true.model_copy(deep=True)
    larger = sheet.cylinder.area_1 / true.cylinder.area_1
    stretched = larger * true.sensor("position").gain
    unit.cylinder.area_1 *= larger
    unit.cylinder.area_2 *= larger
    for name in ("volume_1", "volume_2"):
        setattr(unit.cylinder, name, stretched * getattr(unit.cylinder, name))
    for name in ("displacement", "cross_port_leakage", "case_leakage"):
        setattr(unit.pump, name, stretched * getattr(unit.pump, name))
    unit.drive.torque_constant *= stretched
    for branch in (unit.friction.forward, unit.friction.reverse):
        for name in ("static", "coulomb", "viscous"):  # the plant's lower bound of static holds meanwhile
            setattr(branch, name, larger * getattr(branch, name))
    return unit


def departures(found: Identification, true: Unit) -> dict[str, float]:
    """(identified - true) / std of each number that was identified; `true` as `counted` gives it."""
    unit, cylinder = found.unit, found.unit.cylinder
    rows = {r.quantity: r for r in found.table if r.identified is not None and r.std is not None}
    oil = unit.oil
    beta = modulus_at(true.oil, oil.reference_pressure)
    whole = (cylinder.volume_1 + cylinder.volume_2) / (true.cylinder.volume_1 + true.cylinder.volume_2)
    volumes_found = "cylinder.volume_1" in rows
    thinner = viscosity(true.oil, true.oil.reference_temperature)
    thinner /= viscosity(true.oil, oil.reference_temperature)
    expected = {
        "travel per rad": ("pump.displacement", true.pump.displacement),
        "area ratio": ("cylinder.area_2", true.cylinder.area_2),
        "volume 1": ("cylinder.volume_1", true.cylinder.volume_1),
        "volume 2": ("cylinder.volume_2", true.cylinder.volume_2),
        # Where the volumes stay the data sheet's, volume over bulk modulus is all that is told.
        "bulk modulus": ("oil.bulk_modulus", beta if volumes_found else beta * whole),
        "torque constant": ("drive.torque_constant", true.drive.torque_constant),
        "friction extending": ("friction.forward.coulomb", true.friction.forward.coulomb),
        "friction retracting": ("friction.reverse.coulomb", true.friction.reverse.coulomb),
    }
    out = {}
    for quantity, (path, value) in expected.items():
        if (row := rows.get(path)) is not None and row.identified is not None and row.std is not None:
            out[quantity] = (row.identified - value) / row.std
    # At the logs' own temperature; where nobody measures it, the truth there is not known either.
    if found.leakage is not None and "oil.reference_temperature" in rows:
        wanted = true.pump.total_leakage * float(thinner)
        out["leakage"] = (found.leakage.value - wanted) / found.leakage.std
    return out


def table(told: list[Told]) -> str:
    """The section of a report (Markdown)."""
    refused = [t for t in told if t.refusals]
    lines = [
        "\n## Identification of sound units from their own data sheets\n",
        f"Refused: {wilson(len(refused), len(told))}\n",
        *(f"- {t.unit} ({t.structure}): {'; '.join(t.refusals)}" for t in refused),
    ]
    single = [t for t in told if t.single_rod]
    near = sum(abs(t.travel - 1.0) < NEAR and abs(t.ratio - 1.0) < NEAR for t in single)
    lines += [
        f"\nSingle rods with travel per rad and area ratio within {NEAR:.0%}: {wilson(near, len(single))}\n",
        *markdown(
            ["single rod", "structure", "travel per rad over the true one", "area ratio over the true one"],
            [[t.unit, t.structure, f"{t.travel:.4f}", f"{t.ratio:.4f}"] for t in single],
        ),
        "\n(Identified - true) / std of all units:\n",
    ]
    rows = []
    for quantity in dict.fromkeys(q for t in told for q in t.departures):
        z = np.array([t.departures[quantity] for t in told if quantity in t.departures])
        beyond = [wilson(int(np.sum(np.abs(z) > k)), z.size) for k in (2.0, 3.0)]
        rows.append([quantity, f"{np.sqrt(np.mean(z**2)):.2f}", f"{np.median(z):+.2f}", *beyond])
    lines += markdown(["quantity", "rms", "median", "beyond 2", "beyond 3"], rows)
    return "\n".join(lines) + "\n"
