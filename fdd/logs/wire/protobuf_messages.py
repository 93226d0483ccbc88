"""Protobuf messages to columns, by one compiled walk over the bytes of a chunk.

A schema becomes a table of edges: from a message type, by a field's number, to a column or to the fields of
a message inside. Wire format: protobuf.dev/programming-guides/encoding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import DEEPEST_MESSAGE, MOST_ELEMENTS, MOST_FIELDS, MOST_SCHEMA_FILES, MOST_VISITED
from fdd.logs.wire.chunks import Batch, Field, FieldPath, present
from fdd.logs.wire.compiled import njit
from fdd.logs.wire.numbers import FLOAT, INT, UINT, ZIGZAG, bits_of, cells, number
from fdd.samples import Column

_NODE, _NUMBER, _CHILD, _COLUMN, _SIZE, _KIND, _INDEX = range(7)
# By number of google.protobuf.FieldDescriptor's types: bytes (0: a varint) and kind of double, float, int64,
# uint64, int32, fixed64, fixed32, bool, uint32, enum, sfixed32, sfixed64, sint32, sint64.
_KINDS = {
    1: (8, FLOAT), 2: (4, FLOAT), 3: (0, INT), 4: (0, UINT), 5: (0, INT), 6: (8, UINT), 7: (4, UINT),
    8: (0, UINT), 13: (0, UINT), 14: (0, INT), 15: (4, INT), 16: (8, INT), 17: (0, ZIGZAG), 18: (0, ZIGZAG),
}  # fmt: skip
_MESSAGE = 11


class ProtobufMessages:
    """See `fdd.logs.wire.chunks.Decoder`.

    Parameters
    ----------
    name : of the message type. schema : a serialised ``google.protobuf.FileDescriptorSet``.

    Raises
    ------
    ValueError : the schema is damaged or lacks the type.
    """

    def __init__(self, name: str, schema: bytes) -> None:
        self._type = _descriptor(name, schema)

    def fields(self, first: Batch) -> list[Field]:
        """All numbers of the type; of an array as many elements as the first message has."""
        looked_at = islice(_paths(self._type, ()), MOST_VISITED)
        paths = list(islice((p for p in looked_at if p is not None), MOST_FIELDS))
        scalar = [p for p in paths if not any(isinstance(k, int) for k in p)]
        arrays = [p for p in paths if any(isinstance(k, int) for k in p)]
        return [Field(p) for p in (*scalar, *present(self, first, arrays))]

    def columns(self, batch: Batch, paths: Sequence[FieldPath]) -> list[Column]:
        """See `Decoder.columns`."""
        edges, defaults = _edges(self._type, paths)
        out = np.full((len(paths), batch.stamps.size), np.nan)
        if _walk(batch.data, batch.starts, batch.ends, edges, defaults, cells(), out):
            raise ValueError("a Protobuf message is damaged")
        return list(out)


def _descriptor(name: str, schema: bytes) -> Any:
    from google.protobuf import descriptor_pb2, descriptor_pool

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
        return pool.FindMessageTypeByName(name)
    except Exception as error:  # DecodeError, KeyError and TypeError of a damaged schema
        raise ValueError(f"damaged Protobuf schema ({' '.join(str(error).split())[:80]})") from None


def _repeated(field: Any) -> bool:
    return bool(field.is_repeated) if hasattr(field, "is_repeated") else field.label == 3


def _paths(kind: Any, before: FieldPath) -> Iterator[FieldPath | None]:
    """Numbers of a type, and a None for each message: a type that holds itself has messages without end."""
    yield None
    if len(before) >= DEEPEST_MESSAGE:
        return
    for field in kind.fields:
        path: FieldPath = (*before, field.name)
        # Arrays of messages, and arrays in arrays, are offered as far as a rig's joints or axes go.
        most = 8 if field.type == _MESSAGE or any(isinstance(k, int) for k in before) else MOST_ELEMENTS
        for one in [(*path, k) for k in range(most)] if _repeated(field) else [path]:
            if field.type in _KINDS:
                yield one
            elif field.type == _MESSAGE:
                yield from _paths(field.message_type, one)


def _edges(kind: Any, paths: Sequence[FieldPath]) -> tuple[NDArray[np.int64], Column]:
    """Rows of node, number, child node or -1, column, size, kind and element; and each column's default."""
    rows: list[tuple[int, ...]] = []
    nodes: dict[FieldPath, int] = {(): 0}
    defaults = np.full(len(paths), np.nan)
    for column, path in enumerate(paths):
        own, k = kind, 0
        at: FieldPath = ()
        while k < len(path):
            field = own.fields_by_name[str(path[k])]
            step: FieldPath = (path[k],)
            index = -1
            if _repeated(field):
                index = int(path[k + 1])
                step = (path[k], path[k + 1])
            k += len(step)
            inner = (*at, *step)
            if k < len(path):
                if inner not in nodes:
                    nodes[inner] = len(nodes)
                    rows.append((nodes[at], field.number, nodes[inner], -1, 0, 0, index))
                own, at = field.message_type, inner
            else:
                rows.append((nodes[at], field.number, -1, column, *_KINDS[field.type], index))
                if not field.has_presence and index < 0:
                    defaults[column] = 0.0  # proto3 leaves zeros out
    return np.array(rows, dtype=np.int64).reshape(-1, 7), defaults


