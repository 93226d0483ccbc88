"""ROS messages: ROS 2's CDR, and ROS 1, which is the same without alignment.

Of the libraries none reads both. Layout: OMG DDSI-RTPS 2.5, chapter 10 (plain CDR, both byte orders).
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fdd.bounds import DEEPEST_MESSAGE, MOST_ELEMENTS, MOST_OPERATIONS

_PRIMITIVES = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
_ALONE, _COUNTED = -1, 0
"""In place of an array's length: no array, and one with its length before it."""
_BUILT_IN = {
    name: [("sec", first, _ALONE), (rest, second, _ALONE)]
    for name, first, rest, second in (
        ("builtin_interfaces/Time", "int32", "nanosec", "uint32"),
        ("builtin_interfaces/Duration", "int32", "nanosec", "uint32"),
        ("time", "uint32", "nsec", "uint32"),
        ("duration", "int32", "nsec", "int32"),
    )
}
_LINE = re.compile(
    r"^(?P<type>[A-Za-z][\w/]*)(?P<text><=\d+)?(?P<array>\[(?P<most><=)?(?P<count>\d*)\])?\s+(?P<name>[A-Za-z]\w*)"
    r"(?P<rest>\s*=.*|\s.*)?$"
)
Definitions = dict[str, list[tuple[str, str, int]]]
"""Fields of each type: name, type, and length of an array."""


def ros_decoder(name: str, schema: bytes, *, aligned: bool) -> Callable[[Sequence[bytes]], list[Any]]:
    """What makes mappings of messages.

    Parameters
    ----------
    name : of the message type, ``package/msg/Type``. schema : definitions as ``ros2msg`` or ``ros1msg``.
    aligned : whether this is CDR, as ROS 2 has it.
    """
    types = {**_BUILT_IN, **_definitions(name, schema.decode("utf-8", "replace"))}
    return lambda payloads: [_Message(p, types, aligned).read(_short(name), 0) for p in payloads]


class _Message:
    """A message that is read from front to back."""

    def __init__(self, data: bytes, types: Definitions, aligned: bool) -> None:
        self._data, self._types, self._aligned = data, types, aligned
        self._order, self._at, self._types_read = "<", 0, 0
        if aligned:
            if len(data) < 4 or data[0] != 0 or data[1] > 1:
                raise _damaged()
            self._order, self._at = "<" if data[1] else ">", 4

    def read(self, name: str, depth: int) -> dict[str, Any]:
        """A message of a type; None for texts, of an array the first `MOST_ELEMENTS`.

        Raises
        ------
        ValueError : a type is not defined, too deep or too large; the message is damaged.
        """
        self._types_read += 1
        if depth > DEEPEST_MESSAGE or self._types_read > MOST_OPERATIONS:
            raise ValueError("a ROS message type is too deep or too large")
        if name not in self._types:
            raise ValueError(f"no definition of the ROS type {name}")
        fields = self._types[name]
        if not fields and self._aligned:  # ROS 2 fills a type without fields with one byte
            self._number("B")
        return {field: self._value(kind, count, name, depth) for field, kind, count in fields}

    def _value(self, kind: str, count: int, of: str, depth: int) -> Any:
        if count == _ALONE:
            return self._one(kind, of, depth)
        if count == _COUNTED:
            count = self._number("I")
        if count > len(self._data):
            raise _damaged()
        if kind not in _PRIMITIVES:
            return [self._one(kind, of, depth) for _ in range(count)]
        if count == 0:
            return []
        dtype = np.dtype(self._order + _PRIMITIVES[kind])
        start = self._taken(dtype.itemsize, count)
        return np.frombuffer(self._data, dtype, min(count, MOST_ELEMENTS), start).tolist()

    def _one(self, kind: str, of: str, depth: int) -> Any:
        if kind in _PRIMITIVES:
            return self._number(_PRIMITIVES[kind])
        if kind in ("string", "wstring"):
            length = self._number("I")
            self._at += length * (2 if kind == "wstring" else 1)
            return None
        return self.read(_short(kind, of), depth + 1)

    def _number(self, code: str) -> Any:
        start = self._taken(struct.calcsize(code), 1)
        return struct.unpack_from(self._order + code, self._data, start)[0]

    def _taken(self, size: int, count: int) -> int:
        """Where numbers of a size begin; the next ones begin behind them."""
        start = self._at + (-(self._at - 4) % size if self._aligned else 0)
        self._at = start + size * count
        if self._at > len(self._data):
            raise _damaged()
        return start


def _damaged() -> ValueError:
    return ValueError("a ROS message is damaged, or in another encoding than plain CDR")


def _short(name: str, of: str = "") -> str:
    """``package/Type`` of a type's name, which may leave its own package out.

    Examples
    --------
    >>> _short("std_msgs/msg/Header"), _short("Point", "geometry_msgs/Pose")
    ('std_msgs/Header', 'geometry_msgs/Point')
    """
    parts = name.split("/")
    if len(parts) > 1:
        return f"{parts[0]}/{parts[-1]}"
    if name in ("time", "duration"):
        return name
    return f"std_msgs/{name}" if name == "Header" else f"{of.split('/')[0]}/{name}"


def _definitions(name: str, text: str) -> Definitions:
    """Of a schema of several definitions."""
    found: Definitions = {}
    for block in re.split(r"^=+\s*$", text, flags=re.MULTILINE):
        lines = [line.split("#", 1)[0].strip() for line in block.splitlines()]
        own = next((line for line in lines if line.startswith("MSG:")), None)
        fields = []
        for line in lines:
            parsed = _LINE.match(line)
            if parsed is None or (parsed["rest"] or "").lstrip().startswith("="):
                continue  # an empty line, the type's name, or a constant
            bounded = not parsed["count"] or parsed["most"]
            count = _ALONE if not parsed["array"] else _COUNTED if bounded else int(parsed["count"][:9])
            fields.append((parsed["name"], parsed["type"], count))
        found.setdefault(_short(name if own is None else own.removeprefix("MSG:").strip()), fields)
    return found
