"""MCAP out: logs with their diagnosis beside them (runs of the plant: `fdd.logs.mcap_runs`).

Topics are the contract's: ``/eha/<axis>/measurement``, ``/estimate`` and ``/diagnosis``, and ``/events`` with
`foxglove.Log` messages in JSON.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fdd.logs.mcap_chunks import ColumnWriter, mcap_file
from fdd.logs.mcap_runs import require_axis, write_run
from fdd.samples import Samples

__all__ = ["write_annotated", "write_run"]

INFO, _WARNING, _ERROR = 2, 3, 4
_NUMBER, _TEXT = {"type": "integer"}, {"type": "string"}
LOG_SCHEMA = {
    "title": "foxglove.Log", "type": "object",
    "properties": {
        "timestamp": {"type": "object", "title": "time", "properties": {"sec": _NUMBER, "nsec": _NUMBER}},
        "level": _NUMBER, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _NUMBER,
    },
}  # fmt: skip


def write_annotated(
    path: str | Path,
    samples: Samples,
    trajectories: Mapping[str, Any],
    diagnosis_json: str,
    *,
    axis: str,
    unit_yaml: str | None = None,
    start_ns: int = 0,
) -> None:
    """Write a log with its diagnosis: estimates, windows, events and the answer.

    Parameters
    ----------
    samples : the log, written as its measurement.
    trajectories : `vars()` of a diagnosis's `Trajectories`; what is absent is left out.
    diagnosis_json : the whole answer: the metadata record ``diagnosis`` (key json), and a message at onset
        and detection of each of its faults.
    start_ns : ns; log time of t = 0.
    """
    require_axis(axis)
    metadata = {} if unit_yaml is None else {"unit": {"yaml": unit_yaml}}
    metadata["diagnosis"] = {"json": diagnosis_json}
    topics = {
        f"/eha/{axis}/measurement": {"time": samples.time, **samples.columns},
        f"/eha/{axis}/estimate": estimate_columns(trajectories),
        f"/eha/{axis}/diagnosis": diagnosis_columns(trajectories),
    }
    with mcap_file(path, metadata, start_ns) as out:
        if faults := json.loads(diagnosis_json).get("faults"):
            _add_events(out, faults, axis)
        out.add_columns({name: columns for name, columns in topics.items() if np.size(columns["time"])})


def estimate_columns(t: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of the estimate: of each filter its quantities, their ``_std`` and its ``nis``."""
    columns = {"time": t.get("time", ())}
    for tracker, quantities in t.get("estimates", {}).items():
        stds = t.get("stds", {}).get(tracker, {})
        for name, values in quantities.items():
            columns[f"{tracker}.{name}"] = values
            if name in stds:
                columns[f"{tracker}.{name}_std"] = stds[name]
        if tracker in t.get("nis", {}):
            columns[f"{tracker}.nis"] = t["nis"][tracker]
    for group in ("observable", "held", "held_std", "information_std"):
        columns |= {f"{group}.{name}": values for name, values in t.get(group, {}).items()}
    return columns


def diagnosis_columns(t: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of the diagnosis, a row for each window."""
    columns = {"time": t.get("window_time", ())}
    if "statistic" in t:
        columns["statistic"] = t["statistic"]
    if "threshold" in t:
        columns["threshold"] = np.full(np.size(columns["time"]), t["threshold"])
    columns |= {f"probabilities.{name}": values for name, values in t.get("probabilities", {}).items()}
    features = np.transpose(t.get("features", ()))
    return columns | {f"features.{n}": f for n, f in zip(t.get("feature_names", ()), features, strict=True)}


def _add_events(out: ColumnWriter, faults: list[dict[str, Any]], axis: str) -> None:
    schema = out.register_schema("foxglove.Log", "jsonschema", json.dumps(LOG_SCHEMA).encode())
    channel = out.register_channel(f"/eha/{axis}/events", "json", schema)
    for fault in faults:
        for time, level, text in events_of(fault):
            stamp = int(out.log_times([time])[0])
            out.add_message(channel, stamp, log_message(stamp, level, text, axis), stamp)


def events_of(fault: Mapping[str, Any]) -> list[tuple[float, int, str]]:
    """Time (s), level and text of the onset and of the detection of a finding."""
    names = " or ".join(fault.get("ambiguity") or [fault["fault"]])
    sure = f"confidence {fault['confidence']:.2f}"
    said = "; ".join([sure, *fault.get("evidence", [])])
    return [
        (fault["onset_s"], _WARNING, f"{names} begins ({sure})"),
        (fault["detected_s"], _ERROR, f"{names} detected ({said})"),
    ]


def log_message(stamp: int, level: int, text: str, axis: str) -> bytes:
    """A message of `LOG_SCHEMA`, at Unix ns."""
    second, nanosecond = divmod(stamp, 1_000_000_000)
    message = {
        "timestamp": {"sec": second, "nsec": nanosecond}, "level": level, "message": text,
        "name": axis, "file": "", "line": 0,
    }  # fmt: skip
    return json.dumps(message, ensure_ascii=False).encode()
