"""Changes of bytes, texts and nested data, drawn from a seeded generator, also inside of packed formats."""

import copy
import gzip
import io
import json
import math
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from typing import Any

import lz4.frame
import yaml
import zstandard

VALUES = [-1, 0, 1e9, 1e300, math.nan, math.inf, "x", "", None, [], [1], {}, {"value": "x"}, True, 10**400]
EXTREMES = (0, -1, 1, 2**31 - 1, 2**63 - 1, -(2**31), 2**16, 2**24, 2**40, 255)
_WORDS = (
    b"-1", b"0", b"1e400", b"-1e308", b"nan", b"inf", b"x", b"", b" ", b"9" * 40, b"9" * 5000, b"1,5",
    b"\xc3", b"\x00", b"\xff", b'"', b"'", b";", b"\n", b"\r", b"\t", b"null", b"true", b"{", b"[", b"- ",
    b"&a", b"*a", b"!!int", b"<<: ", b"2026-13-45", b"99:99:99", "\u2028".encode(), "\U0001f600".encode(),
    b"\\ud800",
)  # fmt: skip
_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _END = 0x03, 0x04, 0x05, 0x06, 0x0F


def bytes_changed(raw: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, blocks cut, doubled or swapped, integers set to extremes; heads and ends most often."""
    out = bytearray(raw)
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        if not out:
            return b""
        at = _position(len(out), rng)
        length = min(rng.choice((1, 2, 4, 8, 16, 64, 512)), len(out) - at)
        other = rng.randrange(len(out))
        kind = rng.randrange(8)
        if kind == 0:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            out[at] = rng.randrange(256)
        elif kind == 2:
            del out[at : at + length]
        elif kind == 3:
            out[other:other] = out[at : at + length]
        elif kind == 4:
            here, there = out[at : at + length], out[other : other + length]
            out[at : at + length], out[other : other + length] = there, here
        elif kind == 5 and rng.random() < 0.3:
            del out[at:]
        else:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice(EXTREMES) & (1 << 8 * size) - 1
            out[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))
    return bytes(out)


def _position(size: int, rng: random.Random) -> int:
    reach = min(size, rng.choice((64, 512, size, size)))
    at = rng.randrange(reach)
    return size - 1 - at if rng.random() < 0.3 else at


def text_changed(raw: bytes, rng: random.Random) -> bytes:
    """Cells and words replaced, lines cut, doubled and swapped, brackets nested."""
    kind = rng.randrange(6)
    if kind == 0:
        return bytes_changed(raw, rng)
    if kind == 1:
        at = rng.randrange(len(raw))
        return raw[:at] + rng.choice(_WORDS) + raw[at + rng.choice((0, 1, 20)) :]
    if kind in (2, 3):
        found = list(re.finditer(rb"[\w.+-]+", raw))
        chosen = rng.sample(found, min(rng.choice((1, 1, 3)), len(found)))
        for one in sorted(chosen, key=lambda m: -m.start()):
            raw = raw[: one.start()] + rng.choice(_WORDS) + raw[one.end() :]
        return raw
    if kind == 4:
        lines = raw.splitlines(keepends=True)
        a, b = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[a:b] = rng.choice(([], lines[a:b] * 2, lines[b:a]))
        return b"".join(lines)
    at, deep = rng.randrange(len(raw)), rng.choice((3, 40, 3000))
    opening, closing = rng.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"- ", b""), (b"(", b")"), (b'"', b'"')))
    return raw[:at] + opening * deep + b"1" + closing * deep + raw[at:]


def places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Container and key of every value in nested lists and mappings."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield data, key
        if isinstance(value, dict | list):
            yield from places(value)


def data_changed(raw: bytes, rng: random.Random, suffix: str) -> bytes:
    """A YAML, JSON or JSON lines text with values replaced, or changed as text."""
    if rng.random() < 0.4:
        return text_changed(raw, rng)
    if suffix == ".jsonl":
        lines = raw.splitlines()
        at = rng.randrange(len(lines))
        lines[at] = data_changed(lines[at], rng, ".json").replace(b"\n", b" ")
        return b"\n".join(lines)
    data = json.loads(raw) if suffix == ".json" else yaml.load(raw, yaml.CSafeLoader)
    for _ in range(rng.choice((1, 1, 2))):
        if everywhere := list(places(data)):
            inner, key = rng.choice(everywhere)
            value = rng.choice([*VALUES, *EXTREMES, "\ud800", "1e400", "a" * 5000, [[1]] * 300])
            inner[key] = copy.deepcopy(value)
    try:
        if suffix == ".json":
            return json.dumps(data).encode()
        return yaml.dump(data, Dumper=yaml.CSafeDumper).encode()
    except (ValueError, yaml.YAMLError):  # a figure or character that cannot be written
        return text_changed(raw, rng)


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
