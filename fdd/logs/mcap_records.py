"""MCAP framing: channels, metadata and messages of a file, finished or not.

The library's own readers cannot open a file whose end is missing, and build an
object for each message. This walks the records in the order they were written,
hands messages over by the chunk, and recovers what an unfinished last chunk
still holds. The layout is that of the MCAP specification, version 0.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from fdd.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
MAX_CHUNK_BYTES = 1 << 30
MAX_METADATA_BYTES = 64 << 20
_CHANNEL, _MESSAGE, _CHUNK, _METADATA, _DATA_END = 0x04, 0x05, 0x06, 0x0C, 0x0F
_FRAME = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")


@dataclass(frozen=True)
class Topic:
    """A channel record: its number in the file, topic and message encoding."""

    number: int
    name: str
    encoding: str


@dataclass
class Batch:
    """Messages of one chunk, by channel number: log times (ns) and payloads."""

    log_times: dict[int, list[int]] = field(default_factory=dict)
    payloads: dict[int, list[bytes]] = field(default_factory=dict)

    def add(self, channel: int, log_time: int, payload: bytes) -> None:
        """Append one message."""
        self.log_times.setdefault(channel, []).append(log_time)
        self.payloads.setdefault(channel, []).append(payload)


@dataclass
class Metadata:
    """A metadata record."""

    name: str
    values: dict[str, str]


class RecordWalk:
    """Iterate over a file's topics, metadata and message batches.

    Attributes
    ----------
    truncated : after the walk, whether the file ends before its data does.
    damaged : chunks whose checksum or compression is wrong; they are left out.

    Raises
    ------
    InputError : no MCAP file, or a chunk beyond `MAX_CHUNK_BYTES`.

    Examples
    --------
    >>> walk = RecordWalk(path)  # doctest: +SKIP
    >>> topics = [r for r in walk if isinstance(r, Topic)]  # doctest: +SKIP
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truncated = False
        self.damaged = 0
        self._size = path.stat().st_size

    def __iter__(self) -> Iterator[Topic | Metadata | Batch]:
        with self.path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError(
                    "not an MCAP file (wrong first bytes)", where=self.path, mend="record or copy it again"
                )
            loose = Batch()
            while True:
                frame = stream.read(_FRAME.size)
                if len(frame) < _FRAME.size:
                    self.truncated = True
                    break
                opcode, length = _FRAME.unpack(frame)
                if opcode == _DATA_END:
                    break
                whole = length <= self._size - stream.tell()
                if opcode == _CHUNK:
                    yield from self._chunk(stream, length, whole)
                elif not whole:
                    self.truncated = True
                    break
                elif opcode == _MESSAGE:
                    _take_message(loose, stream.read(self._bounded(length, MAX_CHUNK_BYTES)))
                elif opcode == _CHANNEL:
                    yield self._topic(stream.read(self._bounded(length, MAX_METADATA_BYTES)))
                elif opcode == _METADATA:
                    yield self._metadata(stream.read(self._bounded(length, MAX_METADATA_BYTES)))
                else:
                    stream.seek(length, 1)
                if not whole:
                    self.truncated = True
                    break
            if loose.payloads:
                yield loose
            if not self.truncated:
                stream.seek(-len(MAGIC), 2)
                self.truncated = stream.read() != MAGIC

    def _bounded(self, length: int, limit: int) -> int:
        if length > limit:
            raise InputError(f"a record of {length} bytes, at most {limit} are read", where=self.path)
        return length

    def _chunk(self, stream: IO[bytes], length: int, whole: bool) -> Iterator[Topic | Batch]:
        # Never ask for more than the file has: a damaged length must not take all the memory.
        raw = stream.read(min(self._bounded(length, MAX_CHUNK_BYTES), self._size - stream.tell()))
        if len(raw) < _CHUNK_HEAD.size:
            self.damaged += whole
            return
        _start, _end, size, checksum, name_length = _CHUNK_HEAD.unpack_from(raw)
        body = _CHUNK_HEAD.size + name_length + 8
        if len(raw) < body:
            self.damaged += whole
            return
        compression = raw[_CHUNK_HEAD.size : body - 8].decode("ascii", errors="replace")
        data = self._inflated(raw[body:], compression, self._bounded(size, MAX_CHUNK_BYTES))
        if whole and (len(data) != size or (checksum and zlib.crc32(data) != checksum)):
            self.damaged += 1
            return
        batch = Batch()
        at, end = 0, len(data)
        while at + _FRAME.size <= end:
            opcode, inner = _FRAME.unpack_from(data, at)
            at += _FRAME.size
            if inner > end - at:
                break
            if opcode == _MESSAGE:
                _take_message(batch, data[at : at + inner])
            elif opcode == _CHANNEL:
                yield self._topic(data[at : at + inner])
            at += inner
        yield batch

    def _inflated(self, body: bytes, compression: str, size: int) -> bytes:
        """At most `size` bytes, and what there is of them where `body` is cut or damaged."""
        if compression == "":
            return body[:size]
        if compression == "zstd":
            import zstandard

            return _piecewise(zstandard.ZstdDecompressor(max_window_size=1 << 27).decompressobj(), body, size)
        if compression == "lz4":
            import lz4.frame  # type: ignore[import-untyped]

            return _piecewise(lz4.frame.LZ4FrameDecompressor(), body, size)
        raise InputError(
            f"chunks compressed with {compression[:20]!r}",
            where=self.path,
            mend="record with zstd, lz4 or none",
        )

    def _topic(self, raw: bytes) -> Topic:
        try:
            number, _schema = struct.unpack_from("<HH", raw)
            name, at = _text(raw, 4)
            encoding, _ = _text(raw, at)
        except (struct.error, UnicodeDecodeError):
            raise InputError("damaged channel record", where=self.path, mend="copy the file again") from None
        return Topic(number, name, encoding)

    def _metadata(self, raw: bytes) -> Metadata:
        values: dict[str, str] = {}
        try:
            name, at = _text(raw, 0)
            (length,) = struct.unpack_from("<I", raw, at)
            at += 4
            end = min(at + length, len(raw))
            while at < end:
                key, at = _text(raw, at)
                values[key], at = _text(raw, at)
        except (struct.error, UnicodeDecodeError):
            raise InputError("damaged metadata record", where=self.path, mend="copy the file again") from None
        return Metadata(name, values)


def _take_message(batch: Batch, raw: bytes) -> None:
    if len(raw) >= _MESSAGE_HEAD.size:
        channel, _sequence, log_time, _publish = _MESSAGE_HEAD.unpack_from(raw)
        batch.add(channel, log_time, raw[_MESSAGE_HEAD.size :])


def _text(raw: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", raw, at)
    end = at + 4 + length
    if end > len(raw):
        raise struct.error("text runs over the record")
    return raw[at + 4 : end].decode("utf-8"), end


def _piecewise(decompressor: object, body: bytes, size: int) -> bytes:
    """Decompress in small pieces, so that a bomb is cut off and a torn end loses one piece only."""
    out = bytearray()
    piece = 16_384
    for at in range(0, len(body), piece):
        try:
            out += decompressor.decompress(body[at : at + piece])  # type: ignore[attr-defined]
        except Exception:
            # zstandard.ZstdError, or lz4's RuntimeError and EOFError: the rest is not readable.
            break
        if len(out) >= size or getattr(decompressor, "eof", False):
            break
    return bytes(out[:size])
