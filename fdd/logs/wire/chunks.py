"""MCAP files as batches of messages: the library reads the records of the file, not those in its chunks.

It would make an object of each message, which takes several times as long.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from struct import Struct
from struct import error as StructError
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_CHUNK_BYTES, MAX_RECORD_BYTES
from fdd.errors import InputError

_SCHEMA, _CHANNEL, _MESSAGE = 0x03, 0x04, 0x05
_FRAME, _HEAD = Struct("<BQ"), Struct("<HIQQ")
"""Of a record: opcode and length; of a message: channel, sequence, log time and publish time."""


class Batch(NamedTuple):
    """Messages of one channel: (n,) ns, and their bytes."""

    channel: int
    stamps: NDArray[np.int64]
    payloads: list[bytes]


def _found() -> defaultdict[int, tuple[list[int], list[bytes]]]:
    """Stamps and bytes by channel."""
    return defaultdict(lambda: ([], []))


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
        from mcap.opcode import Opcode
        from mcap.records import Channel, Chunk, Message, Metadata, Schema
        from mcap.stream_reader import StreamReader

        class Reader(StreamReader):
            """Passes over message indexes, which the library would unpack number by number."""

            def _read_record(self, opcode: int, length: int) -> Any:
                return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)

        # Besides the library's own whatever a damaged record provokes, as text that is none.
        provoked = (McapError, ValueError, LookupError, ArithmeticError, MemoryError, StructError)
        loose = _found()
        with self.path.open("rb") as stream:
            records = Reader(stream, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES).records
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
                    stamps, payloads = loose[record.channel_id]
                    stamps.append(record.log_time)
                    payloads.append(record.data)
                elif isinstance(record, Chunk):
                    yield from self._batches(self._chunk(record))
        yield from self._batches(loose)

    def _batches(self, found: Mapping[int, tuple[list[int], list[bytes]]]) -> Iterator[Batch]:
        for channel, (stamps, payloads) in sorted(found.items()):
            if channel in self.channels:  # else a damaged number; there may be thousands
                yield Batch(channel, np.array(stamps, dtype=np.uint64).astype(np.int64), payloads)

    def _chunk(self, chunk: Any) -> Mapping[int, tuple[list[int], list[bytes]]]:
        """Messages of a chunk; none where it is damaged."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Channel, Schema

        size, crc = int(chunk.uncompressed_size), chunk.uncompressed_crc
        if size > MAX_CHUNK_BYTES:
            raise InputError(f"a chunk of {size} bytes, at most {MAX_CHUNK_BYTES} are read", where=self.path)
        found = _found()
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
                known: dict[int, Any] = self.schemas if opcode == _SCHEMA else self.channels
                kind: Any = Schema if opcode == _SCHEMA else Channel
                try:
                    record = kind.read(ReadDataStream(BytesIO(raw[begin:at])))
                except Exception:  # the library lets struct's and the codec's errors through
                    self.damaged += 1
                    return _found()
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
    raise InputError(
        f"chunks compressed with {chunk.compression[:20]!r}", mend="record with zstd, lz4 or none"
    )
