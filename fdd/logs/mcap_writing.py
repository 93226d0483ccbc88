"""MCAP out: runs of the plant, whole or block by block with bounded memory, and logs with their diagnosis.

Topics are the contract's: ``/eha/<axis>/measurement``, ``/truth``, ``/estimate`` and ``/diagnosis``, and
``/events`` with `foxglove.Log` messages in JSON. Truth never stands in the measurement.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fdd.errors import InputError
from fdd.samples import Samples

_NUMBER, _TEXT = {"type": "integer"}, {"type": "string"}
LOG_SCHEMA = {
    "title": "foxglove.Log", "type": "object",
    "properties": {
        "timestamp": {"type": "object", "title": "time", "properties": {"sec": _NUMBER, "nsec": _NUMBER}},
        "level": _NUMBER, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _NUMBER,
    },
}  # fmt: skip
_WARNING, _ERROR = 3, 4


@dataclass(frozen=True)
class RunBlock:
    """A stretch of one axis's run.

    Attributes
    ----------
    samples : what was measured; may be empty, with its channels.
    truth : true quantities by name, ``time`` (m,) s and columns (m,); without a ``time`` on the samples' own.
    axis : name of the axis in the topics; None for the file's only one.
    """

    samples: Samples
    truth: Mapping[str, ArrayLike] | None = None
    axis: str | None = None

    def axis_of(self, axes: Sequence[str]) -> str:
        """The block's axis; InputError where it is none of the run's."""
        axis = axes[0] if self.axis is None and len(axes) == 1 else self.axis
        if axis is None or axis not in axes:
            problem = f"a block of axis {axis!r} in a run of {', '.join(axes)}"
            raise InputError(problem, mend="name one of these axes")
        return axis


def require_axis(axis: str) -> None:
    """Refuse a name that cannot stand in a topic."""
    if not re.fullmatch(r"[A-Za-z0-9_.\-]{1,64}", axis):
        raise InputError(f"axis {axis[:70]!r} cannot stand in a topic", mend="use letters, digits, _ . and -")


def write_blocks(
    path: str | Path,
    blocks: Iterable[RunBlock],
    *,
    axes: Sequence[str],
    units: Mapping[str, str] | None = None,
    scenario_json: str | None = None,
    labels: Mapping[str, Any] | None = None,
    start_ns: int = 0,
) -> None:
    """Write a run from an iterator of blocks; the messages do not depend on how the rows are cut into them.

    Parameters
    ----------
    path : the file; it appears whole or not at all.
    blocks : of some seconds each, those of several axes in turn: what they overlap, chunks in the file do.
    axes : names of all axes.
    units : profile (YAML) of each axis that has one: metadata record ``unit`` with the key ``yaml`` for one
        axis, with the axes' names as keys for several.
    scenario_json, labels : metadata records ``scenario`` and ``labels`` (key json).
    start_ns : ns; log time of t = 0.

    Raises
    ------
    InputError : an axis that is no topic, columns that change, or a folder that is not there.
    """
    from fdd.logs.mcap_chunks import mcap_file  # takes a while: not before it is needed

    if not axes or len(set(axes)) < len(axes):
        raise InputError("a run needs axes of different names", where=path, mend="name each axis once")
    for axis in axes:
        require_axis(axis)
    records: dict[str, dict[str, str]] = {}
    if units:
        records["unit"] = {"yaml" if len(axes) == 1 else a: units[a] for a in axes if a in units}
    if scenario_json is not None:
        records["scenario"] = {"json": scenario_json}
    if labels is not None:
        records["labels"] = {"json": json.dumps(labels, allow_nan=False)}
    with mcap_file(path, records, start_ns) as out:
        for block in blocks:
            root, time = f"/eha/{block.axis_of(axes)}", block.samples.time
            topics: dict[str, Mapping[str, ArrayLike]] = {
                f"{root}/measurement": {"time": time, **block.samples.columns}
            }
            if block.truth is not None:
                topics[f"{root}/truth"] = {"time": time, **block.truth}
            out.add_columns(topics)


def write_run(
    path: str | Path,
    samples: Samples,
    *,
    axis: str,
    truth: Mapping[str, ArrayLike] | None = None,
    unit_yaml: str | None = None,
    **about: Any,
) -> None:
    """Write a run of one axis that is there as a whole; `about` as for `write_blocks`."""
    units = None if unit_yaml is None else {axis: unit_yaml}
    write_blocks(path, [RunBlock(samples, truth)], axes=[axis], units=units, **about)


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
    from fdd.logs.mcap_chunks import mcap_file

    require_axis(axis)
    metadata = {} if unit_yaml is None else {"unit": {"yaml": unit_yaml}}
    metadata["diagnosis"] = {"json": diagnosis_json}
    root = f"/eha/{axis}"
    topics = {
        f"{root}/measurement": {"time": samples.time, **samples.columns},
        f"{root}/estimate": _estimate_columns(trajectories),
        f"{root}/diagnosis": _diagnosis_columns(trajectories),
    }
    with mcap_file(path, metadata, start_ns) as out:
        if faults := json.loads(diagnosis_json).get("faults"):
            schema = out.register_schema("foxglove.Log", "jsonschema", json.dumps(LOG_SCHEMA).encode())
            channel = out.register_channel(f"{root}/events", "json", schema)
            for time, level, text in (event for fault in faults for event in _events(fault)):
                stamp = int(out.log_times([time])[0])
                message = {
                    "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}, "level": level,
                    "message": text, "name": axis, "file": "", "line": 0,
                }  # fmt: skip
                out.add_message(channel, stamp, json.dumps(message, ensure_ascii=False).encode(), stamp)
        out.add_columns({name: columns for name, columns in topics.items() if np.size(columns["time"])})


def _events(fault: Mapping[str, Any]) -> list[tuple[float, int, str]]:
    """Time (s), level and text of the onset and of the detection of a finding."""
    names = " or ".join(fault.get("ambiguity") or [fault["fault"]])
    sure = f"confidence {fault['confidence']:.2f}"
    said = "; ".join([sure, *fault.get("evidence", [])])
    return [
        (fault["onset_s"], _WARNING, f"{names} begins ({sure})"),
        (fault["detected_s"], _ERROR, f"{names} detected ({said})"),
    ]


def _estimate_columns(t: Mapping[str, Any]) -> dict[str, Any]:
    """Of each filter its quantities, their ``_std`` and its ``nis``."""
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


def _diagnosis_columns(t: Mapping[str, Any]) -> dict[str, Any]:
    """A row for each window."""
    columns = {"time": t.get("window_time", ())}
    if "statistic" in t:
        columns["statistic"] = t["statistic"]
    if "threshold" in t:
        columns["threshold"] = np.full(np.size(columns["time"]), t["threshold"])
    columns |= {f"probabilities.{name}": values for name, values in t.get("probabilities", {}).items()}
    features = np.transpose(t.get("features", ()))
    return columns | {f"features.{n}": f for n, f in zip(t.get("feature_names", ()), features, strict=True)}
