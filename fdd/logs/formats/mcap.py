"""MCAP: topics of JSON, Protobuf or ROS messages, each field of a message a signal."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_SIGNALS
from fdd.errors import InputError
from fdd.logs.formats.signals import LogFile, Signal, require_size
from fdd.logs.wire.chunks import Batch, ChunkWalk
from fdd.logs.wire.messages import Decoder, FieldPath, decoder_of
from fdd.near_misses import did_you_mean, listed
from fdd.samples import Column

_NANOSECONDS = {"sec": ("nanosec", "nsec"), "seconds": ("nanos", "nanoseconds"), "secs": ("nsecs",)}


@dataclass
class McapFile(LogFile):
    """An MCAP file whose topics and fields are known.

    Attributes
    ----------
    topics : all topics, with messages or without.
    paths : signal to its field's path, or to those of the seconds and nanoseconds of a stamp.
    reasons : topic to why its messages cannot be read.
    """

    topics: list[str] = field(default_factory=list)
    paths: dict[str, tuple[FieldPath, ...]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    damaged: int = 0
    _stamps: dict[str, NDArray[np.int64]] = field(default_factory=dict)
    _seconds: dict[str, Column] = field(default_factory=dict)

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        """See `LogFile.read`. The rows are in the order of the log times."""
        wanted: dict[str, list[str]] = {}
        for name in dict.fromkeys(names):
            wanted.setdefault(str(self.signals[name].topic), []).append(name)
        return self._columns(wanted)

    def stamps(self, clock: str) -> Column | None:
        """(n,) s since the first message of the file's topics that were read."""
        if clock not in self._seconds:
            if clock not in self._stamps:
                self._columns({clock: []})
            stamps = self._stamps.pop(clock)
            if not self.start_ns:
                self.start_ns = int(stamps[0]) if stamps.size else 0
            stamps -= self.start_ns
            self._seconds[clock] = stamps * np.float64(1e-9)
        return self._seconds[clock]

    def place(self, row: int) -> str:
        """The message of row `row`."""
        return f"message {row}"

    def field(self, topic: str, path: str | None) -> Signal:
        """The signal of a topic's field.

        Raises
        ------
        InputError : no such topic, no message that can be read on it, or no such field.
        """
        there = {str(s.field): s for s in self.signals.values() if s.topic == topic}
        if topic not in self.topics:
            problem = f"no topic {topic}{did_you_mean(topic, self.topics)}"
            mend = f"the file has: {listed(self.topics) or 'none'}"
        elif topic in self.reasons:
            problem = f"topic {topic} {self.reasons[topic]}"
            mend = "record JSON, Protobuf or ROS messages, or export the log as CSV"
        elif path is None:
            return Signal(topic, topic, topic=topic)
        elif path in there:
            return there[path]
        elif not there:
            problem, mend = f"no message on topic {topic}", "record it, or map another topic"
        elif f"{path}[0]" in there:
            problem = f"topic {topic}, field {path!r}: a list is not a number"
            mend = f"name one of its elements, {path}[0] for the first"
        else:
            problem = f"topic {topic}: no field {path!r}{did_you_mean(path, there)}"
            mend = f"the messages have: {listed(there)}"
        raise InputError(problem, where=self.path, mend=mend)

    def _columns(self, wanted: dict[str, list[str]]) -> dict[str, Column]:
        """Columns of signals by topic; the topics' stamps are kept."""
        walk = ChunkWalk(self.path)
        decoders: dict[int, Decoder] = {}
        paths = {
            t: list(dict.fromkeys(p for n in names for p in self.paths[n])) for t, names in wanted.items()
        }
        parts = {t: _Rows(paths[t]) for t in wanted}
        rows = 0
        for batch in walk:
            channel = walk.channels[batch.channel]
            topic = channel.topic
            if topic not in wanted:
                continue
            rows += batch.stamps.size
            require_size(rows, sum(len(p) for p in paths.values()), self.path)
            values: list[Column] = []
            if paths[topic]:
                if batch.channel not in decoders:
                    decoders[batch.channel] = decoder_of(channel, walk.schemas.get(channel.schema_id))
                try:
                    values = decoders[batch.channel].columns(batch.payloads, paths[topic])
                except ValueError as error:
                    raise InputError(f"topic {topic}: {error}", where=self.path) from None
            parts[topic].append(batch.stamps, values)
        self.truncated, self.damaged = walk.truncated, walk.damaged
        out: dict[str, Column] = {}
        for topic, names in wanted.items():
            self._stamps[topic], by_path = parts.pop(topic).in_order()
            for name in names:
                whole, *nanoseconds = (by_path[p] for p in self.paths[name])
                out[name] = whole + nanoseconds[0] * 1e-9 if nanoseconds else whole
        return out


