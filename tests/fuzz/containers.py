"""Changes inside of packed formats, with checksums made right again: MCAP, zip (xlsx), gzip."""

from __future__ import annotations

import gzip
import io
import random
import struct
import zipfile
import zlib
from collections.abc import Callable

import lz4.frame
import zstandard

from tests.fuzz.mutations import EXTREMES, bytes_changed, text_changed

_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _END = 0x03, 0x04, 0x05, 0x06, 0x0F


def gzip_changed(raw: bytes, rng: random.Random) -> bytes:
    """The text inside changed, or the packed bytes."""
    if rng.random() < 0.5:
        return bytes_changed(raw, rng)
    return gzip.compress(text_changed(gzip.decompress(raw), rng), mtime=0)


def zip_changed(raw: bytes, rng: random.Random) -> bytes:
    """A member of the archive changed and packed again, or the bytes of the archive."""
    if rng.random() < 0.3:
        return bytes_changed(raw, rng)
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(raw)) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        names = old.namelist()
        sheets = [n for n in names if "sheet" in n.lower() or "shared" in n.lower()]
        chosen = rng.choice(sheets if sheets and rng.random() < 0.7 else names)
        for name in names:
            content = old.read(name)
            if name == chosen:
                content = text_changed(content, rng)
            new.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return out.getvalue()


Record = tuple[int, bytes]


def records_of(raw: bytes) -> list[Record]:
    """Opcode and body of each whole record."""
    found, at = [], 0
    while at + 9 <= len(raw):
        opcode, length = struct.unpack_from("<BQ", raw, at)
        if at + 9 + length > len(raw):
            break
        found.append((opcode, raw[at + 9 : at + 9 + length]))
        at += 9 + length
    return found


def bytes_of(records: list[Record]) -> bytes:
    """Records as a file or a chunk has them."""
    return b"".join(struct.pack("<BQ", opcode, len(body)) + body for opcode, body in records)


def mcap_changed(raw: bytes, rng: random.Random) -> bytes:
    """Records of the file or of a chunk changed; the chunk's sizes and checksum mostly fit again."""
    if rng.random() < 0.15:
        return bytes_changed(raw, rng)
    records = records_of(raw[len(_MAGIC) : -len(_MAGIC)])
    chunks = [k for k, (opcode, _) in enumerate(records) if opcode == _CHUNK]
    if chunks and rng.random() < 0.85:
        # Without the summary, whose schemas and channels would be taken before the chunk's.
        records = records[: next(k for k, (opcode, _) in enumerate(records) if opcode == _END)]
        at = rng.choice([chunks[0], *chunks])
        records[at] = (_CHUNK, _chunk_changed(records[at][1], rng))
        return _MAGIC + bytes_of(records)
    return _MAGIC + bytes_of(_records_changed(records, rng)) + _MAGIC


def _chunk_changed(body: bytes, rng: random.Random) -> bytes:
    start, end, size, _, named = struct.unpack_from("<QQQII", body)
    compression = body[32 : 32 + named].decode()
    inner = _CODECS[compression][0](body[40 + named :])
    if rng.random() < 0.15:
        inner = bytes_changed(inner, rng)
    else:
        inner = bytes_of(_records_changed(records_of(inner), rng))
    size, crc = len(inner), zlib.crc32(inner)
    compression = rng.choice(("", "zstd", "lz4", compression))
    packed = _CODECS[compression][1](inner)
    if rng.random() < 0.1:
        size = rng.choice(EXTREMES) & 2**64 - 1
    if rng.random() < 0.05:
        packed = bytes_changed(packed, rng)
    head = struct.pack("<QQQII", start, end, size, crc, len(compression)) + compression.encode()
    return head + struct.pack("<Q", len(packed)) + packed


_CODECS: dict[str, tuple[Callable[[bytes], bytes], Callable[[bytes], bytes]]] = {
    "": (bytes, bytes),
    "zstd": (zstandard.decompress, zstandard.compress),
    "lz4": (lz4.frame.decompress, lz4.frame.compress),
}


def _records_changed(records: list[Record], rng: random.Random) -> list[Record]:
    out = list(records)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not out:
            break
        # Schemas and channels are few, and most is decided by them.
        definitions = [k for k, (opcode, _) in enumerate(out) if opcode in (_SCHEMA, _CHANNEL)]
        at = rng.choice(definitions) if definitions and rng.random() < 0.4 else rng.randrange(len(out))
        opcode, body = out[at]
        kind = rng.randrange(10)
        if kind == 0:
            del out[at]
        elif kind == 1:
            out.insert(rng.randrange(len(out)), out[at])
        elif kind == 2:
            out[at] = (rng.randrange(16), body)
        elif opcode == _MESSAGE and len(body) > 22 and kind < 9:
            out[at] = (opcode, body[:22] + _payload_changed(body[22:], rng))
        elif opcode == _SCHEMA and kind < 9:
            out[at] = (opcode, _schema_changed(body, rng))
        else:
            out[at] = (opcode, bytes_changed(body, rng))
    return out


def _payload_changed(payload: bytes, rng: random.Random) -> bytes:
    if not payload:
        return bytes_changed(b"\0", rng)
    return text_changed(payload, rng) if payload[:1] == b"{" else bytes_changed(payload, rng)


def _schema_changed(body: bytes, rng: random.Random) -> bytes:
    """The text of the schema changed, its length right again."""
    try:
        (name,) = struct.unpack_from("<I", body, 2)
        (encoding,) = struct.unpack_from("<I", body, 6 + name)
    except struct.error:  # changed before
        return bytes_changed(body, rng)
    head = body[: 10 + name + encoding]
    data = body[len(head) + 4 :]
    change = bytes_changed if b"protobuf" in head or not data else text_changed
    data = change(data, rng)
    return head + struct.pack("<I", len(data)) + data
