"""Diagnose every labelled log of a rig on a profile identified from its baseline, and print a table.

    python examples/rig_table.py LOGS --rig rig1 --map examples/rig1.map.yaml --base axis_b

LOGS holds ``labels.json`` (per log: baseline, load, condition, faults with fault, severity, onset_s)
and a folder per rig. ``--json`` writes the answers too. What is right is judged as follows: the family of
the answer is that of one of the faults of the log, and the alarm does not come before the first onset; a
healthy log is right without an alarm.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.pipeline import Pipeline
from fdd.faults import fault
from fdd.identify import identify_unit
from fdd.logs import ChannelMap, read_log
from fdd.unit import Unit


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", type=Path)
    parser.add_argument("--rig", required=True)
    parser.add_argument("--map", type=Path, required=True)
    parser.add_argument("--base", default="axis_a")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    labels = json.loads((options.logs / "labels.json").read_text(encoding="utf-8"))
    mine = {name: label for name, label in labels.items() if name.startswith(f"{options.rig}/")}
    channel_map = ChannelMap.load(options.map)
    healthy = [
        read_log(options.logs / n, channel_map).samples for n, label in mine.items() if label["baseline"]
    ]
    unit = add_baseline(identify_unit(healthy, Unit.load(options.base), options.rig).unit, healthy)
    answers = []
    print("| log | load | truth | answer | onset: truth, answer | verdict is |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name in sorted(n for n, label in mine.items() if not label["baseline"]):
        log = read_log(options.logs / name, channel_map)
        pipeline = Pipeline(unit, axis=options.rig, log=name)
        pipeline.push(log.samples)
        found = pipeline.finish()
        answers.append(json.loads(found.model_dump_json(by_alias=True)))
        print(row(name, mine[name], found))
    if options.json is not None:
        options.json.write_text(json.dumps(answers, indent=1) + "\n", encoding="utf-8")


def row(name: str, label: dict[str, Any], found: Diagnosis) -> str:
    """One line of the table."""
    truth = ", ".join(f"{f['fault']} {f['severity']:.2f}" for f in label["faults"]) or "healthy"
    condition = "" if label["condition"] == "plain" else f", {label['condition']}"
    onsets = ", ".join(f"{f['onset_s']:.1f}" for f in label["faults"])
    if found.faults:
        first = found.faults[0]
        answer = f"{first.fault} ({100 * first.confidence:.0f} %)"
        if len(first.ambiguity) > 1:
            answer += f" or {', '.join(first.ambiguity[1:])}"
        onset = f"{onsets or '-'}; {first.onset_s:.1f} s (alarm {first.detected_s:.1f} s)"
    else:
        answer, onset = found.verdict, f"{onsets}; -" if onsets else ""
    return f"| {name} | {label['load']}{condition} | {truth} | {answer} | {onset} | {judged(label, found)} |"


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