class _Rows:
    """Stamps and columns of a topic, which grow where they stand: a second copy would double the memory."""

    def __init__(self, paths: Collection[FieldPath]) -> None:
        self._size, self._stamps = 0, np.empty(0, np.int64)
        self._columns = {path: np.empty(0) for path in paths}

    def append(self, stamps: NDArray[np.int64], values: Iterable[Column]) -> None:
        """The next rows: (n,) ns and, of each path, (n,)."""
        end = self._size + stamps.size
        if end > self._stamps.size:
            room = max(end, 2 * self._stamps.size)
            self._stamps = self._grown(self._stamps, room)
            for path, column in self._columns.items():
                self._columns[path] = self._grown(column, room)
        self._stamps[self._size : end] = stamps
        for column, new in zip(self._columns.values(), values, strict=True):
            column[self._size : end] = new
        self._size = end

    def _grown(self, column: NDArray[Any], room: int) -> NDArray[Any]:
        out = np.empty(room, column.dtype)  # what is not filled takes no memory
        out[: self._size] = column[: self._size]
        return out

    def in_order(self) -> tuple[NDArray[np.int64], dict[FieldPath, Column]]:
        """Stamps and columns by path, in the order of the stamps."""
        stamps = self._stamps[: self._size]
        columns = {path: column[: self._size] for path, column in self._columns.items()}
        # The log time is the order of an MCAP file, whatever order the messages were written in.
        if (stamps[1:] < stamps[:-1]).any():
            order = np.argsort(stamps, kind="stable")
            return stamps[order], {path: column[order] for path, column in columns.items()}
        return stamps, columns


def open_mcap(path: Path) -> McapFile:
    """Topics and fields of an MCAP file, which may end early.

    The walk ends where all channels of the file's summary have shown a message.

    Raises
    ------
    InputError : no MCAP file.
    """
    known, metadata = _summary(path)
    log = McapFile(path)
    walk = ChunkWalk(path)
    seen: set[int] = set()
    for batch in walk:
        if batch.channel in seen:
            continue
        seen.add(batch.channel)
        _add_fields(log, walk, batch)
        if known and known <= seen:
            break
    log.truncated = walk.truncated
    log.topics = list(dict.fromkeys(c.topic for c in walk.channels.values()))
    log.metadata = {**walk.metadata, **metadata}
    if len(log.signals) > MAX_SIGNALS:
        raise InputError(f"{len(log.signals)} fields, at most {MAX_SIGNALS} are read", where=path)
    return log


def _add_fields(log: McapFile, walk: ChunkWalk, batch: Batch) -> None:
    channel = walk.channels[batch.channel]
    topic = channel.topic
    try:
        fields = decoder_of(channel, walk.schemas.get(channel.schema_id)).fields(batch.payloads)
    except ValueError as error:
        log.reasons.setdefault(topic, str(error))
        return
    offered: list[tuple[str, tuple[FieldPath, ...], str | None]] = []
    for path, unit in fields.items():
        *above, last = path
        offered.append((written(path), (path,), unit))
        for name in _NANOSECONDS.get(str(last), ()) if above else ():
            if (*above, name) in fields:
                offered.append((written(tuple(above)), (path, (*above, name)), "s"))
    for text, paths, unit in offered:
        name = f"{topic}.{text}"
        log.signals.setdefault(name, Signal(name, topic, unit, topic, text))
        log.paths.setdefault(name, paths)


def written(path: FieldPath) -> str:
    """A path as a channel map writes it.

    Examples
    --------
    >>> written(("joint", "position", 2)), written((0, "x"))
    ('joint.position[2]', '[0].x')
    """
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def _summary(path: Path) -> tuple[set[int], dict[str, dict[str, str]]]:
    """Channels that have messages, and metadata, by the summary; none where it is not whole."""
    from mcap.reader import SeekingReader

    known: set[int] = set()
    metadata: dict[str, dict[str, str]] = {}
    # A damaged or unfinished file, which provokes whatever, is walked instead.
    with suppress(Exception), path.open("rb") as stream:
        reader = SeekingReader(stream)
        summary = reader.get_summary()
        if summary is not None and summary.statistics is not None:
            messages = summary.statistics.channel_message_counts.items()
            known = {c for c, count in messages if count and c in summary.channels}
        if known:
            metadata = {m.name: dict(m.metadata) for m in reader.iter_metadata()}
    return known, metadata


AXIS_TOPIC = re.compile(r"^/eha/(?P<axis>[^/]+)/measurement$")
"""The contract's topic of measurements."""
