"""HDF5, and MATLAB 7.3, which is HDF5 with structs as groups and every vector as a matrix."""

from __future__ import annotations

import mmap
import struct
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MOST_MATRIX_COLUMNS
from fdd.errors import InputError
from fdd.logs.formats import readable, require_stored, unit_among
from fdd.logs.formats.trees import Group, Leaf, TreeFile, tree_file

_NUMBERS = "fiub"


def open_hdf5(path: Path) -> TreeFile:
    """Signals of an HDF5 file: vectors, columns of matrices and members of compound types; the dataset
    ``/daq/fast/p_1`` is ``daq/fast/p_1``. Links to other files are not followed. An InputError where it is
    damaged, or without arrays."""
    check_hdf5(path)
    nodes: dict[str, Any] = {}

    def take(name: str, node: Any) -> None:
        if isinstance(node, h5py.Group) and not name.startswith("#"):  # MATLAB keeps those for itself
            nodes[name] = node

    with readable("damaged HDF5 file", path), h5py.File(path) as file:
        take("", file)
        file.visititems(take)  # follows neither soft nor external links
        groups = {name: _group(path, node) for name, node in nodes.items()}
    return tree_file(path, groups)


def _group(path: Path, own: Any) -> Group:
    found = Group()
    for key, value in own.attrs.items():
        if np.ndim(value) == 0 and isinstance(value, int | float | np.number):
            found.scalars[key] = float(value)
    for name in own:
        node = own[name] if isinstance(own.get(name, getlink=True), h5py.HardLink) else None
        if not isinstance(node, h5py.Dataset):
            continue
        if name.lower() in ("unit", "units") and node.dtype.kind == "u" and node.size < 64:
            found.unit = "".join(chr(c) for c in node[()].reshape(-1))  # MATLAB's text
        elif node.size == 1 and node.dtype.kind in _NUMBERS:
            found.scalars[name] = float(node[()].reshape(-1)[0])
        elif node.size is not None and (leaves := _leaves(path, name, node)):  # else it has no shape at all
            require_stored(node.size * node.dtype.itemsize, node.id.get_storage_size(), path)
            found.leaves.update(leaves)
    return found


def _leaves(path: Path, name: str, node: Any) -> dict[str, Leaf]:
    """A vector, the columns of a matrix, or the members of a compound type."""
    full, unit, kind = node.name, unit_among(node.attrs), node.dtype
    if kind.names:
        members = [m for m in kind.names if kind[m].kind in _NUMBERS and node.ndim == 1]
        return {f"{name}/{m}": Leaf(node.size, partial(_load, path, full, m)) for m in members}
    if kind.kind not in _NUMBERS or node.ndim not in (1, 2):
        return {}
    rows, columns = max(node.shape), (min(node.shape) if node.ndim == 2 else 1)
    if columns == 1:
        return {name: Leaf(rows, partial(_load, path, full, ()), unit)}
    if columns > MOST_MATRIX_COLUMNS:
        return {}
    by_row = node.shape[0] == columns  # MATLAB's matrices lie on their side
    parts = [np.s_[k, :] if by_row else np.s_[:, k] for k in range(columns)]
    return {f"{name}[{k}]": Leaf(rows, partial(_load, path, full, p), unit) for k, p in enumerate(parts)}


def _load(path: Path, name: str, part: Any) -> NDArray[np.generic]:
    with readable(f"{name} cannot be read", path), h5py.File(path) as file:
        return np.asarray(file[name][part])


_MARK = b"GCOL\x01\0\0\0"
"""Of a global heap collection (HDF5 file format 3.0, III.E), where texts of variable length stand."""
_LARGEST = 1 << 32
"""Bytes of a heap that are looked at; the library's have 4096."""


def check_hdf5(path: Path) -> None:
    """Refuse a file with a heap whose free space has no size: the library takes it again and again."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as raw:
        end = 0
        while (start := raw.find(_MARK, end)) >= 0:
            left = min(int.from_bytes(raw[start + 8 : start + 16], "little"), _LARGEST) - 16
            end = start + 16
            while left >= 16 and end + 16 <= len(raw):
                number, size = struct.unpack_from("<H6xQ", raw, end)
                end += 16
                if number == 0 and size == 0:
                    problem = f"damaged HDF5 file (the heap at byte {start} has no end)"
                    raise InputError(problem, where=path, mend="copy it again")
                padded = -(-size // 8) * 8
                left = 0 if number == 0 else left - 16 - padded
                end += padded if left >= 16 else 0