@njit()
def _value(data, at, end, size):  # type: ignore[no-untyped-def]
    """A number of `size` bytes (0: a varint) and the byte after it; -1 where it is cut off or too long."""
    if size:
        return (bits_of(data, at, size, False), at + size) if at + size <= end else (np.uint64(0), -1)
    value, shift = np.uint64(0), 0
    while at < end and shift < 70:
        byte = data[at]
        at += 1
        if shift < 64:
            value |= np.uint64(byte & 0x7F) << np.uint64(shift)
        if byte < 0x80:
            return value, at
        shift += 7
    return value, -1


@njit()
def _begin(node, edges, defaults, counts, out, m):  # type: ignore[no-untyped-def]
    for e in range(edges.shape[0]):
        if edges[e, _NODE] == node:
            counts[e] = 0
            if edges[e, _COLUMN] >= 0:
                out[edges[e, _COLUMN], m] = defaults[edges[e, _COLUMN]]


@njit()
def _walk(data, starts, ends, edges, defaults, room, out):  # type: ignore[no-untyped-def]
    """Fill `out`; True where a message is damaged."""
    until, inside = np.empty(64, np.int64), np.empty(64, np.int64)
    counts = np.zeros(edges.shape[0], np.int64)
    for m in range(starts.size):
        depth, at = 0, starts[m]
        until[0], inside[0] = ends[m], 0
        _begin(0, edges, defaults, counts, out, m)
        while depth >= 0:
            if at >= until[depth]:
                depth -= 1
                continue
            node, end = inside[depth], until[depth]
            tag, body = _value(data, at, end, 0)
            if body < 0:
                return True
            bits = np.uint64(0)
            field, wire = np.int64(tag >> np.uint64(3)), np.int64(tag & np.uint64(7))
            if wire == 2:
                length, body = _value(data, body, end, 0)
                if body < 0 or length > np.uint64(end - body):
                    return True
                at = body + np.int64(length)
            elif wire == 0:
                bits, at = _value(data, body, end, 0)
                if at < 0:
                    return True
            elif wire == 1 or wire == 5:
                at = body + (8 if wire == 1 else 4)
                if at > end:
                    return True
                bits = bits_of(data, body, at - body, False)
            else:
                return True
            pushed = False
            for e in range(edges.shape[0]):
                if edges[e, _NODE] != node or edges[e, _NUMBER] != field:
                    continue
                size, kind, index, inner = edges[e, _SIZE], edges[e, _KIND], edges[e, _INDEX], body
                wide = size if size else 8
                if edges[e, _CHILD] >= 0:
                    if wire == 2 and (index < 0 or counts[e] == index) and not pushed and depth < 60:
                        pushed = True
                        until[depth + 1], inside[depth + 1] = at, edges[e, _CHILD]
                        if counts[e] == 0 or index >= 0:
                            _begin(edges[e, _CHILD], edges, defaults, counts, out, m)
                    counts[e] += 1
                    continue
                if wire != 2:
                    if index < 0 or counts[e] == index:
                        out[edges[e, _COLUMN], m] = number(bits, wide, kind, room)
                    counts[e] += 1
                    continue
                while inner < at:  # packed
                    bits, inner = _value(data, inner, at, size)
                    if inner < 0:
                        return True
                    if counts[e] == index:
                        out[edges[e, _COLUMN], m] = number(bits, wide, kind, room)
                    counts[e] += 1
            if pushed:
                at = body
                depth += 1
    return False
