"""Identify each rig from its baseline logs, diagnose every other log, and write the answers.

    python examples/rig_answers.py LOGS -o ANSWERS [--rigs rig0 rig6] [--labels LOGS/labels.json]

LOGS holds a folder per rig, its logs in any format; ``<rig>.map.yaml`` beside this file says what is what in
those that do not carry the contract's own names (each made by ``fdd map`` from the rig's baseline).
ANSWERS/<rig>/<log>.json is what
``fdd diagnose --json`` would write, ANSWERS/<rig>/unit.yaml the profile identified. A log that fails is
told and left out; the others go on. With ``--labels`` a table is printed too: truth beside answer. There
the family of the answer must be that of one of the log's faults, and the alarm not come before the first
onset; a healthy log is right without an alarm.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from fdd.campaign.scores import Classes, calibration_error, classes_of, macro_f1, sureness_of, wilson
from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import fault
from fdd.identification.identify import identify_unit
from fdd.logs import read_log
from fdd.samples import Samples
from fdd.unit import Unit

EXAMPLES = Path(__file__).parent
AXES = {rig: "axis_a" if int(rig[3:]) % 2 == 0 else "axis_b" for rig in map("rig{}".format, range(6))}
"""Rigs 0 to 5 are like the thesis's axes A and B; the others' bases are typed from their data sheets."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--rigs", nargs="*", help="only these folders")
    parser.add_argument("--labels", type=Path, help="print a table of truth and answer too")
    options = parser.parse_args()
    labels = json.loads(options.labels.read_text(encoding="utf-8")) if options.labels else {}
    failures, held, classes = 0, list[bool](), list[Classes]()
    sure, faulty = list[tuple[float, bool]](), list[bool]()
    if labels:
        print("| log | load | truth | answer | onset: truth, answer | verdict is |")
        print("| --- | --- | --- | --- | --- | --- |", flush=True)
    for rig in options.rigs or sorted(p.name for p in options.logs.iterdir() if p.is_dir()):
        target = options.output / rig
        target.mkdir(parents=True, exist_ok=True)
        try:
            unit = identified(options.logs / rig)
        except Exception as error:
            failures += told(f"{rig}: not identified", error)
            continue
        unit.save(target / "unit.yaml")
        by_stem = {str(Path(n).with_suffix("")): label for n, label in labels.items()}
        for path in sorted((options.logs / rig).glob("run*")):
            name, started = f"{rig}/{path.stem}", time.perf_counter()
            (target / f"{path.stem}.json").unlink(missing_ok=True)
            try:
                found = diagnosed(path, unit, rig)
            except Exception as error:
                failures += told(name, error)
                continue
            (target / f"{path.stem}.json").write_text(found.model_dump_json(by_alias=True, indent=1))
            if name in by_stem:
                print(row(name, by_stem[name], found), flush=True)
                held += sized(by_stem[name], found)
                true = {f["fault"]: f["onset_s"] for f in by_stem[name]["faults"]}
                sure.append(sureness_of(true.keys(), min(true.values(), default=math.inf), found))
                faulty.append(bool(true))
                classes.append(classes_of(true.keys(), found))
            else:
                leading = found.faults[0].fault if found.faults else found.verdict
                print(f"{name}: {leading} ({time.perf_counter() - started:.1f} s)", flush=True)
    if held:
        print(f"\n80 % intervals of severity hold the true one: {wilson(sum(held), len(held))}")
    if sure:
        mean, (low, high), _ = macro_f1(classes)
        print(f"Macro-F1 {mean:.2f} ({low:.2f} to {high:.2f})")
        error, by_chance, most = calibration_error(sure, faulty)
        print(
            f"Calibration error of the {len(sure)} leading statements: {error:.3f}; of calibrated ones "
            f"{by_chance:.3f}, nine in ten below {most:.3f}"
        )
    if failures:
        sys.exit(f"{failures} logs or rigs failed")


def identified(folder: Path) -> Unit:
    """The rig's own profile, with its healthy baseline."""
    healthy = [samples_of(path) for path in sorted(folder.glob("baseline*"))]
    base = Unit.load(AXES.get(folder.name) or EXAMPLES / f"{folder.name}.base.yaml")
    return add_baseline(identify_unit(healthy, base, folder.name).unit, healthy)


def diagnosed(path: Path, unit: Unit, axis: str) -> Diagnosis:
    """The answer for one log."""
    pipeline = Pipeline(unit, axis=axis, log=path.name)
    pipeline.push(samples_of(path))
    return pipeline.finish()


def samples_of(path: Path) -> Samples:
    """A log by its rig's map, where there is one."""
    map_file = EXAMPLES / f"{path.parent.name}.map.yaml"
    return read_log(path, map_file if map_file.exists() else None).samples


def told(what: str, error: Exception) -> int:
    """Say what failed, and where, on standard error; counts as one."""
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}:{place.lineno}"
    print(f"FAILED {what}: {type(error).__name__} in {where}: {error}", file=sys.stderr, flush=True)
    return 1


def row(name: str, label: dict[str, Any], found: Diagnosis) -> str:
    """One line of the table."""
    truth = ", ".join(f"{f['fault']} {f['severity']:.2f}" for f in label["faults"]) or "healthy"
    plain = label.get("condition", "plain") == "plain"
    condition = "" if plain else f", {label['condition']}"
    onsets = ", ".join(f"{f['onset_s']:.1f}" for f in label["faults"])
    if found.faults:
        first = found.faults[0]
        answer = f"{first.fault} ({100 * first.confidence:.0f} %)"
        if len(first.ambiguity) > 1:
            answer += f" or {', '.join(first.ambiguity[1:])}"
        onset = f"{onsets or '-'}; {first.onset_s:.1f} s (alarm {first.detected_s:.1f} s)"
    else:
        answer, onset = found.verdict, f"{onsets}; -" if onsets else ""
    load = f"{label.get('load', '')}{condition}"
    return f"| {name} | {load} | {truth} | {answer} | {onset} | {judged(label, found)} |"


def sized(label: dict[str, Any], found: Diagnosis) -> list[bool]:
    """Whether the interval of a single fault's severity holds the true one; empty where it was not named."""
    return [
        first.severity_interval[0] <= truth["severity"] <= first.severity_interval[1]
        for truth in label["faults"][:1]
        for first in found.faults[:1]
        if len(label["faults"]) == 1 and first.fault == truth["fault"] and first.severity_interval is not None
    ]


def judged(label: dict[str, Any], found: Diagnosis) -> str:
    """``right``, ``missed``, ``false alarm``, ``wrong family``, or ``detected`` for an honest unknown."""
    if not label["faults"]:
        return "false alarm" if found.faults else "right"
    if not found.faults:
        return "missed"
    answer = found.faults[0]
    if answer.detected_s < min(f["onset_s"] for f in label["faults"]):
        return "false alarm"
    if answer.family in {fault(f["fault"]).family for f in label["faults"]}:
        return "right"
    return "detected, not isolated" if answer.family == "unknown" else "wrong family"


if __name__ == "__main__":
    main()
