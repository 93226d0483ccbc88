"""From a recipe to a data set on disk: many runs, in parallel, resumable, the same whatever the order.

Layout: ``recipe.yaml``, ``<unit>/true_unit.yaml``, ``<unit>/baseline_1.parquet`` …,
``<unit>/log_000.parquet`` …, ``<unit>/truth_000.parquet`` …, with twins ``<unit>/twin_000.parquet`` …,
``labels.json`` and ``manifest.json``: a folder without it is unfinished. Until then ``.parts`` holds the
label of each finished log; a second start keeps those. ``SHA256SUMS`` and a card stand beside what is
finished.
"""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd import __version__
from fdd.campaign import dataset, drawing, scenarios
from fdd.campaign.card import write_card, write_sums
from fdd.campaign.dataset import Progress
from fdd.campaign.drawing import calibration_runs, ordinary_strokes
from fdd.campaign.labels import EDGES, largest_rms, visibility
from fdd.campaign.recipe import Recipe
from fdd.campaign.structures import Condition
from fdd.engines import Engine, map_unordered
from fdd.errors import InputError
from fdd.files import whole_file, write_text, written
from fdd.logs.mcap_writing import write_run
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.faults import struck_channel
from fdd.plant.simulate import Simulation, simulate
from fdd.samples import Samples
from fdd.unit import Unit

TRUTH_RATE = 20
"""Hz of the truth that is kept."""
ORDINARY_WORK = (30.0, 40.0)
"""s of each ordinary baseline run."""
MOST_DRAWS = 8
"""Draws of a scenario until one is sane."""
MOST_AT_STOP = 0.01
"""Share of a run in which the piston may lie at an end stop."""
MOST_AT_GUARD = 0.1
"""Share in which it may stand where the drive's travel limit stops it, in speed control."""
MOST_RELIEVED = 0.05
"""Share of a run in which a relief valve may pass oil."""
_RELIEVING = 1e-7  # m³/s
_GUARD = 0.445  # of the stroke, just within the limit
UNROUNDED = ("time", "command", "pump_angle", "position_setpoint")
SUMMARISED = ("leakage", "bulk_modulus", "coulomb_friction", "viscous_friction")

Job = tuple[int, str, tuple[tuple[str, ...], ...]]
"""Index of the unit, name of the run (``baseline_1`` …, ``log_000`` …), faults of each of the unit's logs."""


def generate(
    recipe: Recipe, directory: str | Path, *, workers: int | None = 1, progress: Progress | None = None,
    engine: Engine = "local",
) -> Path:  # fmt: skip
    """Simulate everything that a recipe asks for and write it as a data set, into a folder that is made if
    need be; where it holds the beginning of the same data set, its finished logs are kept.

    An InputError where the folder holds something else, can't be written, or a scenario can't be simulated.
    `progress` is called with (done, total) after each run, baselines included. `workers`, `engine`: see
    `fdd.engines.map_unordered`. A script that asks for more workers than one must keep its call under
    ``if __name__ == "__main__":``, as processes are spawned.
    """
    if workers is not None and workers < 1:
        raise InputError(f"{workers} workers", mend="use 1 or more")
    directory, progress = Path(directory), progress or (lambda done, total: None)
    faults, count = drawing.assign_faults(recipe), recipe.logs_per_unit
    jobs: list[Job] = [
        (unit, name, tuple(faults[unit * count : (unit + 1) * count]))
        for unit in range(recipe.units)
        for name in _names(recipe)
    ]
    # First of all, as an engine that is not there is to leave no folder.
    made = map_unordered(partial(make_run, recipe, directory), jobs, engine=engine, workers=workers)
    with written(directory):
        if _begin(recipe, directory):
            progress(len(jobs), len(jobs))
        else:
            for done, _ in enumerate(made, 1):
                progress(done, len(jobs))
            _finish(recipe, directory)
        if not (directory / dataset.SUMS).is_file():
            write_sums(directory)
        write_card(directory)
    return directory


def _names(recipe: Recipe) -> list[str]:
    baselines = [f"baseline_{k}" for k in (1, 2, 3)] if recipe.baseline else []
    return baselines + [f"log_{k:03d}" for k in range(recipe.logs_per_unit)]


