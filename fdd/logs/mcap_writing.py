"""MCAP out: logs with their diagnosis beside them (runs of the plant: `fdd.logs.mcap_runs`).

Topics are the contract's: ``/eha/<axis>/measurement``, ``/truth``, ``/estimate`` and
``/diagnosis``, and ``/events`` with `foxglove.Log` messages. Truth never stands in
the measurement.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fdd.logs.json_rows import Columns
from fdd.logs.mcap_merging import Messages, merged_file, nanoseconds, require_axis
from fdd.logs.mcap_runs import run_metadata, write_run, write_whole
from fdd.samples import Samples

__all__ = ["Event", "events_of", "write_annotated", "write_run"]

_LEVELS = {"info": 2, "warning": 3, "error": 4}

_LOG_SCHEMA = {
    "title": "foxglove.Log",
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "title": "time",
            "properties": {
                "sec": {"type": "integer", "minimum": 0},
                "nsec": {"type": "integer", "minimum": 0},
            },
        },
        "level": {
            "type": "integer",
            "oneOf": [
                {"title": title, "const": number}
                for number, title in enumerate(("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"))
            ],
        },
        "message": {"type": "string"},
        "name": {"type": "string"},
        "file": {"type": "string"},
        "line": {"type": "integer", "minimum": 0},
    },
}


@dataclass(frozen=True)
class Event:
    """Something to show at a time: ``level`` is info, warning or error."""

    time: float
    message: str
    level: str = "info"


def write_annotated(
    path: str | Path,
    samples: Samples,
    trajectories: Mapping[str, Any],
    diagnosis_json: str,
    *,
    axis: str,
    events: Sequence[Event] = (),
    unit_yaml: str | None = None,
    start_ns: int = 0,
) -> None:
    """Write a log with its diagnosis: estimates, windows, events and the answer.

    Parameters
    ----------
    samples : the log, written as its measurement.
    trajectories : as `vars()` of a diagnosis's trajectories: ``time`` (n,) s;
        ``estimates`` and ``stds`` (filter to quantity to (n,)); ``observable``
        (quantity to (n,) bool); ``held``, ``held_std`` and ``information_std`` (quantity to
        (n,)); ``nis`` (filter to (n,)); ``window_time`` (m,) s;
        ``statistic`` (m,), ``threshold`` (number), ``probabilities`` (family to
        (m,)); ``feature_names`` (k,) and ``features`` (m, k). What is absent is left out.
    diagnosis_json : the whole answer; the metadata record ``diagnosis`` (key json).
    events : shown as `foxglove.Log` messages. Without any, they are made of the
        answer's faults: an error at each onset and detection.
    start_ns : ns; log time of t = 0.

    Examples
    --------
    >>> write_annotated("out.mcap", samples, vars(t), answer, axis="axis_a")  # doctest: +SKIP
    """
    require_axis(axis)
    metadata = run_metadata([axis], None if unit_yaml is None else {axis: unit_yaml}, None)
    metadata["diagnosis"] = {"json": diagnosis_json}
    columns: Columns = {"time": samples.time, **samples.columns}
    topics = [(f"/eha/{axis}/measurement", "fdd.Measurement", columns), *_results(trajectories, axis)]
    shown = list(events) or events_of(diagnosis_json)
    with merged_file(path, metadata) as merged:
        write_whole(merged, topics, start_ns, _log_messages(shown, axis, start_ns))


def events_of(diagnosis_json: str) -> list[Event]:
    """Onset and detection of each fault in an answer, as events.

    Examples
    --------
    >>> events_of('{"faults": [{"fault": "aeration", "confidence": 0.9, "onset_s": 3, "detected_s": 4}]}')[0]
    Event(time=3.0, message='aeration begins (confidence 0.90)', level='warning')
    """
    events = []
    for fault in json.loads(diagnosis_json).get("faults", []):
        names = " or ".join(fault.get("ambiguity") or [fault["fault"]])
        confidence = f"confidence {fault['confidence']:.2f}"
        events.append(Event(float(fault["onset_s"]), f"{names} begins ({confidence})", "warning"))
        said = "; ".join([confidence, *fault.get("evidence", [])])
        events.append(Event(float(fault["detected_s"]), f"{names} detected ({said})", "error"))
    return sorted(events, key=lambda e: e.time)


def _results(trajectories: Mapping[str, Any], axis: str) -> Iterator[tuple[str, str, Columns]]:
    time = np.asarray(trajectories.get("time", ()), dtype=np.float64)
    if time.size:
        estimate: dict[str, Any] = {"time": time}
        for tracker, quantities in trajectories.get("estimates", {}).items():
            stds = trajectories.get("stds", {}).get(tracker, {})
            members: dict[str, Any] = {}
            for name, value in quantities.items():
                members[name] = value
                if stds.get(name) is not None:
                    members[f"{name}_std"] = stds[name]
            nis = trajectories.get("nis", {}).get(tracker)
            estimate[tracker] = members if nis is None else {**members, "nis": nis}
        if trajectories.get("observable"):
            estimate["observable"] = dict(trajectories["observable"])
        for what in ("held", "held_std", "information_std"):
            if trajectories.get(what):
                estimate[what] = dict(trajectories[what])
        yield f"/eha/{axis}/estimate", "fdd.Estimate", estimate
    window = np.asarray(trajectories.get("window_time", ()), dtype=np.float64)
    if window.size:
        verdict: dict[str, Any] = {"time": window}
        if trajectories.get("statistic") is not None:
            verdict["statistic"] = trajectories["statistic"]
        if trajectories.get("threshold") is not None:
            verdict["threshold"] = np.full(window.size, float(trajectories["threshold"]))
        if trajectories.get("probabilities"):
            verdict["probabilities"] = dict(trajectories["probabilities"])
        names = trajectories.get("feature_names") or ()
        if len(names):
            features = np.asarray(trajectories["features"], dtype=np.float64)
            verdict["features"] = {name: features[:, k] for k, name in enumerate(names)}
        yield f"/eha/{axis}/diagnosis", "fdd.Diagnosis", verdict


def _log_messages(events: Sequence[Event], axis: str, start_ns: int) -> Messages | None:
    if not events:
        return None
    stamps = nanoseconds(np.array([e.time for e in events]), start_ns)
    texts = [_log_message(e, int(s), axis) for e, s in zip(events, stamps, strict=True)]
    return Messages(f"/eha/{axis}/events", "foxglove.Log", json.dumps(_LOG_SCHEMA).encode(), stamps, texts)


def _log_message(event: Event, stamp: int, axis: str) -> bytes:
    second, nanosecond = divmod(stamp, 1_000_000_000)
    return json.dumps(
        {
            "timestamp": {"sec": second, "nsec": nanosecond},
            "level": _LEVELS.get(event.level, 2),
            "message": event.message,
            "name": axis,
            "file": "",
            "line": 0,
        },
        ensure_ascii=False,
    ).encode()
