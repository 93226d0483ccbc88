"""MCAP out: runs of the plant, whole or block by block with bounded memory, and logs with their diagnosis.

Topics are the contract's: ``/eha/<axis>/measurement``, ``/truth``, ``/estimate`` and ``/diagnosis``, and
``/events`` with `foxglove.Log` messages in JSON. Truth never stands in the measurement.
"""

from __future__ import annotations

import heapq
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.writer import Writer
from numpy.typing import ArrayLike, NDArray

from fdd import __version__
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.samples import CHANNELS, Samples

CHUNK_BYTES = 1 << 20
AT_ONCE = 4096
"""Messages of a topic that are made at once."""
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
    """A stretch of one axis's run: what was measured, perhaps no rows, and true quantities by name, ``time``
    (m,) s and columns (m,); without a ``time`` on the samples'."""

    samples: Samples
    truth: Mapping[str, ArrayLike] | None
    axis: str


def require_axis(axis: str) -> None:
    """Refuse a name that cannot stand in a topic."""
    if not re.fullmatch(r"[A-Za-z0-9_.\-]{1,64}", axis):
        raise InputError(f"axis {axis[:70]!r} cannot stand in a topic", mend="use letters, digits, _ . and -")


def write_blocks(
    path: str | Path, blocks: Iterable[RunBlock], *, axes: Sequence[str],
    units: Mapping[str, str] | None = None, scenario_json: str | None = None,
    labels: Mapping[str, Any] | None = None, start_ns: int = 0,
) -> None:  # fmt: skip
    """Write a run, whole or not at all; the messages do not depend on how the rows are cut into blocks.

    Parameters
    ----------
    blocks : of some seconds each, those of several axes in turn: what they overlap, chunks in the file do.
    units : profile (YAML) of each axis: metadata record ``unit``, key ``yaml``, or the names of several axes.
    scenario_json, labels : metadata records ``scenario`` and ``labels`` (key json).
    start_ns : ns; log time of t = 0.

    Raises InputError: an axis that is no topic, columns that change, or a folder that is not there.
    """
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
            root, time = f"/eha/{block.axis}", block.samples.time
            topics: dict[str, Mapping[str, ArrayLike]] = {}
            topics[f"{root}/measurement"] = {"time": time, **block.samples.columns}
            if block.truth is not None:
                topics[f"{root}/truth"] = {"time": time, **block.truth}
            out.add_columns(topics)


def write_run(
    path: str | Path, samples: Samples, *, axis: str, truth: Mapping[str, ArrayLike] | None = None,
    unit_yaml: str | None = None, **about: Any,
) -> None:  # fmt: skip
    """Write a run of one axis that is there as a whole; `about` as for `write_blocks`."""
    units = None if unit_yaml is None else {axis: unit_yaml}
    write_blocks(path, [RunBlock(samples, truth, axis)], axes=[axis], units=units, **about)


def write_annotated(
    path: str | Path, samples: Samples, trajectories: Mapping[str, Any], diagnosis_json: str, *, axis: str,
    unit_yaml: str | None = None, start_ns: int = 0,
) -> None:  # fmt: skip
    """Write a log, as its measurement, with its diagnosis: estimates, windows, events and the answer.

    `trajectories`: `vars()` of a diagnosis's `Trajectories`; what is absent is left out. `diagnosis_json`:
    the whole answer: the metadata record ``diagnosis`` (key json), and a message at onset and detection of
    each of its faults. `start_ns`: ns; log time of t = 0.
    """
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
            for fault in faults:
                names = " or ".join(fault.get("ambiguity") or [fault["fault"]])
                sure = f"confidence {fault['confidence']:.2f}"
                said = "; ".join([sure, *fault.get("evidence", [])])
                begins = fault["onset_s"], _WARNING, f"{names} begins ({sure})"
                detected = fault["detected_s"], _ERROR, f"{names} detected ({said})"
                for time, level, text in (begins, detected):
                    stamp = int(out.log_times([time])[0])
                    message = {
                        "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9}, "level": level,
                        "message": text, "name": axis, "file": "", "line": 0,
                    }  # fmt: skip
                    out.add_message(channel, stamp, json.dumps(message, ensure_ascii=False).encode(), stamp)
        out.add_columns({name: columns for name, columns in topics.items() if np.size(columns["time"])})


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


class _Topic(NamedTuple):
    """Columns (whether boolean), channel, and message: one of zeros, and where its values stand."""

    columns: dict[str, bool]
    channel: int
    message: bytes
    places: np.dtype[np.void]