def make_run(recipe: Recipe, directory: Path, job: Job) -> None:
    """Simulate and write one run of one unit, unless it is there already."""
    index, name, faults = job
    rig = drawing.draw_unit(recipe, drawing.stream(recipe, "unit", index), index)
    part = directory / dataset.PARTS / f"{rig.unit.name}-{name}.json"
    if part.is_file():
        return
    folder = directory / rig.unit.name
    folder.mkdir(exist_ok=True)
    kind, number = name.split("_")
    log = None if kind == "baseline" else int(number)
    condition = None if log is None else drawing.condition_of(recipe, index, log)
    if log is None:
        run = _baseline_run(recipe, rig, index, int(number))
    else:
        run = _sane_run(recipe, rig, ("log", index, log), faults[log], condition)
    if name == _names(recipe)[0]:
        rig.unit.save(folder / dataset.TRUE_UNIT)
        if rig.structure is not None:
            rig.sheet.save(folder / dataset.BASE_UNIT)
    entry = _label(recipe, rig, run, name, log)
    if log is not None and recipe.conditions:
        entry["condition"] = "" if condition is None else condition.name
    _write_log(recipe, directory / entry["file"], run, rig, entry["faults"])
    if log is not None:
        # Single precision is more than any use of the truth asks for, and half the size.
        truth = {k: v if k == "time" else v.astype(np.float32) for k, v in _kept_truth(run).items()}
        _write_table(directory / entry["truth"], truth)
        if recipe.twins:
            entry["twin"] = None
            if run.scenario.faults:
                name, samples, unit, scenario = f"twin_{log:03d}", run.samples, run.unit, run.scenario
                del run  # its truth is larger than its log: one run at a time is in memory
                entry |= _twin(recipe, directory, rig, f"{rig.unit.name}/{name}", samples, unit, scenario)
    write_text(part, json.dumps(entry, indent=1))


def _baseline_run(recipe: Recipe, rig: drawing.Rig, index: int, number: int) -> Simulation:
    """One of the three healthy runs that a unit is identified by."""
    kind = rig.structure.baseline_kind if rig.structure is not None else None
    rng = drawing.stream(recipe, "baseline", index)
    if (kind or recipe.baseline_kind) == "identification":
        run = calibration_runs(recipe, rig, rng)[number - 1]
    elif number == 1:
        run = ordinary_strokes(rig, rng)
    else:
        work = recipe.model_copy(update={"duration": ORDINARY_WORK})
        return _sane_run(work, rig, ("ordinary", index, number), ())
    return simulate(*scenarios.as_it_runs(recipe, rig, rig.unit, run, ("baseline", index, number)))


def _sane_run(
    recipe: Recipe, rig: drawing.Rig, purpose: tuple[str, int, int], faults: tuple[str, ...],
    condition: Condition | None = None,
) -> Simulation:  # fmt: skip
    """Draw and simulate until the run neither rests at its limits nor relieves for long."""
    unit = rig.unit
    for departure in (rig.structure, condition):
        recipe = departure.applied(recipe) if departure is not None else recipe
    if condition is not None:
        unit = condition.changed(unit, drawing.stream(recipe, "condition", *purpose[1:]))
    for attempt in range(MOST_DRAWS):
        rng = drawing.stream(recipe, *purpose, attempt)
        scenario = scenarios.draw_scenario(recipe, rig, rng, faults)
        try:
            run = simulate(*scenarios.as_it_runs(recipe, rig, unit, scenario, purpose))
            trouble = _trouble(run)
        except InputError as error:
            trouble = str(error)
        if not trouble:
            return run
    problem = f"no sane scenario in {MOST_DRAWS} draws; the last: {trouble}"
    mend = "narrow the recipe's ranges of loads and duties"
    raise InputError(problem, where=f"{rig.unit.name} {purpose[0]} {purpose[2]}", mend=mend)


def _twin(
    recipe: Recipe, directory: Path, rig: drawing.Rig, name: str, log: Samples, unit: Unit, scenario: Scenario
) -> dict[str, Any]:
    """Write the twin of a log, the same unit and scenario without its faults; what the label says of it.

    Every random stream has a seed and a purpose of its own (`fdd.plant.sensors.generator`): all else is the
    same to the last bit. The draw was judged with its faults and is not judged again.
    """
    try:
        twin = simulate(unit, scenario.model_copy(update={"faults": []}))
    except InputError:
        return {}  # only the fault kept the run in the model's range: a log without a twin
    file = f"{name}.{recipe.format}"
    _write_log(recipe, directory / file, twin, rig, [])
    found = visibility(log, twin.samples, unit, scenario.recording)
    seen = {channel: each.model_dump() for channel, each in found.items()}
    rms = largest_rms(found)
    return {"twin": file, "visibility": seen, "largest_rms": rms, "visible": rms >= EDGES[0]}


def _trouble(run: Simulation) -> str:
    """What makes a run useless, or nothing."""
    truth, limit = run.truth, _GUARD * run.unit.cylinder.stroke
    # A valve whose setting has fallen passes oil because of its fault.
    fallen = any((f.fault, f.law) == ("relief_valve_stuck_open", "setting") for f in run.scenario.faults)
    relieved = 1.0 if fallen else MOST_RELIEVED
    for where, there, most in (
        ("at an end stop", truth["stop_force"] != 0.0, MOST_AT_STOP),
        ("at the travel limit", np.abs(truth["position"]) > limit, MOST_AT_GUARD),
        ("over the relief valve", np.abs(truth["relief_flow"]) > _RELIEVING, relieved),
    ):
        if (share := float(np.mean(there))) > most:
            return f"{where} {share:.0%} of the time"
    return ""


