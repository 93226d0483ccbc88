"""Messages as bytes to columns of numbers: JSON, Protobuf, ROS 2's CDR, and ROS 1's, which is not aligned.

JSON and Protobuf are parsed by their libraries, a chunk at a time. No library reads both kinds of ROS
messages within the bounds; layout: OMG DDSI-RTPS 2.5, chapter 10 (plain CDR, both byte orders).
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
import orjson

from fdd.bounds import DEEPEST_MESSAGE, MOST_ELEMENTS, MOST_FIELDS, MOST_OPERATIONS, MOST_SCHEMA_FILES
from fdd.samples import Column

FieldPath = tuple[str | int, ...]
"""Keys and indices from the message down to a number."""
Decode = Callable[[Sequence[bytes]], Sequence[Any]]
"""Payloads to mappings or Protobuf messages, nested, with lists; ValueError of a damaged one."""
_LOOKED_AT = 20
"""Messages whose fields are offered."""
_UNIT_KEYS = ("unit", "units", "x-unit")


@dataclass(frozen=True)
class Decoder:
    """Reads the messages of one channel; `units` by path, as the schema gives them."""

    decode: Decode
    units: Mapping[FieldPath, str] = field(default_factory=dict)

    def fields(self, payloads: Sequence[bytes]) -> dict[FieldPath, str | None]:
        """The numbers in the first messages, and their units."""
        messages: list[Any] = []
        for payload in payloads[:_LOOKED_AT]:
            try:
                messages += self.decode([payload])
            except ValueError:  # of a later one it is told when it is read
                if not messages:
                    raise
        found = (path for message in messages for path in _paths(message, ()))
        return {path: self.units.get(path) for path in islice(dict.fromkeys(found), MOST_FIELDS)}

    def columns(self, payloads: Sequence[bytes], paths: Sequence[FieldPath]) -> list[Column]:
        """(n,) numbers of each path, NaN where a message lacks it. Raises ValueError: damaged, no numbers."""
        messages = self.decode(payloads)
        return [_numbers(messages, path) for path in paths]


def decoder_of(channel: Any, schema: Any) -> Decoder:
    """What reads a channel's messages, of the library's records. Raises ValueError: says why nothing does."""
    encoding, data = channel.message_encoding, b"" if schema is None else bytes(schema.data)
    kind = "" if schema is None else schema.encoding
    if encoding == "json":
        units: dict[FieldPath, str] = {}
        if kind == "jsonschema":
            with suppress(ValueError, RecursionError):  # a text that is no schema
                units = dict(_units_below(json.loads(data), ()))
        return Decoder(_json_objects, units)
    if encoding == "protobuf" and kind == "protobuf":
        return Decoder(_protobuf_decoder(schema.name, data))
    if (encoding, kind) in (("cdr", "ros2msg"), ("ros1", "ros1msg")):
        types, name = _definitions(schema.name, data.decode("utf-8", "replace")), _short(schema.name)
        return Decoder(lambda payloads: [_Ros(p, types, encoding == "cdr").read(name, 0) for p in payloads])
    raise ValueError(f"carries {encoding or 'unnamed'} messages{f' with a schema in {kind}' if kind else ''}")


def objects_at_once(payloads: Sequence[bytes]) -> list[dict[str, Any]] | None:
    """Parse one JSON object from each payload in a single call; None where any is something else."""
    joined = b"[" + b",".join(payloads) + b"]"
    try:
        found = orjson.loads(joined)
    except orjson.JSONDecodeError:
        # Python's own takes NaN and integers of any size, at several times the cost.
        try:
            found = json.loads(joined)
        except (ValueError, RecursionError):
            return None
    # One payload may hold two objects with a comma between them.
    whole = len(found) == len(payloads) and all(type(one) is dict for one in found)
    return list(found) if whole else None


def _json_objects(payloads: Sequence[bytes]) -> list[dict[str, Any]]:
    found = objects_at_once(payloads)
    if found is None:
        odd = next((p for p in payloads if objects_at_once([p]) is None), b"")
        raise ValueError(f"not a JSON object: {odd[:40]!r}")
    return found


def _units_below(node: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Paths of numbers and the units that a JSON Schema gives."""
    if not isinstance(node, dict) or len(path) > DEEPEST_MESSAGE:
        return
    unit = next((node[k] for k in _UNIT_KEYS if isinstance(node.get(k), str)), None)
    if unit and path:
        yield path, unit
    members = node.get("properties")
    for key, inner in members.items() if isinstance(members, dict) else ():
        yield from _units_below(inner, (*path, str(key)))


