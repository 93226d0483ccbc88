"""ROS messages (ROS 2's CDR, ROS 1) to columns, by one compiled walk over the bytes of a chunk.

A definition becomes a list of operations that are carried out in order: skip or take a number, a text, an
array; go through a sequence. Layout: OMG DDSI-RTPS 2.5, chapter 10 (plain CDR, both byte orders); ROS 1 is
the same without alignment.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from fdd.bounds import DEEPEST_MESSAGE, MOST_ELEMENTS, MOST_FIELDS, MOST_OPERATIONS, MOST_VISITED
from fdd.logs.wire.chunks import Batch, Field, FieldPath, present
from fdd.logs.wire.compiled import njit
from fdd.logs.wire.numbers import FLOAT, INT, UINT, bits_of, cells, number
from fdd.samples import Column

_NUMBER, _TEXT, _SEQUENCE, _LOOP, _END = range(5)
_PRIMITIVES = {
    "bool": (1, UINT), "byte": (1, UINT), "char": (1, UINT), "uint8": (1, UINT), "int8": (1, INT),
    "uint16": (2, UINT), "int16": (2, INT), "uint32": (4, UINT), "int32": (4, INT),
    "uint64": (8, UINT), "int64": (8, INT), "float32": (4, FLOAT), "float64": (8, FLOAT),
}  # fmt: skip
_ALONE, _COUNTED = -1, 0
"""In place of an array's length: no array, and one with its length before it."""
_STAMP = [("sec", "int32", _ALONE), ("nanosec", "uint32", _ALONE)]
_BUILT_IN = {
    "builtin_interfaces/Time": _STAMP, "builtin_interfaces/Duration": _STAMP,
    "time": [("sec", "uint32", _ALONE), ("nsec", "uint32", _ALONE)],
    "duration": [("sec", "int32", _ALONE), ("nsec", "int32", _ALONE)],
}  # fmt: skip
_LINE = re.compile(
    r"^(?P<type>[A-Za-z][\w/]*)(?P<text><=\d+)?(?P<array>\[(?P<most><=)?(?P<count>\d*)\])?\s+(?P<name>[A-Za-z]\w*)"
    r"(?P<rest>\s*=.*|\s.*)?$"
)

Operation = tuple[int, int, int]
"""What, bytes of a number, and its kind."""


class RosMessages:
    """See `fdd.logs.wire.chunks.Decoder`.

    Parameters
    ----------
    name : of the message type, ``package/msg/Type``. schema : definitions as ``ros2msg`` or ``ros1msg``.
    aligned : whether this is CDR, as ROS 2 has it.

    Raises
    ------
    ValueError : a definition is not there or cannot be read.
    """

    def __init__(self, name: str, schema: bytes, *, aligned: bool = True) -> None:
        self._aligned = aligned
        self._definitions = _definitions(name, schema.decode("utf-8", "replace"))
        self._operations: list[Operation] = []
        self._places: dict[FieldPath, int] = {}
        self._sequences: set[FieldPath] = set()
        self._add(_short(name), (), 0, inside_loop=False)

    def fields(self, first: Batch) -> list[Field]:
        """All numbers of the type; of a sequence as many elements as the first message has."""
        paths = [p for p in self._places if p not in self._sequences][:MOST_FIELDS]
        elements = [(*p, k) for p in sorted(self._sequences, key=str) for k in range(MOST_ELEMENTS)]
        return [Field(p) for p in (*paths, *present(self, first, elements[:MOST_VISITED]))]

    def columns(self, batch: Batch, paths: Sequence[FieldPath]) -> list[Column]:
        """See `Decoder.columns`."""
        takes = []
        for column, path in enumerate(paths):
            if path in self._places:
                takes.append((self._places[path], 0, column))
            elif path[:-1] in self._places:
                takes.append((self._places[path[:-1]], int(path[-1]), column))
            else:
                raise ValueError("not a number of this message type")
        out = np.full((len(paths), batch.stamps.size), np.nan)
        operations = np.array(self._operations, dtype=np.int64).reshape(-1, 3)
        takes_array = np.array(sorted(takes), dtype=np.int64).reshape(-1, 3)
        if _walk(batch.data, batch.starts, batch.ends, operations, takes_array, self._aligned, cells(), out):
            raise ValueError("a ROS message is damaged, or in another encoding than plain CDR")
        return list(out)

    def _add(self, name: str, path: FieldPath, depth: int, *, inside_loop: bool) -> None:
        if depth > DEEPEST_MESSAGE:
            raise ValueError("a ROS message type is too deep")
        definition = self._definitions.get(name, _BUILT_IN.get(name))
        if definition is None:
            raise ValueError(f"no definition of the ROS type {name}")
        if not definition and self._aligned:  # ROS 2 fills a type without fields with one byte
            self._operations.append((_NUMBER, 1, UINT))
        for field, element, count in definition:
            if len(self._operations) > MOST_OPERATIONS:
                raise ValueError("a ROS message type is too large")
            if count > MOST_OPERATIONS:
                raise ValueError(f"a ROS message type has an array of {count} elements")
            own: FieldPath = (*path, field)
            primitive, counted = _PRIMITIVES.get(element), count == _COUNTED
            if counted and primitive is None:
                self._operations.append((_LOOP, 0, 0))
            for inner in [(*own, k) for k in range(count)] if count > 0 else [own]:
                if primitive is not None:
                    if not inside_loop:
                        self._places[inner] = len(self._operations)
                        if counted:
                            self._sequences.add(inner)
                    self._operations.append((_SEQUENCE if counted else _NUMBER, *primitive))
                elif element in ("string", "wstring"):
                    self._operations.append((_TEXT, 2 if element == "wstring" else 1, 0))
                else:
                    self._add(_short(element, name), inner, depth + 1, inside_loop=inside_loop or counted)
            if counted and primitive is None:
                self._operations.append((_END, 0, 0))


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


