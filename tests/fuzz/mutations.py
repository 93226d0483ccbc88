"""Changes of bytes, of texts and of nested data, drawn from a seeded generator."""

from __future__ import annotations

import copy
import json
import math
import random
import re
from collections.abc import Iterator
from typing import Any

import yaml

VALUES = [-1, 0, 1e9, 1e300, math.nan, math.inf, "x", "", None, [], [1], {}, {"value": "x"}, True, 10**400]
EXTREMES = (0, -1, 1, 2**31 - 1, 2**63 - 1, -(2**31), 2**16, 2**24, 2**40, 255)
_WORDS = (
    b"-1", b"0", b"1e400", b"-1e308", b"nan", b"inf", b"x", b"", b" ", b"9" * 40, b"9" * 5000, b"1,5",
    b"\xc3", b"\x00", b"\xff", b'"', b"'", b";", b"\n", b"\r", b"\t", b"null", b"true", b"{", b"[", b"- ",
    b"&a", b"*a", b"!!int", b"<<: ", b"2026-13-45", b"99:99:99", "\u2028".encode(), "\U0001f600".encode(),
    b"\\ud800",
)  # fmt: skip


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value in nested lists and mappings."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def changed(data: Any, path: tuple[Any, ...], value: Any) -> Any:
    """A copy with one value replaced."""
    out = copy.deepcopy(data)
    inner = out
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = copy.deepcopy(value)
    return out


def torn(text: str, rng: random.Random) -> str:
    """A few bytes of a text changed, taken out, or a piece of it repeated elsewhere."""
    raw = bytearray(text.encode())
    for _ in range(rng.randint(1, 4)):
        if not raw:
            break
        start = rng.randrange(len(raw))
        kind, stop = rng.randrange(3), start + rng.randint(1, 40)
        if kind == 0:
            raw[start] = rng.choice(b"0-:{}[]&*!<'\"\n\t%@|> eE.\x00\xff")
        elif kind == 1:
            del raw[start:stop]
        else:
            raw[start:start] = raw[(at := rng.randrange(len(raw))) : at + stop - start]
    return raw.decode("utf-8", errors="replace")


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
        return torn(raw.decode("utf-8", "surrogateescape").encode("utf-8", "replace").decode(), rng).encode()
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
        everywhere = list(places(data))
        if not everywhere:
            break
        value = rng.choice([*VALUES, *EXTREMES, "\ud800", "1e400", "a" * 5000, [[1]] * 300])
        data = changed(data, rng.choice(everywhere), value)
    try:
        if suffix == ".json":
            return json.dumps(data).encode()
        return yaml.dump(data, Dumper=yaml.CSafeDumper).encode()
    except (ValueError, yaml.YAMLError):  # a figure or character that cannot be written
        return text_changed(raw, rng)
