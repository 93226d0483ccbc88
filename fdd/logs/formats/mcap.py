"""MCAP: topics of JSON, Protobuf or ROS messages, each field of a message a signal.

The library reads the records of the file, but not the messages in its chunks: it would make an object of
each, which takes several times as long.
"""

from __future__ import annotations

import re
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_CHUNK_BYTES, MAX_RECORD_BYTES, MAX_SIGNALS
from fdd.errors import InputError, did_you_mean, listed
from fdd.logs.formats import LogFile, Signal, require_size
from fdd.logs.formats.messages import Decoder, FieldPath, decoder_of
from fdd.samples import Column

AXIS_TOPIC = re.compile(r"^/eha/(?P<axis>[^/]+)/measurement$")
"""The contract's topic of measurements."""
_NANOSECONDS = {"sec": ("nanosec", "nsec"), "seconds": ("nanos", "nanoseconds"), "secs": ("nsecs",)}
_SCHEMA, _CHANNEL, _MESSAGE = 0x03, 0x04, 0x05
_FRAME, _HEAD = Struct("<BQ"), Struct("<HIQQ")
"""Of a record: opcode and length; of a message: channel, sequence, log time and publish time."""
_Found = dict[int, tuple[list[int], list[bytes]]]
"""Stamps and bytes of messages by channel."""


def _none_found() -> _Found:
    return defaultdict(lambda: ([], []))


