"""Messages of any encoding to columns of numbers: decoded by the chunk, then picked by path."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
import orjson

from fdd.bounds import DEEPEST_MESSAGE, MOST_ELEMENTS, MOST_FIELDS, MOST_SCHEMA_FILES
from fdd.logs.wire.ros_messages import ros_decoder
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
        """(n,) numbers of each path, NaN where a message lacks it.

        Raises
        ------
        ValueError : a message is damaged, or holds something else than numbers there.
        """
        messages = self.decode(payloads) if paths else []
        return [_numbers(messages, path) for path in paths]


def decoder_of(channel: Any, schema: Any) -> Decoder:
    """What reads the messages of a channel.

    Parameters
    ----------
    channel, schema : the library's records; the schema may be None.

    Raises
    ------
    ValueError : says why the messages cannot be read.
    """
    encoding, data = channel.message_encoding, b"" if schema is None else bytes(schema.data)
    kind = "" if schema is None else schema.encoding
    if encoding == "json":
        return Decoder(_json_objects, _schema_units(data) if kind == "jsonschema" else {})
    if encoding == "protobuf" and kind == "protobuf":
        return Decoder(_protobuf_decoder(schema.name, data))
    if (encoding, kind) in (("cdr", "ros2msg"), ("ros1", "ros1msg")):
        return Decoder(ros_decoder(schema.name, data, aligned=encoding == "cdr"))
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
    return objects_at_once(payloads) or [_object(p) for p in payloads]


def _object(text: bytes) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON ({type(error).__name__}): {text[:40]!r}") from None
    if not isinstance(found, dict):
        raise ValueError(f"not a JSON object: {text[:40]!r}")
    return found


def _schema_units(schema: bytes) -> dict[FieldPath, str]:
    """Path of a number to the unit that a JSON Schema gives; nothing of a text that is none."""
    with suppress(ValueError, RecursionError):
        return dict(_units_below(json.loads(schema), ()))
    return {}


def _units_below(node: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
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

    files = descriptor_pb2.FileDescriptorSet()
    pool = descriptor_pool.DescriptorPool()
    try:
        files.ParseFromString(schema)
        if len(files.file) > MOST_SCHEMA_FILES:
            raise ValueError(f"{len(files.file)} files in the schema")
        waiting = {f.name: f for f in files.file}
        while waiting:
            ready = [f for f in waiting.values() if not any(d in waiting for d in f.dependency)]
            if not ready:
                raise ValueError("the schema's files need one another in a circle")
            for file in ready:
                pool.Add(file)
                del waiting[file.name]
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
    if isinstance(value, bool | int | float):
        yield before
    elif len(before) < DEEPEST_MESSAGE:
        for key, inner in _members(value):
            yield from _paths(inner, (*before, key))


def _members(value: Any) -> Iterator[tuple[str | int, Any]]:
    if isinstance(value, Mapping):
        yield from value.items()
    elif (kind := getattr(value, "DESCRIPTOR", None)) is not None:
        for one in kind.fields:
            inner = one.message_type
            is_map = inner is not None and inner.GetOptions().map_entry
            repeated = one.is_repeated if hasattr(one, "is_repeated") else one.label == one.LABEL_REPEATED
            if not is_map and (inner is None or repeated or value.HasField(one.name)):
                yield one.name, getattr(value, one.name)
    elif _is_list(value):
        yield from enumerate(islice(value, MOST_ELEMENTS))


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