def _label(recipe: Recipe, rig: drawing.Rig, run: Simulation, name: str, log: int | None) -> dict[str, Any]:
    scenario, unit = run.scenario, rig.unit.name
    structure: dict[str, Any] = {}
    if rig.structure is not None:
        # What severity 1 was: of machines drawn as a whole it goes with their size.
        figures = {n: float(f"{v:.6g}") for n, v in scenario.fault_scales.model_dump().items()}
        structure = {"structure": rig.structure.name, "fault_scales": figures}
    struck = {f.fault: struck_channel(f, rig.recording) for f in scenario.faults}
    channels = {fault: {"channel": channel} for fault, channel in struck.items() if channel is not None}
    acting = np.all([np.ones(len(run.truth)), *(s > 0.0 for s in run.truth.severity.values())], axis=0)
    acting |= not acting.any()
    return {
        "file": f"{unit}/{name}.{recipe.format}",
        "truth": None if log is None else f"{unit}/truth_{log:03d}.parquet",
        "unit": unit, "base": rig.base, **structure, "baseline": log is None,
        "duration_s": round(run.samples.duration, 3), "samples": len(run.samples),
        "faults": [{**label, **channels.get(str(label["fault"]), {})} for label in run.labels],
        "scenario": {
            "load": scenario.load.name, "duty": scenario.duty.name, "control": scenario.control.mode,
            "oil_temperature": round(scenario.oil_temperature, 2),
            "charge_factor": round(scenario.charge_factor, 3), "seed": scenario.seed,
        },
        "truth_medians": {c: float(f"{np.median(run.truth[c][acting]):.6g}") for c in SUMMARISED},
    }  # fmt: skip


def _write_log(
    recipe: Recipe, path: Path, run: Simulation, rig: drawing.Rig, faults: list[dict[str, Any]]
) -> None:
    if recipe.format == "parquet":
        _write_table(path, {"time": run.samples.time, **run.samples.columns})
        return
    write_run(
        path, run.samples, axis=rig.unit.axis, unit_yaml=rig.unit.to_yaml(), truth=_kept_truth(run),
        scenario_json=run.scenario.model_dump_json(), labels={"faults": faults},
    )  # fmt: skip


def _kept_truth(run: Simulation) -> dict[str, NDArray[Any]]:
    every = max(run.scenario.recording.rate // TRUTH_RATE, 1)
    return {k: v[::every] for k, v in {"time": run.truth.time, **run.truth.as_columns()}.items()}


def _write_table(path: Path, columns: dict[str, NDArray[Any]]) -> None:
    """Write a Parquet file, whole or not at all; NaN becomes null."""
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.table({n: pa.array(v, mask=np.isnan(v)) for n, v in columns.items()})
    # Rounded measurements repeat and want a dictionary; what never repeats packs by a third better
    # with its bytes apart.
    split = {n: "BYTE_STREAM_SPLIT" for n in columns if n in UNROUNDED}
    packed = [n for n in columns if n not in split]
    with whole_file(path) as temporary:
        parquet.write_table(
            table, temporary, compression="zstd", use_dictionary=packed, column_encoding=split
        )


def _begin(recipe: Recipe, directory: Path) -> bool:
    """Claim the folder; whether the data set is complete already."""
    if directory.exists() and not directory.is_dir():
        raise InputError("is a file", where=directory, mend="give the name of a folder")
    directory.mkdir(parents=True, exist_ok=True)
    kept = directory / dataset.RECIPE
    if kept.is_file():
        if kept.read_text(encoding="utf-8", errors="replace") != _signed(recipe):
            mend = "choose an empty folder, or remove this one"
            raise InputError("holds data of another recipe or version", where=directory, mend=mend)
        if (directory / dataset.MANIFEST).is_file():
            return True
    elif any(not f.name.endswith(".part") for f in directory.iterdir()):
        problem = "not empty, and not the beginning of a data set"
        raise InputError(problem, where=directory, mend="choose an empty folder")
    else:
        write_text(kept, _signed(recipe))
    (directory / dataset.PARTS).mkdir(exist_ok=True)
    for left in directory.glob("**/.*.part"):
        left.unlink(missing_ok=True)
    return False


def _signed(recipe: Recipe) -> str:
    return f"# made by fdd {__version__}\n{recipe.to_yaml()}"


def _finish(recipe: Recipe, directory: Path) -> None:
    """Gather the labels, then write the manifest: only now it is a data set."""
    parts = directory / dataset.PARTS
    entries = [json.loads(part.read_text(encoding="utf-8")) for part in sorted(parts.glob("*.json"))]
    logs = [{k: v for k, v in e.items() if k != "baseline"} for e in entries if not e["baseline"]]
    baselines: dict[str, list[str]] = {}
    for e in entries:
        baselines.setdefault(e["unit"], []).extend([e["file"]] if e["baseline"] else [])
    labels = json.dumps(logs, indent=1) + "\n"
    write_text(directory / dataset.LABELS, labels)
    manifest = {
        "schema": dataset.DATASET_SCHEMA, "name": recipe.name, "version": __version__, "seed": recipe.seed,
        "units": recipe.units, "number": len(logs),
        "hours": round(sum(e["duration_s"] for e in logs) / 3600.0, 3), "baselines": baselines,
        "sha256": dataset.digest(_signed(recipe), labels),
    }  # fmt: skip
    write_text(directory / dataset.MANIFEST, json.dumps(manifest, indent=1) + "\n")
    shutil.rmtree(parts)
