"""MATLAB files up to version 7 (7.3 is HDF5): arrays of numbers, and structs of them.

Read here and not by SciPy, whose reader takes types and dimensions as they come, as indices too, and calls
itself for each level: a damaged file would end the process (MathWorks, MAT-File Format, chapter 1).
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fdd.bounds import DEEPEST_STRUCT, MOST_MATRIX_COLUMNS, limit
from fdd.errors import InputError
from fdd.logs.formats.signals import damaged, require_size
from fdd.logs.formats.trees import Leaf, TreeFile, tree_file

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODINGS = {4: "utf-16", 16: "utf-8", 17: "utf-16"}
_MATRIX, _PACKED = 14, 15
_STRUCT, _CHAR, _NUMBERS = 2, 4, range(6, 16)
_COMPLEX = 0x0800
_HEADER = 128


class _Odd(Exception):
    """Not as the format wants it."""


def open_matlab(path: Path) -> TreeFile:
    """Signals of a MATLAB 5 file: ``rec.pos.value`` is ``rec/pos``. Cells, objects and arrays of structs are
    passed over.

    Raises
    ------
    InputError : damaged, too large, or without arrays.
    """
    groups: dict[str, dict[str, Leaf]] = {}
    scalars: dict[str, dict[str, float]] = {}
    left = 8 * limit("MAX_VALUES")
    try:
        with path.open("rb") as stream:
            content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        order = "<" if content[126:128] == b"IM" else ">"
        variables = {}
        for kind, body in _elements(memoryview(content)[_HEADER:], order):
            if kind == _PACKED:
                raw = zlib.decompressobj().decompress(body, left + 8)
                left -= len(raw)
                if left < 0:
                    require_size(limit("MAX_VALUES") + 1, 1, path)
                kind, body = next(_elements(memoryview(raw), order), (0, memoryview(b"")))
            if kind != _MATRIX:
                raise _Odd("something else than a variable")
            name, value = _array(body, order, 0)
            variables[name] = value
    except InputError:
        raise
    except (_Odd, struct.error, zlib.error, LookupError, ValueError) as error:
        raise damaged("damaged MATLAB file", path, error, "save it again") from None
    _take_struct(variables, "", groups, scalars)
    return tree_file(path, groups, scalars)


def _elements(body: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and bytes of each element."""
    at = 0
    while at + 8 <= len(body):
        kind, size = struct.unpack_from(f"{order}II", body, at)
        begin = at + 8
        at = begin + size + (0 if kind == _PACKED else -size % 8)
        if kind >> 16:  # a short one, whose bytes stand beside its size
            kind, size = kind & 0xFFFF, min(kind >> 16, 4)
            begin, at = begin - 4, begin
        if begin + size > len(body):
            raise _Odd("an element ends after what it stands in")
        yield kind, body[begin : begin + size]


def _array(body: memoryview, order: str, depth: int) -> tuple[str, Any]:
    """Name and value: numbers, a text, a mapping; None for everything else."""
    if not len(body) or depth > DEEPEST_STRUCT:
        return "", None
    (_, flags), (_, shape), (_, label), *rest = _elements(body, order)
    (about,) = struct.unpack_from(f"{order}I", flags)
    kind, name = about & 0xFF, bytes(label).decode("latin-1")
    dimensions = np.frombuffer(shape, f"{order}i4").tolist()
    if kind in _NUMBERS and not about & _COMPLEX:
        stored, numbers = rest[0]
        values = np.frombuffer(numbers, order + _TYPES[stored])
        if values.size != math.prod(dimensions):
            raise _Odd(f"{values.size} numbers in an array of shape {dimensions}")
        return name, values.reshape(dimensions, order="F")
    if kind == _CHAR:
        stored, letters = rest[0]
        encoding = _ENCODINGS.get(stored, "latin-1")
        endings = "" if encoding != "utf-16" else "-le" if order == "<" else "-be"
        return name, bytes(letters).decode(encoding + endings, "replace")
    if kind == _STRUCT and math.prod(dimensions) == 1:
        (_, length), (_, names), *fields = rest
        (width,) = struct.unpack_from(f"{order}i", length)
        own = [names[k : k + width] for k in range(0, len(names), max(width, 1))]
        keys = [bytes(one).split(b"\0")[0].decode("latin-1") for one in own]
        return name, {key: _array(f, order, depth + 1)[1] for key, (_, f) in zip(keys, fields, strict=True)}
    return name, None


def _take_struct(
    own: dict[str, Any], group: str, groups: dict[str, dict[str, Leaf]], scalars: dict[str, dict[str, float]]
) -> None:
    unit = next((v for k, v in own.items() if k.lower() in ("unit", "units") and isinstance(v, str)), None)
    for name, value in own.items():
        if isinstance(value, dict):
            _take_struct(value, f"{group}/{name}" if group else name, groups, scalars)
        elif isinstance(value, np.ndarray) and value.size == 1:
            scalars.setdefault(group, {})[name] = float(value.item())
        elif isinstance(value, np.ndarray):
            for column_name, column in columns_of(name, value):
                # A struct's unit is that of its value, not of its time.
                mine = unit if column_name.lower() not in ("time", "t") else None
                leaf = Leaf(column.size, partial(np.asarray, column), mine)
                groups.setdefault(group, {})[column_name] = leaf


def columns_of(name: str, values: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """A vector as it is, a matrix as its columns ``name[0]`` and on; nothing for anything else."""
    flat = values.squeeze()
    if flat.ndim == 1:
        return [(name, flat)]
    if flat.ndim != 2 or flat.shape[0] < flat.shape[1] or flat.shape[1] > MOST_MATRIX_COLUMNS:
        return []
    return [(f"{name}[{k}]", flat[:, k]) for k in range(flat.shape[1])]
