"""What is measured of each unit of a data set: losses, identification, slips of units, faults left out."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Unpack

import numpy as np

from fdd.campaign.dataset import Dataset, Entry
from fdd.campaign.scores import wilson
from fdd.campaign.spreads import healthy_logs
from fdd.campaign.train import identified_unit
from fdd.campaign.units import How, over_units
from fdd.diagnosis.departures import VAGUE, departures
from fdd.diagnosis.evidence import Evidence
from fdd.diagnosis.fitting import Parts
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.diagnosis.random_effects import scattered
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.identification.from_logs import identify_logs
from fdd.identification.log_scales import check_scales
from fdd.identification.own_scales import difference_is_made
from fdd.identification.profile import Identification
from fdd.markdown import table
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.oil import modulus_at, viscosity
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

LEAST_SEVERITY = 0.3
TOLD = 0.3
"""Information of a coefficient in a log over that of its spread, from which its departure says something."""
LEAST_LOGS, FARTHEST = 30, 12
BEYOND = 3.0


@dataclass(frozen=True)
class Said:
    """One log's answer. score : of the whole log. faults : answered, the surest first, with groups."""

    entry: Entry
    verdict: str
    score: float
    faults: tuple[tuple[str, tuple[str, ...]], ...]

    @property
    def named(self) -> bool:
        """Whether a true fault is in the first answer's group."""
        return bool(self.faults) and any(f.fault in self.faults[0][1] for f in self.entry.faults)


@dataclass(frozen=True)
class Departure:
    """A coefficient of a healthy log over what is stated."""

    balance: str
    coefficient: str
    z: float
    stated: float
    file: str


def budget(directory: str | Path, model: str | None = None, **how: Unpack[How]) -> list[Said | Departure]:
    """Answers on all logs, and departures of all healthy logs and twins from their units' baselines."""
    return over_units(_unit, [directory], Model.load(model), **how)


def _unit(data: Dataset, name: str, model: Model) -> list[Said | Departure]:
    logs = healthy_logs(data, name, model.spreads)
    out: list[Said | Departure] = []
    for entry in data.logs_of(name):
        pipeline = Pipeline(logs.unit, model, keep_trajectories=False)
        pipeline.push(data.samples(entry))
        found = pipeline.finish()
        faults = tuple((f.fault, tuple(f.ambiguity)) for f in found.faults)
        out.append(Said(entry, found.verdict, pipeline.score, faults))
    for file, history in logs.healthy:
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
    said = [x for x in found if isinstance(x, Said)]
    return "\n".join([*_faults(said), *_healthy([x for x in found if isinstance(x, Departure)])]) + "\n"


def _faults(said: Sequence[Said]) -> list[str]:
    healthy = [s for s in said if not s.entry.faults]
    mine = [
        s for s in said
        if len(s.entry.faults) == 1 and s.entry.visible and s.entry.faults[0].severity >= LEAST_SEVERITY
    ]  # fmt: skip
    by: list[tuple[str, Callable[[Said], str]]] = [
        ("all", lambda s: ""),
        ("onset", lambda s: "from the first sample" if s.entry.faults[0].onset_s <= 0.0 else "inside"),
        ("course", lambda s: s.entry.faults[0].profile),
        ("fault", lambda s: s.entry.faults[0].fault.replace("_", " ")),
        ("load", lambda s: s.entry.scenario.load),
        ("structure", lambda s: s.entry.structure),
    ]
    rows = []
    for title, of in by:
        groups = defaultdict[str, list[Said]](list)
        for s in mine:
            groups[of(s)].append(s)
        for name, each in sorted(groups.items()):
            rows.append([
                title, name, wilson(sum(s.verdict == "faulty" for s in each), len(each)),
                wilson(sum(s.verdict == "faulty" and s.named for s in each), len(each)),
            ])  # fmt: skip
    alarmed = sum(s.verdict == "faulty" for s in healthy)
    highest = sorted(healthy, key=lambda s: -s.score)[:FARTHEST]
    largest = [f"{s.entry.file} {s.score:.1f}" for s in highest]
    return [
        f"Visible single faults of severity {LEAST_SEVERITY:g} and more; healthy logs called faulty: "
        f"{wilson(alarmed, len(healthy))}\n",
        *table(["by", "", "faulty", "named"], rows),
        f"Healthy logs with the largest scores: {', '.join(largest)}\n",
    ]


def _healthy(found: Sequence[Departure]) -> list[str]:
    groups = defaultdict[tuple[str, str], list[Departure]](list)
    for d in found:
        groups[d.balance, d.coefficient].append(d)
    rows = []
    for (balance, coefficient), each in groups.items():
        if len(each) < LEAST_LOGS:
            continue
        z = np.array([d.z for d in each])
        far = max(each, key=lambda d: abs(d.z))
        rows.append([
            balance, coefficient, str(len(each)), f"{1.4826 * np.median(np.abs(z)):.2f}",
            f"{np.sqrt(np.mean(z**2)):.2f}", wilson(int(np.sum(np.abs(z) > BEYOND)), len(each)),
            f"{np.median([d.stated for d in each]):.3g}", f"{far.file} {far.z:+.1f}",
        ])  # fmt: skip
    head = ["balance", "coefficient", "logs", "median", "rms", "beyond 3 std", "stated", "farthest"]
    return ["\nHealthy departures over what is stated\n", *table(head, rows)]


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
    refusals, off = tuple(made.judged.refusals), standardised(made.found, reachable)
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
