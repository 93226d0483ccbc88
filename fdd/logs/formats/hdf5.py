"""HDF5, and MATLAB 7.3, which is HDF5 with structs as groups and every vector as a matrix."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MOST_MATRIX_COLUMNS
from fdd.logs.formats.signals import readable, require_stored, unit_among
from fdd.logs.formats.trees import Leaf, TreeFile, tree_file

_UNITS = ("unit", "units")
_NUMBERS = "fiub"


def open_hdf5(path: Path) -> TreeFile:
    """Signals of an HDF5 file: the dataset ``/daq/fast/p_1`` is ``daq/fast/p_1``.

    Vectors, columns of matrices and members of compound types are signals. Links to other files are not
    followed.

    Raises
    ------
    InputError : damaged, or without arrays.
    """
    import h5py

    groups: dict[str, dict[str, Leaf]] = {}
    scalars: dict[str, dict[str, float]] = {}
    with readable("damaged HDF5 file", path), h5py.File(path) as file:
        for group, own in [("", file), *_groups(file)]:
            for key, value in own.attrs.items():
                if np.ndim(value) == 0 and isinstance(value, int | float | np.number):
                    scalars.setdefault(group, {})[key] = float(value)
            _take_group(path, group, own, groups, scalars)
    return tree_file(path, groups, scalars)


def _groups(file: Any) -> list[tuple[str, Any]]:
    import h5py

    found: list[tuple[str, Any]] = []

    def take(name: str, node: Any) -> None:
        if isinstance(node, h5py.Group) and not name.startswith("#"):  # MATLAB keeps those for itself
            found.append((name, node))

    file.visititems(take)  # follows neither soft nor external links
    return found


def _take_group(
    path: Path,
    group: str,
    own: Any,
    groups: dict[str, dict[str, Leaf]],
    scalars: dict[str, dict[str, float]],
) -> None:
    import h5py

    unit = None
    leaves = groups.setdefault(group, {})
    for name in own:
        if not isinstance(own.get(name, getlink=True), h5py.HardLink):
            continue
        node = own[name]
        if not isinstance(node, h5py.Dataset):
            continue
        if name.lower() in _UNITS and node.dtype.kind == "u" and node.size < 64:
            unit = "".join(chr(c) for c in node[()].reshape(-1))  # MATLAB's text
        elif node.size is None:  # no shape at all
            continue
        elif node.size == 1 and node.dtype.kind in _NUMBERS:
            scalars.setdefault(group, {})[name] = float(node[()].reshape(-1)[0])
        else:
            found = _leaves(path, name, node)
            if found:
                require_stored(node.size * node.dtype.itemsize, node.id.get_storage_size(), path)
            leaves.update(found)
    if unit is not None:
        for name, leaf in leaves.items():
            if name.lower() not in ("time", "t"):
                leaves[name] = Leaf(leaf.size, leaf.load, leaf.unit or unit)


def _leaves(path: Path, name: str, node: Any) -> dict[str, Leaf]:
    full, unit = node.name, unit_among(node.attrs)
    if node.dtype.names:
        return {
            f"{name}/{member}": Leaf(node.size, partial(_load, path, full, member))
            for member in node.dtype.names
            if node.dtype[member].kind in _NUMBERS and node.ndim == 1
        }
    if node.dtype.kind not in _NUMBERS or node.ndim > 2 or node.ndim == 0:
        return {}
    rows, columns = max(node.shape), (min(node.shape) if node.ndim == 2 else 1)
    if columns == 1:
        return {name: Leaf(rows, partial(_load, path, full, ()), unit)}
    if columns > MOST_MATRIX_COLUMNS:
        return {}
    by_row = node.shape[0] == columns  # MATLAB's matrices lie on their side
    return {
        f"{name}[{k}]": Leaf(rows, partial(_load, path, full, np.s_[k, :] if by_row else np.s_[:, k]), unit)
        for k in range(columns)
    }


def _load(path: Path, name: str, part: Any) -> NDArray[np.generic]:
    import h5py

    with readable(f"{name} cannot be read", path), h5py.File(path) as file:
        return np.asarray(file[name][part])