def _definitions(name: str, text: str) -> dict[str, list[tuple[str, str, int]]]:
    """Fields, their types and lengths of each type in a schema of several definitions."""
    found: dict[str, list[tuple[str, str, int]]] = {}
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


@njit()
def _walk(data, starts, ends, operations, takes, aligned, room, out):  # type: ignore[no-untyped-def]
    """Fill `out`; True where a message is damaged."""
    back, left = np.empty(32, np.int64), np.empty(32, np.int64)
    for m in range(starts.size):
        at, end, big = starts[m], ends[m], False
        if aligned:
            if end - at < 4 or data[at] != 0 or data[at + 1] > 1:
                return True
            big = data[at + 1] == 0
            at += 4
        zero, depth, take, k = at, 0, 0, 0
        while k < operations.shape[0] and (take < takes.shape[0]):
            what, size, kind = operations[k, 0], operations[k, 1], operations[k, 2]
            if what == _NUMBER:
                if aligned:
                    at += (zero - at) % size
                if at + size > end:
                    return True
                while take < takes.shape[0] and takes[take, 0] == k:
                    out[takes[take, 2], m] = number(bits_of(data, at, size, big), size, kind, room)
                    take += 1
                at += size
            elif what == _END:
                left[depth - 1] -= 1
                if left[depth - 1] > 0:
                    k = back[depth - 1]
                else:
                    depth -= 1
            else:
                if aligned:
                    at += (zero - at) % 4
                if at + 4 > end:
                    return True
                count = np.int64(bits_of(data, at, 4, big))
                at += 4
                if what == _TEXT:
                    at += count * size
                elif what == _SEQUENCE:
                    if aligned and count > 0:
                        at += (zero - at) % size
                    if at + count * size > end:
                        return True
                    while take < takes.shape[0] and takes[take, 0] == k:
                        if takes[take, 1] < count:
                            bits = bits_of(data, at + takes[take, 1] * size, size, big)
                            out[takes[take, 2], m] = number(bits, size, kind, room)
                        take += 1
                    at += count * size
                elif count == 0:  # over the loop's body
                    nested = 1
                    while nested > 0:
                        k += 1
                        if operations[k, 0] == _LOOP:
                            nested += 1
                        elif operations[k, 0] == _END:
                            nested -= 1
                else:
                    if depth >= 30 or count > end - at:
                        return True
                    back[depth], left[depth] = k, count
                    depth += 1
                if at > end:
                    return True
            k += 1
    return False
