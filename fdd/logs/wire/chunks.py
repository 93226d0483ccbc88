"""MCAP files as batches of messages: the library reads the records, a chunk is taken apart at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from struct import error as StructError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_CHUNK_BYTES, MAX_RECORD_BYTES
from fdd.errors import InputError
from fdd.logs.wire.compiled import njit

_SCHEMA, _CHANNEL, _MESSAGE = 0x03, 0x04, 0x05
_FRAME_BYTES = 9
_HEAD = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")])


@dataclass(frozen=True)
class Batch:
    """Messages of one channel: (n,) ns, and where each stands in `data`."""

    channel: int
    stamps: NDArray[np.int64]
    data: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]

    def payloads(self, most: int | None = None) -> list[bytes]:
        """The messages' bytes."""
        whole = self.data.tobytes()
        pairs = zip(self.starts[:most].tolist(), self.ends[:most].tolist(), strict=True)
        return [whole[a:b] for a, b in pairs]


@dataclass
class ChunkWalk:
    """Batches of a file in the order in which they were written; schemas and channels fill up on the way.

    Attributes
    ----------
    schemas, channels : the library's records, by number.
    metadata : record name to key-value pairs.
    truncated : after the walk, whether the file ends before its data does.
    damaged : chunks whose checksum or compression is wrong; they are left out.

    Raises
    ------
    InputError : no MCAP file, or more than is read.
    """

    path: Path
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    truncated: bool = False
    damaged: int = 0

    def __iter__(self) -> Iterator[Batch]:
        from mcap.exceptions import InvalidMagic, McapError, RecordLengthLimitExceeded
        from mcap.records import Channel, Chunk, Message, Metadata, Schema

        # Besides the library's own whatever a damaged record provokes, as text that is none.
        provoked = (McapError, ValueError, LookupError, ArithmeticError, MemoryError, StructError)
        loose: list[Any] = []
        with self.path.open("rb") as stream:
            records = _reader()(stream, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records
            first = True
            while True:
                try:
                    record = next(records, None)
                except RecordLengthLimitExceeded as error:
                    raise InputError(f"a damaged or too large record ({error})", where=self.path) from None
                except provoked as error:
                    if first and isinstance(error, InvalidMagic):
                        problem, mend = "not an MCAP file (wrong first bytes)", "record or copy it again"
                        raise InputError(problem, where=self.path, mend=mend) from None
                    self.truncated = True
                    break
                first = False
                if record is None:
                    break
                if isinstance(record, Schema):
                    self.schemas[record.id] = record
                elif isinstance(record, Channel):
                    self.channels[record.id] = record
                elif isinstance(record, Metadata):
                    self.metadata[record.name] = dict(record.metadata)
                elif isinstance(record, Message):
                    loose.append(record)
                elif isinstance(record, Chunk):
                    yield from self._chunk(record)
        yield from _loose(loose)

    def _chunk(self, chunk: Any) -> Iterator[Batch]:
        import zlib

        size = int(chunk.uncompressed_size)
        if size > MAX_CHUNK_BYTES:
            raise InputError(f"a chunk of {size} bytes, at most {MAX_CHUNK_BYTES} are read", where=self.path)
        raw = _inflated(chunk, size)
        crc = chunk.uncompressed_crc
        if raw is None or len(raw) != size or (crc and zlib.crc32(raw) != crc):
            self.damaged += 1
            return
        data = np.frombuffer(raw, dtype=np.uint8)
        opcodes, starts, lengths = _records(data)
        try:
            for k in np.flatnonzero((opcodes == _SCHEMA) | (opcodes == _CHANNEL)).tolist():
                self._define(opcodes[k], raw[starts[k] : starts[k] + lengths[k]])
        except Exception:  # the library lets struct's and the codec's errors through
            self.damaged += 1
            return
        told = (opcodes == _MESSAGE) & (lengths >= _HEAD.itemsize)
        starts, lengths = starts[told], lengths[told]
        heads = np.ascontiguousarray(data[starts[:, None] + np.arange(_HEAD.itemsize)]).view(_HEAD)[:, 0]
        stamps = heads["log_time"].astype(np.int64)
        for channel in np.unique(heads["channel"]).tolist():
            if channel not in self.channels:  # a damaged number; there may be thousands
                continue
            mine = heads["channel"] == channel
            begins = starts[mine] + _HEAD.itemsize
            yield Batch(channel, stamps[mine], data, begins, starts[mine] + lengths[mine])

    def _define(self, opcode: int, record: bytes) -> None:
        from io import BytesIO

        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        stream = ReadDataStream(BytesIO(record))
        if opcode == _SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        else:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel


@cache
def _reader() -> Any:
    """The library's reader, which passes over message indexes: it would unpack them number by number."""
    from mcap.opcode import Opcode
    from mcap.stream_reader import StreamReader

    class Reader(StreamReader):
        def _read_record(self, opcode: int, length: int) -> Any:
            return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)

    return Reader


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
    raise InputError(
        f"chunks compressed with {chunk.compression[:20]!r}", mend="record with zstd, lz4 or none"
    )


def _loose(messages: list[Any]) -> Iterator[Batch]:
    """Messages that stand in no chunk."""
    by_channel: dict[int, list[Any]] = {}
    for message in messages:
        by_channel.setdefault(message.channel_id, []).append(message)
    for channel, mine in by_channel.items():
        lengths = np.array([len(m.data) for m in mine], dtype=np.int64)
        ends = np.cumsum(lengths)
        stamps = np.array([m.log_time for m in mine], dtype=np.uint64).astype(np.int64)
        data = np.frombuffer(b"".join(m.data for m in mine), dtype=np.uint8)
        yield Batch(channel, stamps, data, ends - lengths, ends)


@njit()
def _records(data):  # type: ignore[no-untyped-def]
    """Opcode, first byte and length of each record in a chunk; one that runs over its end is left out."""
    count = 0
    for counting in (True, False):
        if not counting:
            opcodes = np.empty(count, np.uint8)
            starts, lengths = np.empty(count, np.int64), np.empty(count, np.int64)
        k, at = 0, np.int64(0)
        while at + _FRAME_BYTES <= data.size:
            length = np.uint64(0)
            for b in range(8):
                length |= np.uint64(data[at + 1 + b]) << np.uint64(8 * b)
            if length > np.uint64(data.size - at - _FRAME_BYTES):
                break
            if not counting:
                opcodes[k], starts[k], lengths[k] = data[at], at + _FRAME_BYTES, np.int64(length)
            k += 1
            at += _FRAME_BYTES + np.int64(length)
        count = k
    return opcodes, starts, lengths