def _protobuf_decoder(name: str, schema: bytes) -> Decode:
    """`schema` is a serialised ``google.protobuf.FileDescriptorSet``."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory

    pool = descriptor_pool.DescriptorPool()
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(schema).file
        if len(files) > MOST_SCHEMA_FILES:
            raise ValueError(f"{len(files)} files in the schema")
        message_factory.GetMessages(files, pool)
        parse = message_factory.GetMessageClass(pool.FindMessageTypeByName(name)).FromString
    except Exception as error:  # DecodeError, KeyError and TypeError of a damaged schema
        raise ValueError(f"damaged Protobuf schema ({' '.join(str(error).split())[:80]})") from None

    def decode(payloads: Sequence[bytes]) -> list[Any]:
        try:
            return [parse(p) for p in payloads]
        except message.DecodeError:
            raise ValueError("a Protobuf message is damaged") from None

    return decode


def _paths(value: Any, before: FieldPath) -> Iterator[FieldPath]:
    """The numbers in a message."""
    if isinstance(value, bool | int | float):
        yield before
        return
    members: list[tuple[str | int, Any]] = []
    if len(before) >= DEEPEST_MESSAGE:
        return
    if isinstance(value, Mapping):
        members = list(value.items())
    elif (kind := getattr(value, "DESCRIPTOR", None)) is not None:
        for one in kind.fields:
            inner = one.message_type
            is_map = inner is not None and inner.GetOptions().map_entry
            repeated = one.is_repeated if hasattr(one, "is_repeated") else one.label == one.LABEL_REPEATED
            if not is_map and (inner is None or repeated or value.HasField(one.name)):
                members.append((one.name, getattr(value, one.name)))
    elif _is_list(value):
        members = list(enumerate(islice(value, MOST_ELEMENTS)))
    for key, below in members:
        yield from _paths(below, (*before, key))


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _numbers(messages: Sequence[Any], path: FieldPath) -> Column:
    values: list[Any] = list(messages)
    for part in path:
        if isinstance(part, int):
            values = [v[part] if _is_list(v) and part < len(v) else None for v in values]
        elif (one := next((v for v in values if v is not None), None)) is not None:
            if (kind := getattr(one, "DESCRIPTOR", None)) is None:
                values = [v.get(part) if isinstance(v, dict) else None for v in values]
            elif kind.fields_by_name[part].has_presence:
                values = [getattr(v, part) if v is not None and v.HasField(part) else None for v in values]
            else:  # a list, or a number of proto3, which leaves zeros out
                values = [getattr(v, part) if v is not None else None for v in values]
    try:
        return np.array(values, dtype=np.float64).reshape(len(messages))
    except (TypeError, ValueError, OverflowError):
        odd = next((v for v in values if v is not None and not isinstance(v, int | float)), values[0])
        raise ValueError(f"{str(odd)[:40]!r} is not a number") from None


_PRIMITIVES = {
    "bool": "?", "byte": "B", "char": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float32": "f", "float64": "d",
}  # fmt: skip
_ALONE, _COUNTED = -1, 0
"""In place of an array's length: no array, and one with its length before it."""
_Definitions = dict[str, list[tuple[str, str, int]]]
"""Fields of each type: name, type, and length of an array."""
_BUILT_IN: _Definitions = {
    "builtin_interfaces/Time": [("sec", "int32", _ALONE), ("nanosec", "uint32", _ALONE)],
    "builtin_interfaces/Duration": [("sec", "int32", _ALONE), ("nanosec", "uint32", _ALONE)],
    "time": [("sec", "uint32", _ALONE), ("nsec", "uint32", _ALONE)],
    "duration": [("sec", "int32", _ALONE), ("nsec", "int32", _ALONE)],
}
_LINE = re.compile(
    r"^(?P<type>[A-Za-z][\w/]*)(?P<text><=\d+)?(?P<array>\[(?P<most><=)?(?P<count>\d*)\])?\s+(?P<name>[A-Za-z]\w*)"
    r"(?P<rest>\s*=.*|\s.*)?$"
)


def _definitions(name: str, text: str) -> _Definitions:
    """Of a ROS schema of several definitions, the first of which is the message's."""
    found: _Definitions = {}
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
    return {**_BUILT_IN, **found}


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


class _Ros:
    """A ROS message that is read from front to back; `aligned`: CDR, as ROS 2 has it."""

    def __init__(self, data: bytes, types: _Definitions, aligned: bool) -> None:
        self._data, self._types, self._aligned = data, types, aligned
        self._order, self._at, self._types_read = "<", 0, 0
        if aligned:
            if len(data) < 4 or data[0] != 0 or data[1] > 1:
                raise _damaged()
            self._order, self._at = "<" if data[1] else ">", 4

    def read(self, name: str, depth: int) -> dict[str, Any]:
        """A message of a type; None for texts, of an array the first `MOST_ELEMENTS`.

        Raises ValueError: a type is not defined, too deep or too large; the message is damaged.
        """
        self._types_read += 1
        if depth > DEEPEST_MESSAGE or self._types_read > MOST_OPERATIONS:
            raise ValueError("a ROS message type is too deep or too large")
        if name not in self._types:
            raise ValueError(f"no definition of the ROS type {name}")
        fields = self._types[name]
        if not fields and self._aligned:  # ROS 2 fills a type without fields with one byte
            self._number("B")
        out: dict[str, Any] = {}
        for key, kind, count in fields:
            if count == _ALONE:
                out[key] = self._one(kind, name, depth)
                continue
            number = self._number("I") if count == _COUNTED else count
            if number > len(self._data):
                raise _damaged()
            if kind not in _PRIMITIVES:
                out[key] = [self._one(kind, name, depth) for _ in range(number)]
            elif number == 0:
                out[key] = []
            else:
                dtype = np.dtype(self._order + _PRIMITIVES[kind])
                start = self._taken(dtype.itemsize, number)
                out[key] = np.frombuffer(self._data, dtype, min(number, MOST_ELEMENTS), start).tolist()
        return out

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
