"""MATLAB files up to version 7 (7.3 is HDF5): variables, and structs of them.

SciPy's reader takes types and dimensions as they come, as indices too, and calls itself for each level: a
damaged file can end the process. So its elements are walked first (MathWorks, MAT-File Format, chapter 1).
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fdd.bounds import DEEPEST_STRUCT, MOST_MATRIX_COLUMNS, MOST_MATRIX_DEPTH, limit
from fdd.errors import InputError
from fdd.logs.formats import readable, require_size
from fdd.logs.formats.trees import Group, Leaf, TreeFile, tree_file


def open_matlab(path: Path) -> TreeFile:
    """Signals, ``rec.pos.value`` as ``rec/pos``. Raises InputError: damaged, too large, or without arrays."""
    from scipy.io import loadmat, whosmat

    with readable("damaged MATLAB file", path, "save it again"):
        check_matlab(path)
        require_size(sum(int(np.prod(shape, dtype=np.float64)) for _, shape, _ in whosmat(path)), 1, path)
        content = loadmat(path, simplify_cells=True)
    groups: dict[str, Group] = {}
    _walk({k: v for k, v in content.items() if not k.startswith("__")}, "", groups, 0)
    return tree_file(path, groups)


def _walk(struct: dict[str, Any], path: str, groups: dict[str, Group], depth: int) -> None:
    units = (v for k, v in struct.items() if k.lower() in ("unit", "units") and isinstance(v, str))
    own = Group(unit=next(units, None))
    for name, value in struct.items():
        if isinstance(value, dict) and depth < DEEPEST_STRUCT:
            _walk(value, f"{path}/{name}" if path else name, groups, depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            for key, column in _columns_of(name, value):
                groups.setdefault(path, own).leaves[key] = Leaf(column.size, partial(np.asarray, column))
        elif isinstance(value, int | float):
            own.scalars[name] = float(value)


def _columns_of(name: str, values: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """A vector as it is, a matrix as its columns ``name[0]`` and on; nothing for anything else."""
    flat = values.squeeze()
    if flat.ndim == 1:
        return [(name, flat)]
    if flat.ndim != 2 or flat.shape[0] < flat.shape[1] or flat.shape[1] > MOST_MATRIX_COLUMNS:
        return []
    return [(f"{name}[{k}]", flat[:, k]) for k in range(flat.shape[1])]


_MATRIX, _PACKED = 14, 15
_INTEGERS, _NUMBERS, _TEXTS = (5, 6), (1, 2, 3, 4, 5, 6, 7, 9, 12, 13), (1, 2, 3, 4, 16, 17, 18)
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_COMPLEX = 0x0800
_HEADER, _BEGINNING = 128, 1 << 16


def check_matlab(path: Path) -> None:
    """Refuse a file with an element of a wrong type or wrong dimensions, or that goes on behind its end."""
    try:
        with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            order = "<" if data[126:128] == b"IM" else ">"
            at = _HEADER
            while at + 8 <= len(data):
                kind, size = struct.unpack_from(f"{order}II", data, at)
                if at + 8 + size > len(data):
                    raise ValueError("a variable ends after the file does")
                if kind == _PACKED:
                    _check_packed(data[at + 8 : at + 8 + size], order)
                elif kind == _MATRIX:
                    _Elements(data, order, len(data)).matrix(at, 0)
                else:
                    raise ValueError("something else than a variable")
                at += 8 + size
    except (ValueError, struct.error, zlib.error) as error:
        raise InputError(f"damaged MATLAB file ({error})", where=path, mend="save it again") from None


def _check_packed(packed: bytes, order: str) -> None:
    """The beginning tells an array of numbers; what holds others is unpacked as a whole."""
    stream = zlib.decompressobj()
    raw = stream.decompress(packed, _BEGINNING)
    if len(raw) > 16 and raw[16 if order == "<" else 19] in (_CELL, _STRUCT, _OBJECT, _FUNCTION, _OPAQUE):
        most = 8 * limit("MAX_VALUES")
        raw += stream.decompress(stream.unconsumed_tail, most)
        if stream.unconsumed_tail:
            raise ValueError(f"more than {most} bytes unpacked")
    whole = len(raw) if stream.eof else 8 + struct.unpack_from(f"{order}I", raw, 4)[0]
    _Elements(raw, order, whole).matrix(0, 0)


class _Elements:
    """Reads elements in the order in which SciPy does. `end` is where the last one has to end."""

    def __init__(self, data: bytes | mmap.mmap, order: str, end: int) -> None:
        self._data, self._order, self._end = data, order, end

    def _element(self, at: int, kinds: tuple[int, ...]) -> tuple[int, int, int]:
        """First byte, size, and where the next one stands."""
        first, size = struct.unpack_from(f"{self._order}II", self._data, at)
        begin, after = at + 8, at + 8 + size + -size % 8
        if first >> 16:
            first, size, begin, after = first & 0xFFFF, first >> 16, at + 4, at + 8
            if size > 4:
                raise ValueError("a short element of more than four bytes")
        if first not in kinds:
            raise ValueError(f"an element of type {first}")
        if begin + size > self._end:
            raise ValueError("an element ends after its variable")
        return begin, size, after

    def _words(self, at: int, most: int) -> tuple[tuple[int, ...], int]:
        begin, size, after = self._element(at, _INTEGERS)
        if size % 4 or size > 4 * most:
            raise ValueError("a head of the wrong size")
        return struct.unpack_from(f"{self._order}{size // 4}i", self._data, begin), after

    def matrix(self, at: int, depth: int) -> int:
        """Check an array and all in it; gives where the next element stands."""
        if depth > MOST_MATRIX_DEPTH:
            raise ValueError(f"nested deeper than {MOST_MATRIX_DEPTH} levels")
        at, size, after = self._element(at, (_MATRIX,))
        if size == 0:
            return after
        flags, at = self._words(at, 2)
        if len(flags) != 2:
            raise ValueError("an array without its flags")
        kind = flags[0] & 0xFF
        if kind == _OPAQUE:
            for _ in range(3):
                at = self._element(at, _TEXTS)[2]
            return self.matrix(at, depth + 1)
        shape, at = self._words(at, 32)
        if len(shape) < 2 or min(shape) < 0:
            raise ValueError(f"an array of shape {shape}")
        at = self._element(at, _TEXTS)[2]
        count = math.prod(shape)
        if kind in (_STRUCT, _OBJECT):
            if kind == _OBJECT:
                at = self._element(at, _TEXTS)[2]
            widths, at = self._words(at, 1)
            _, size, at = self._element(at, _TEXTS)
            if len(widths) != 1 or widths[0] <= 0:
                raise ValueError("a struct without the length of its names")
            count *= size // widths[0]
        if kind in (_CELL, _STRUCT, _OBJECT, _FUNCTION):
            for _ in range(1 if kind == _FUNCTION else count):
                at = self.matrix(at, depth + 1)
            return at
        if kind == _CHAR:
            return self._element(at, _TEXTS)[2]
        if not _CHAR < kind < _FUNCTION:
            raise ValueError(f"an array of class {kind}")
        if kind == _SPARSE:
            for _ in range(2):
                at = self._element(at, _INTEGERS)[2]
        for _ in range(2 if flags[0] & _COMPLEX else 1):
            at = self._element(at, _NUMBERS)[2]
        return at
