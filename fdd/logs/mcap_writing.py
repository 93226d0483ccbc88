"""MCAP out: runs of the plant, and logs with their diagnosis beside them.

Topics are the contract's: ``/eha/<axis>/measurement``, ``/truth``, ``/estimate`` and
``/diagnosis``, and ``/events`` with `foxglove.Log` messages. Truth never stands in
the measurement. Times are ns; chunks of 1 MiB, zstd, with checksums and indexes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd import __version__
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.logs.json_rows import Columns, json_rows, json_schema
from fdd.samples import CHANNELS, Samples

if TYPE_CHECKING:
    from mcap.writer import Writer

CHUNK_BYTES = 1 << 20
LIBRARY = f"fdd {__version__}"
_LEVELS = {"info": 2, "warning": 3, "error": 4}
_AXIS = re.compile(r"[A-Za-z0-9_.\-]{1,64}")

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


@dataclass(frozen=True)
class Topic:
    """Messages of one topic to write: (n,) times in s and the columns of each message."""

    name: str
    title: str
    time: NDArray[np.float64]
    columns: Columns


def write_run(
    path: str | Path,
    samples: Samples,
    *,
    axis: str,
    truth: Mapping[str, ArrayLike] | None = None,
    unit_yaml: str | None = None,
    scenario_json: str | None = None,
    labels: Mapping[str, Any] | None = None,
    start_ns: int = 0,
) -> None:
    """Write a simulated or recorded run.

    Parameters
    ----------
    path : the file; it appears whole or not at all.
    samples : what was measured.
    axis : name of the axis in the topics.
    truth : true quantities by name; ``time`` (m,) s and columns (m,). Without a
        ``time``, on the samples' own.
    unit_yaml, scenario_json, labels : travel as the metadata records ``unit``
        (key yaml), ``scenario`` and ``labels`` (key json).
    start_ns : ns; log time of t = 0.

    Raises
    ------
    InputError : a name of an axis that is no topic, or a folder that is not there.

    Examples
    --------
    >>> write_run("run.mcap", samples, axis="axis_a")  # doctest: +SKIP
    """
    topics = [_measurement(samples, axis)]
    if truth is not None:
        columns: dict[str, Any] = {k: np.asarray(v) for k, v in truth.items() if k != "time"}
        time = np.asarray(truth.get("time", samples.time), dtype=np.float64)
        topics.append(Topic(f"/eha/{axis}/truth", "fdd.Truth", time, {"time": time, **columns}))
    metadata = _metadata(unit_yaml, scenario_json)
    if labels is not None:
        metadata["labels"] = {"json": json.dumps(labels, allow_nan=False)}
    with _writing(Path(path), axis) as stream:
        _write(stream, topics, [], axis, metadata, start_ns)


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
        (quantity to (n,) bool); ``nis`` (filter to (n,)); ``window_time`` (m,) s;
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
    topics = [_measurement(samples, axis), *_results(trajectories, axis)]
    metadata = _metadata(unit_yaml, None)
    metadata["diagnosis"] = {"json": diagnosis_json}
    shown = list(events) or events_of(diagnosis_json)
    with _writing(Path(path), axis) as stream:
        _write(stream, topics, shown, axis, metadata, start_ns)


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


def _measurement(samples: Samples, axis: str) -> Topic:
    columns = {"time": samples.time, **samples.columns}
    return Topic(f"/eha/{axis}/measurement", "fdd.Measurement", samples.time, columns)


def _results(trajectories: Mapping[str, Any], axis: str) -> Iterator[Topic]:
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
        yield Topic(f"/eha/{axis}/estimate", "fdd.Estimate", time, estimate)
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
        yield Topic(f"/eha/{axis}/diagnosis", "fdd.Diagnosis", window, verdict)


def _metadata(unit_yaml: str | None, scenario_json: str | None) -> dict[str, dict[str, str]]:
    records: dict[str, dict[str, str]] = {}
    if unit_yaml is not None:
        records["unit"] = {"yaml": unit_yaml}
    if scenario_json is not None:
        records["scenario"] = {"json": scenario_json}
    return records


@contextmanager
def _writing(path: Path, axis: str) -> Iterator[IO[bytes]]:
    """The stream of a file that is written whole or not at all; see `whole_file`."""
    if not _AXIS.fullmatch(axis):
        raise InputError(f"axis {axis[:70]!r} cannot stand in a topic", mend="use letters, digits, _ . and -")
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        yield stream


def _write(
    stream: IO[bytes],
    topics: Sequence[Topic],
    events: Sequence[Event],
    axis: str,
    metadata: Mapping[str, Mapping[str, str]],
    start_ns: int,
) -> None:
    from mcap.writer import CompressionType, Writer

    writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_crcs=True)
    writer.start(profile="", library=LIBRARY)
    # Metadata first: a file that is cut off later still tells what it was.
    for name, values in metadata.items():
        writer.add_metadata(name, dict(values))
    queued: list[tuple[NDArray[np.int64], Callable[[], list[bytes]], int]] = []
    units = {c.name: f"{c.unit}: {c.meaning}" for c in CHANNELS.values()}
    for topic in topics:
        stamps = _nanoseconds(topic.time, start_ns)
        schema = writer.register_schema(
            topic.title, "jsonschema", json_schema(topic.columns, topic.title, units)
        )
        channel = writer.register_channel(topic.name, "json", schema)
        queued.append((stamps, lambda columns=topic.columns: json_rows(columns), channel))  # type: ignore[misc]
    if events:
        schema = writer.register_schema("foxglove.Log", "jsonschema", json.dumps(_LOG_SCHEMA).encode())
        channel = writer.register_channel(f"/eha/{axis}/events", "json", schema)
        stamps = _nanoseconds(np.array([e.time for e in events]), start_ns)
        texts = [_log_message(e, int(s), axis) for e, s in zip(events, stamps, strict=True)]
        queued.append((stamps, lambda: texts, channel))
    _add_in_time_order(writer, queued)
    writer.finish()


def _add_in_time_order(
    writer: Writer, queued: Sequence[tuple[NDArray[np.int64], Callable[[], list[bytes]], int]]
) -> None:
    """Merge the topics by time, so that a reader of any part of the file finds all of them."""
    if not queued:
        return
    stamps = np.concatenate([s for s, _, _ in queued])
    channels = np.concatenate([np.full(s.size, c) for s, _, c in queued])
    payloads = [p for _, make, _ in queued for p in make()]
    order = np.argsort(stamps, kind="stable")
    add = writer.add_message
    for row, stamp, channel in zip(
        order.tolist(), stamps[order].tolist(), channels[order].tolist(), strict=True
    ):
        add(channel, stamp, payloads[row], stamp)


def _nanoseconds(time: NDArray[np.float64], start_ns: int) -> NDArray[np.int64]:
    stamps = start_ns + np.rint(np.asarray(time, dtype=np.float64) * 1e9).astype(np.int64)
    if stamps.size and stamps.min() < 0:
        raise InputError(
            f"time starts at {float(np.min(time)):.3f} s, MCAP has no negative times", mend="give a start_ns"
        )
    return np.asarray(stamps, dtype=np.int64)


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
