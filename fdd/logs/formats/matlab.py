"""MATLAB files up to version 7 (7.3 is HDF5): variables, and structs of them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fdd.bounds import DEEPEST_STRUCT, MOST_MATRIX_COLUMNS, limit, raised
from fdd.errors import InputError
from fdd.logs.formats.matlab_check import check_matlab
from fdd.logs.formats.signals import damaged
from fdd.logs.formats.trees import Leaf, TreeFile, tree_file


def open_matlab(path: Path) -> TreeFile:
    """Signals of a MATLAB 5 file: ``rec.pos.value`` is ``rec/pos``.

    Raises
    ------
    InputError : damaged, too large, or without arrays.
    """
    from scipy.io import loadmat, whosmat

    try:
        check_matlab(path)
        sizes = [int(np.prod(shape, dtype=np.float64)) for _, shape, _ in whosmat(path)]
        if sum(sizes) > (most := limit("MAX_VALUES")):
            raise InputError(
                f"{sum(sizes)} numbers, at most {most} are read",
                where=path,
                mend=f"split it, {raised('MAX_VALUES', sum(sizes))}",
            )
        content = loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except Exception as error:  # scipy's reader lets whatever a damaged file provokes through
        raise damaged("damaged MATLAB file", path, error, "save it again") from None
    groups: dict[str, dict[str, Leaf]] = {}
    scalars: dict[str, dict[str, float]] = {}
    _walk({k: v for k, v in content.items() if not k.startswith("__")}, "", groups, scalars, 0)
    return tree_file(path, groups, scalars)


def _walk(
    struct: dict[str, Any],
    group: str,
    groups: dict[str, dict[str, Leaf]],
    scalars: dict[str, dict[str, float]],
    depth: int,
) -> None:
    unit = next((v for k, v in struct.items() if k.lower() in ("unit", "units") and isinstance(v, str)), None)
    for name, value in struct.items():
        if isinstance(value, dict) and depth < DEEPEST_STRUCT:
            _walk(value, f"{group}/{name}" if group else name, groups, scalars, depth + 1)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            for own, column in columns_of(name, value):
                # A struct's unit is that of its value, not of its time.
                mine = unit if own.lower() not in ("time", "t") else None
                groups.setdefault(group, {})[own] = Leaf(column.size, partial(np.asarray, column), mine)
        elif isinstance(value, int | float):
            scalars.setdefault(group, {})[name] = float(value)


def columns_of(name: str, values: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """A vector as it is, a matrix as its columns ``name[0]`` and on; nothing for anything else.

    Examples
    --------
    >>> [n for n, _ in columns_of("p", np.zeros((5, 2)))], [n for n, _ in columns_of("x", np.zeros((1, 5)))]
    (['p[0]', 'p[1]'], ['x'])
    """
    flat = values.squeeze()
    if flat.ndim == 1:
        return [(name, flat)]
    if flat.ndim != 2 or flat.shape[0] < flat.shape[1] or flat.shape[1] > MOST_MATRIX_COLUMNS:
        return []
    return [(f"{name}[{k}]", flat[:, k]) for k in range(flat.shape[1])]