class ColumnWriter(Writer):
    """The library's writer (chunks, zstd, checksums, indexes), which takes columns too; see `mcap_file`."""

    def __init__(self, stream: Any, start_ns: int) -> None:
        super().__init__(stream, chunk_size=CHUNK_BYTES)
        self._start_ns = start_ns
        self._topics: dict[str, _Topic] = {}

    def log_times(self, time: ArrayLike) -> NDArray[np.int64]:
        """Log times (ns) of (n,) seconds; InputError before 0, which MCAP cannot hold."""
        stamps = self._start_ns + np.rint(np.asarray(time, dtype=np.float64) * 1e9).astype(np.int64)
        if stamps.size and stamps.min() < 0:
            problem = f"time starts at {np.min(time):.3f} s, MCAP has no negative times"
            raise InputError(problem, mend="give a start_ns")
        return np.asarray(stamps)

    def add_columns(self, topics: Mapping[str, Mapping[str, ArrayLike]]) -> None:
        """Write the next messages of some topics in the order of time.

        `topics`: name to columns (n,), with a ``time``, s; ``ekf.leakage`` is a field of a nested message.

        Raises InputError: columns of several lengths, or other ones than the topic's; a time before 0.
        """
        messages = []
        for name, columns in topics.items():
            stamps, values = self.log_times(columns["time"]), {f: np.asarray(v) for f, v in columns.items()}
            kinds = {field: column.dtype == np.bool_ for field, column in values.items()}
            topic = self._topics.get(name) or self._register(name, kinds)
            if kinds != topic.columns:
                told = f"{name}: columns {', '.join(kinds)} after blocks with {', '.join(topic.columns)}"
                raise InputError(told, mend="give all blocks the same columns")
            for field, column in values.items():
                if column.shape != stamps.shape:
                    raise InputError(f"{name} {field}: {column.size} values for {stamps.size} time stamps")
            messages.append(_messages(topic, stamps, values))
        for stamp, channel, message in heapq.merge(*messages):
            self.add_message(channel, stamp, message, stamp)

    def _register(self, name: str, kinds: dict[str, bool]) -> _Topic:
        title = f"fdd.{name.rpartition('/')[2].title()}"
        package, _, short = title.rpartition(".")
        files = FileDescriptorSet()
        # proto2, whose fields tell whether they are there without the made-up oneofs of proto3.
        file = files.file.add(name=f"{title}.proto", package=package, syntax="proto2")
        message, places = _layout(kinds, file.message_type.add(name=short), f".{title}")
        names, formats, offsets = zip(*places, strict=True)
        values: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(message)}
        about = {f: f"{CHANNELS[f].unit}: {CHANNELS[f].meaning}" for f in kinds if f in CHANNELS}
        schema = self.register_schema(title, "protobuf", files.SerializeToString())
        channel = self.register_channel(name, "protobuf", schema, about)
        return self._topics.setdefault(name, _Topic(kinds, channel, message, np.dtype(values)))


def _messages(
    topic: _Topic, stamps: NDArray[np.int64], values: Mapping[str, NDArray[Any]]
) -> Iterator[tuple[int, int, bytes]]:
    """Log time (ns), channel and bytes of each row; they have one length, so many are one NumPy array."""
    size = len(topic.message)
    for start in range(0, stamps.size, AT_ONCE):
        rows = slice(start, start + AT_ONCE)
        records = np.frombuffer(bytearray(topic.message) * stamps[rows].size, topic.places)
        for field, column in values.items():
            # Foxglove shows an absent number as 0 and leaves NaN out, but scales its axis to an infinity.
            records[field] = np.where(np.isinf(column[rows]), np.nan, column[rows])
        body = records.tobytes()
        for row, stamp in enumerate(stamps[rows].tolist()):
            yield stamp, topic.channel, body[row * size : (row + 1) * size]


def _layout(fields: Mapping[str, bool], type_: Any, title: str) -> tuple[bytes, list[tuple[str, str, int]]]:
    """Declare fields, an ``optional double`` or ``optional bool`` (True) each, ``ekf.leakage`` in the nested
    message ekf; a message of zeros, and name, format and offset of each value in it."""
    groups: dict[str, dict[str, bool]] = {}
    for path, boolean in fields.items():
        name, _, rest = path.partition(".")
        groups.setdefault(name, {})[rest] = boolean
    message, places = b"", []
    for number, (name, members) in enumerate(groups.items(), start=1):
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
            raise InputError(f"{name[:70]!r} cannot name a field", mend="use letters, digits and _")
        field = type_.field.add(name=name, number=number)
        field.label = field.LABEL_OPTIONAL
        if "" in members:
            boolean = members[""]
            field.type = field.TYPE_BOOL if boolean else field.TYPE_DOUBLE
            message += _varint(number << 3 | (not boolean))
            places.append((name, "?" if boolean else "<f8", len(message)))
            message += bytes(1 if boolean else 8)
        else:
            field.type, field.type_name = field.TYPE_MESSAGE, f"{title}.{name}_fields"
            inner, below = _layout(members, type_.nested_type.add(name=f"{name}_fields"), field.type_name)
            message += _varint(number << 3 | 2) + _varint(len(inner))
            places += [(f"{name}.{path}", form, len(message) + at) for path, form, at in below]
            message += inner
    return message, places


def _varint(value: int) -> bytes:
    return bytes([value]) if value < 128 else bytes([value & 127 | 128]) + _varint(value >> 7)


@contextmanager
def mcap_file(
    path: str | Path, metadata: Mapping[str, Mapping[str, str]] | None = None, start_ns: int = 0
) -> Iterator[ColumnWriter]:
    """A file to write columns into; it appears whole or not at all.

    `metadata`, records of name to texts, come first: a file that is cut off later still tells what it was.
    `start_ns`: ns; log time of t = 0.
    """
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        writer = ColumnWriter(stream, start_ns)
        writer.start(library=f"fdd {__version__}")
        for name, values in (metadata or {}).items():
            writer.add_metadata(name, dict(values))
        yield writer
        writer.finish()
