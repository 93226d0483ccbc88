"""MCAP logs to columns of numbers: JSON messages, topic by topic."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.mcap_records import Batch, Metadata, RecordWalk, Topic
from fdd.logs.near_misses import did_you_mean, listed
from fdd.samples import CHANNELS

Column = NDArray[np.float64]

MEASUREMENT_TOPIC = re.compile(r"^/eha/(?P<axis>[^/]+)/measurement$")


@dataclass
class Series:
    """The messages of one topic.

    Attributes
    ----------
    stamps : (n,) log times, ns, not decreasing.
    fields : field path to (n,) numbers; NaN where a message lacks the field.
    """

    stamps: NDArray[np.int64]
    fields: dict[str, Column]


@dataclass
class Recording:
    """What was read of an MCAP file.

    Attributes
    ----------
    series : by topic; only the topics that were asked for and have messages.
    topics : all topics of the file.
    metadata : metadata records by name.
    truncated : whether the file ends before its data does.
    damaged : number of chunks that could not be read and were left out.
    """

    series: dict[str, Series]
    topics: list[str]
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False
    damaged: int = 0


def read_topics(path: Path, wanted: Callable[[str], Sequence[str] | None]) -> Recording:
    """Read fields of some topics.

    Parameters
    ----------
    path : an MCAP file; it may end early.
    wanted : gives the field paths to read of a topic, or None to pass it over.

    Raises
    ------
    InputError : not MCAP, not JSON, or a field that is not a number.
    """
    walk = RecordWalk(path)
    by_number: dict[int, Topic] = {}
    parts: dict[str, list[tuple[NDArray[np.int64], dict[str, Column]]]] = {}
    metadata: dict[str, dict[str, str]] = {}
    topics: dict[str, None] = {}
    for record in walk:
        if isinstance(record, Topic):
            by_number[record.number] = record
            topics[record.name] = None
        elif isinstance(record, Metadata):
            metadata[record.name] = record.values
        else:
            _take(record, by_number, wanted, path, parts)
    series = {name: _joined(chunks) for name, chunks in parts.items()}
    return Recording(series, list(topics), metadata, walk.truncated, walk.damaged)


def _take(
    batch: Batch,
    by_number: Mapping[int, Topic],
    wanted: Callable[[str], Sequence[str] | None],
    path: Path,
    parts: dict[str, list[tuple[NDArray[np.int64], dict[str, Column]]]],
) -> None:
    for number, payloads in batch.payloads.items():
        topic = by_number.get(number)
        paths = None if topic is None else wanted(topic.name)
        if topic is None or paths is None:
            continue
        if topic.encoding != "json":
            raise InputError(
                f"topic {topic.name} carries {topic.encoding or 'unnamed'} messages, only json is read",
                where=path,
                mend="record JSON messages, or export the log as CSV",
            )
        messages = parsed(payloads, f"topic {topic.name}", path)
        columns = {p: numbers(messages, p, topic.name, path) for p in paths}
        stamps = np.array(batch.log_times[number], dtype=np.uint64).astype(np.int64)
        parts.setdefault(topic.name, []).append((stamps, columns))


def objects_at_once(payloads: Sequence[bytes]) -> list[dict[str, Any]] | None:
    """Parse one JSON object from each payload in a single call; None where any is something else.

    Examples
    --------
    >>> objects_at_once([b'{"x": 1}', b'{"x": 2}']), objects_at_once([b'{"x": 1}', b"2"])
    ([{'x': 1}, {'x': 2}], None)
    """
    try:
        found = json.loads(b"[" + b",".join(payloads) + b"]")
    except (ValueError, RecursionError):
        return None
    # One payload may hold two objects with a comma between them.
    whole = len(found) == len(payloads) and all(type(one) is dict for one in found)
    return list(found) if whole else None


def parsed(payloads: Sequence[bytes], place: str, where: Path) -> list[dict[str, Any]]:
    """Parse JSON objects, all of a chunk in one call.

    Raises
    ------
    InputError : a message that is not one JSON object.

    Examples
    --------
    >>> parsed([b'{"x": 1}', b'{"x": 2}'], "topic /daq", Path("a.mcap"))
    [{'x': 1}, {'x': 2}]
    """
    messages = objects_at_once(payloads)
    if messages is not None:
        return messages
    for number, payload in enumerate(payloads):
        try:
            if isinstance(json.loads(payload), dict):
                continue
            problem = "not a JSON object"
        except (ValueError, RecursionError) as error:
            problem = f"not JSON ({type(error).__name__})"
        raise InputError(
            f"{place}: message {number} of a chunk is {problem}: {payload[:40]!r}",
            where=where,
            mend="record one JSON object per message",
        )
    return [json.loads(p) for p in payloads]


def numbers(messages: Sequence[Mapping[str, Any]], path: str, topic: str, where: Path) -> Column:
    """One field of all messages; NaN where it is absent or null.

    Parameters
    ----------
    path : the field's key, or keys joined by dots that go deeper.

    Raises
    ------
    InputError : the field holds text, a list or an object.

    Examples
    --------
    >>> numbers([{"p": {"a": 1.5}}, {}], "p.a", "/daq", Path("a.mcap")).tolist()
    [1.5, nan]
    """
    values: list[Any] = [m.get(path) for m in messages]
    if "." in path and all(v is None for v in values):
        values = list(messages)
        for key in path.split("."):
            values = [v.get(key) if isinstance(v, dict) else None for v in values]
    try:
        return np.array(values, dtype=np.float64).reshape(len(messages))
    except (TypeError, ValueError, OverflowError):
        odd = next((v for v in values if v is not None and not isinstance(v, int | float)), values[0])
        raise InputError(
            f"topic {topic}, field {path!r}: {str(odd)[:40]!r} is not a number",
            where=where,
            mend="name a field that holds numbers",
        ) from None


def _joined(chunks: list[tuple[NDArray[np.int64], dict[str, Column]]]) -> Series:
    stamps = np.concatenate([s for s, _ in chunks])
    fields = {p: np.concatenate([c[p] for _, c in chunks]) for p in chunks[0][1]}
    if (np.diff(stamps) < 0).any():
        # The log time is the order of an MCAP file, whatever order the messages were written in.
        order = np.argsort(stamps, kind="stable")
        stamps, fields = stamps[order], {p: v[order] for p, v in fields.items()}
    return Series(stamps, fields)


def fields_of(path: Path, topic: str) -> list[str]:
    """All field paths in the first messages of a topic, for the error that lists them."""
    by_number: dict[int, Topic] = {}
    for record in RecordWalk(path):
        if isinstance(record, Topic):
            by_number[record.number] = record
        elif isinstance(record, Batch):
            for number, payloads in record.payloads.items():
                found = by_number.get(number)
                if found is not None and found.name == topic:
                    return list(
                        dict.fromkeys(p for m in parsed(payloads[:20], topic, path) for p in _paths(m))
                    )
    return []


def _paths(message: Mapping[str, Any], prefix: str = "") -> Iterable[str]:
    for key, value in message.items():
        if isinstance(value, dict):
            yield from _paths(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def require_field(path: Path, recording: Recording, topic: str, field_path: str) -> Column:
    """The field's numbers; an error that names what there is where it is absent.

    Raises
    ------
    InputError : no such topic, no message on it, or no such field.
    """
    if topic not in recording.topics:
        raise InputError(
            f"no topic {topic}{did_you_mean(topic, recording.topics)}",
            where=path,
            mend=f"the file has: {listed(recording.topics) or 'none'}",
        )
    series = recording.series.get(topic)
    if series is None:
        raise InputError(f"no message on topic {topic}", where=path, mend="record it, or map another topic")
    column = series.fields[field_path]
    if not np.isfinite(column).any():
        there = fields_of(path, topic)
        if field_path not in there:
            raise InputError(
                f"topic {topic}: no field {field_path!r}{did_you_mean(field_path, there)}",
                where=path,
                mend=f"the messages have: {listed(there)}",
            )
    return column


def contract_fields(topic: str) -> list[str] | None:
    """Fields to read of a topic where there is no map: the contract's channels.

    Examples
    --------
    >>> contract_fields("/eha/axis_a/truth") is None
    True
    """
    return list(CHANNELS) if MEASUREMENT_TOPIC.match(topic) else None