@dataclass
class ChunkWalk:
    """Messages of a file in the order in which they were written; schemas and channels fill up on the way.

    Each step gives the number of a channel, (n,) ns, and n messages. `schemas`, `channels`: the library's
    records, by number. `metadata`: record name to key-value pairs. After the walk, `truncated`: whether the
    file ends before its data does; `damaged`: chunks that were left out (checksum or compression is wrong).

    Raises InputError: no MCAP file, or more than is read.
    """

    path: Path
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False
    damaged: int = 0

    def __iter__(self) -> Iterator[tuple[int, NDArray[np.int64], list[bytes]]]:
        from mcap.exceptions import McapError, RecordLengthLimitExceeded
        from mcap.opcode import Opcode
        from mcap.records import Channel, Chunk, Message, Metadata, Schema
        from mcap.stream_reader import StreamReader

        class Reader(StreamReader):
            """Passes over message indexes, which the library would unpack number by number."""

            def _read_record(self, opcode: int, length: int) -> Any:
                return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)

        # Besides the library's own whatever a damaged record provokes, as text that is none.
        provoked = (McapError, ValueError, LookupError, ArithmeticError, MemoryError, StructError)
        loose = _none_found()
        with self.path.open("rb") as stream:
            records = Reader(stream, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records
            while True:
                try:
                    record = next(records, None)
                except RecordLengthLimitExceeded as error:
                    raise InputError(f"a damaged or too large record ({error})", where=self.path) from None
                except provoked:
                    self.truncated = True
                    break
                if record is None:
                    break
                if isinstance(record, Schema):
                    self.schemas[record.id] = record
                elif isinstance(record, Channel):
                    self.channels[record.id] = record
                elif isinstance(record, Metadata):
                    self.metadata[record.name] = dict(record.metadata)
                elif isinstance(record, Message):
                    stamps, payloads = loose[record.channel_id]
                    stamps.append(record.log_time)
                    payloads.append(record.data)
                elif isinstance(record, Chunk):
                    yield from self._batches(self._chunk(record))
        yield from self._batches(loose)

    def _batches(self, found: _Found) -> Iterator[tuple[int, NDArray[np.int64], list[bytes]]]:
        for channel, (stamps, payloads) in sorted(found.items()):
            if channel in self.channels:  # else a damaged number; there may be thousands
                yield channel, np.array(stamps, dtype=np.uint64).astype(np.int64), payloads

    def _chunk(self, chunk: Any) -> _Found:
        """Messages of a chunk; none where it is damaged."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        size, crc = int(chunk.uncompressed_size), chunk.uncompressed_crc
        if size > MAX_CHUNK_BYTES:
            raise InputError(f"a chunk of {size} bytes, at most {MAX_CHUNK_BYTES} are read", where=self.path)
        found = _none_found()
        raw = _inflated(chunk, size)
        if raw is None or len(raw) != size or (crc and zlib.crc32(raw) != crc):
            self.damaged += 1
            return found
        at = 0
        while at + _FRAME.size <= size:
            opcode, length = _FRAME.unpack_from(raw, at)
            begin = at + _FRAME.size
            at = begin + length
            if at > size or opcode == 0:  # no record: zeros would go on for long
                break
            if opcode == _MESSAGE and length >= _HEAD.size:
                channel, _, stamp, _ = _HEAD.unpack_from(raw, begin)
                stamps, payloads = found[channel]
                stamps.append(stamp)
                payloads.append(raw[begin + _HEAD.size : at])
            elif opcode in (_SCHEMA, _CHANNEL):
                known, kind = (self.schemas, Schema) if opcode == _SCHEMA else (self.channels, Channel)
                try:
                    record: Any = kind.read(ReadDataStream(BytesIO(raw[begin:at])))
                except Exception:  # the library lets struct's and the codec's errors through
                    self.damaged += 1
                    return {}
                known[record.id] = record
        return found


def _inflated(chunk: Any, size: int) -> bytes | None:
    """The chunk's bytes, never more than `size`; None where they are damaged."""
    if chunk.compression == "":
        return bytes(chunk.data)
    try:
        if chunk.compression == "zstd":
            import zstandard

            reader = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(chunk.data)
            # In pieces: each call makes room for what it is asked for, however little comes.
            parts, left = [], size
            while left > 0 and (part := reader.read(min(left, 16 << 20))):
                parts.append(part)
                left -= len(part)
            return b"".join(parts)
        if chunk.compression == "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size))
    except Exception:  # zstandard.ZstdError, or lz4's RuntimeError and EOFError
        return None
    problem = f"chunks compressed with {chunk.compression[:20]!r}"
    raise InputError(problem, mend="record with zstd, lz4 or none")


@dataclass
class McapFile(LogFile):
    """An MCAP file whose topics, with messages or without, and fields are known.

    `paths`: signal to its field's path, or to those of the seconds and nanoseconds of a stamp.
    `reasons`: topic to why its messages cannot be read.
    """

    topics: list[str] = field(default_factory=list)
    paths: dict[str, tuple[FieldPath, ...]] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    _stamps: dict[str, NDArray[Any]] = field(default_factory=dict)

    def read(self, names: Iterable[str]) -> dict[str, Column]:
        wanted: dict[str, list[str]] = {}
        for name in dict.fromkeys(names):
            wanted.setdefault(str(self.signals[name].topic), []).append(name)
        return self._columns(wanted)

    def stamps(self, clock: str) -> Column | None:
        """(n,) s since the first message of the file's topics that were read."""
        if clock not in self._stamps:
            self._columns({clock: []})
        stamps = self._stamps[clock]
        if stamps.dtype == np.int64:  # ns since 1970: as s where they stand, as a copy would take memory
            self.start_ns = self.start_ns or int(stamps[:1].sum())
            stamps -= self.start_ns
            stamps = self._stamps[clock] = stamps * np.float64(1e-9)
        return stamps

    def place(self, row: int) -> str:
        return f"message {row}"

    def field(self, topic: str, path: str | None) -> Signal:
        """The signal of a topic's field. Raises InputError: no such topic or field, no readable message."""
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
        paths = {t: list(dict.fromkeys(p for n in ns for p in self.paths[n])) for t, ns in wanted.items()}
        parts, rows = {t: _Rows(len(paths[t])) for t in wanted}, 0
        for number, stamps, payloads in walk:
            channel = walk.channels[number]
            if (topic := channel.topic) not in wanted:
                continue
            rows += stamps.size
            require_size(rows, sum(len(p) for p in paths.values()), self.path)
            values: list[Column] = []
            if paths[topic]:
                try:
                    if number not in decoders:
                        decoders[number] = decoder_of(channel, walk.schemas.get(channel.schema_id))
                    values = decoders[number].columns(payloads, paths[topic])
                except ValueError as error:
                    raise InputError(f"topic {topic}: {error}", where=self.path) from None
            parts[topic].append(stamps, *values)
        self.truncated = walk.truncated
        told = f"{walk.damaged} damaged chunks were left out (checksum or compression is wrong)"
        self.notes = [told] if walk.damaged else []
        out: dict[str, Column] = {}
        for topic, names in wanted.items():
            self._stamps[topic], *columns = parts.pop(topic).in_order()
            by_path = dict(zip(paths[topic], columns, strict=True))
            for name in names:
                whole, *nanoseconds = (by_path[p] for p in self.paths[name])
                out[name] = whole + nanoseconds[0] * 1e-9 if nanoseconds else whole
        return out


class _Rows:
    """Stamps and columns of a topic, which grow where they stand: a second copy would double the memory."""

    def __init__(self, columns: int) -> None:
        self._size = 0
        self._columns: list[NDArray[Any]] = [np.empty(0, np.int64), *(np.empty(0) for _ in range(columns))]

    def append(self, *new: NDArray[Any]) -> None:
        """The next rows: (n,) ns and, of each column, (n,)."""
        end, room = self._size + new[0].size, self._columns[0].size
        for k, column in enumerate(self._columns if end > room else ()):
            grown = np.empty(max(end, 2 * room), column.dtype)  # what is not filled takes no memory
            grown[: self._size] = column[: self._size]
            self._columns[k] = grown
        for column, values in zip(self._columns, new, strict=True):
            column[self._size : end] = values
        self._size = end

    def in_order(self) -> list[NDArray[Any]]:
        """Stamps and columns in the order of the stamps, whatever order the messages were written in."""
        rows = [column[: self._size] for column in self._columns]
        if (rows[0][1:] < rows[0][:-1]).any():
            order = np.argsort(rows[0], kind="stable")
            return [column[order] for column in rows]
        return rows


def open_mcap(path: Path) -> McapFile:
    """Topics and fields of an MCAP file, which may end early; the walk ends where all channels of the file's
    summary have shown a message. Raises InputError: no MCAP file."""
    from mcap.reader import SeekingReader

    log, walk = McapFile(path), ChunkWalk(path)
    known: set[int] = set()
    metadata: dict[str, dict[str, str]] = {}
    # A damaged or unfinished file, which provokes whatever, is walked to its end.
    with suppress(Exception), path.open("rb") as stream:
        reader = SeekingReader(stream)
        summary = reader.get_summary()
        if summary is not None and summary.statistics is not None:
            messages = summary.statistics.channel_message_counts.items()
            known = {c for c, count in messages if count and c in summary.channels}
        if known:
            metadata = {m.name: dict(m.metadata) for m in reader.iter_metadata()}
    seen: set[int] = set()
    for number, _, payloads in walk:
        if number in seen:
            continue
        seen.add(number)
        channel = walk.channels[number]
        try:
            fields = decoder_of(channel, walk.schemas.get(channel.schema_id)).fields(payloads)
        except ValueError as error:
            log.reasons.setdefault(channel.topic, str(error))
            fields = {}
        for at, paths, unit in _offered(fields):
            name = f"{channel.topic}.{at}"
            log.signals.setdefault(name, Signal(name, channel.topic, unit, channel.topic, at))
            log.paths.setdefault(name, paths)
        if known and known <= seen:
            break
    log.truncated = walk.truncated
    log.topics = list(dict.fromkeys(c.topic for c in walk.channels.values()))
    log.metadata = {**walk.metadata, **metadata}
    if len(log.signals) > MAX_SIGNALS:
        raise InputError(f"{len(log.signals)} fields, at most {MAX_SIGNALS} are read", where=path)
    return log


def _offered(
    fields: Mapping[FieldPath, str | None],
) -> Iterator[tuple[str, tuple[FieldPath, ...], str | None]]:
    """Fields, and stamps of two of them: as a map writes them, the paths of their numbers, their units."""
    for path, unit in fields.items():
        yield written(path), (path,), unit
        *above, last = path
        for name in _NANOSECONDS.get(str(last), ()) if above else ():
            if (*above, name) in fields:
                yield written(above), (path, (*above, name)), "s"


def written(path: Sequence[str | int]) -> str:
    """A path as a channel map writes it."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text
