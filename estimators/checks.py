"""What comes into a filter, as fresh float arrays of the right shape; what does not fit is refused.

Each refusal is a ``ValueError`` of one line that names the thing, what is wrong and what fits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from estimators.linalg import Array, Mask


def whole_number(value: int, least: int, name: str) -> int:
    """``value`` as an int, at least ``least``."""
    if int(value) != value or value < least:
        raise ValueError(f"{name} is {value!r}; give a whole number of at least {least}")
    return int(value)


def vector(value: ArrayLike, size: int, name: str) -> Array:
    """A fresh (size,) array of whatever shape came in."""
    array = np.array(value, dtype=float).reshape(-1)
    if array.size != size:
        raise ValueError(f"{name} has {array.size} values, the filter expects {size}")
    return array


def matrix(value: ArrayLike, rows: int, columns: int, name: str) -> Array:
    """A fresh (rows, columns) array; a scalar or a flat list will do where the sizes agree."""
    array = np.array(value, dtype=float, order="C")
    if array.ndim == 3 and array.shape[2] == 1:  # a Jacobian built from the elements of a column state
        array = array[:, :, 0]
    if array.size == rows * columns and (array.ndim < 2 or array.shape == (rows, columns)):
        return np.ascontiguousarray(array.reshape(rows, columns))
    raise ValueError(f"{name} has shape {array.shape}, the filter expects {(rows, columns)}")


def square(value: ArrayLike, size: int, name: str) -> Array:
    """A covariance (size, size) from a scalar, its diagonal or itself; a symmetric, finite copy."""
    array = np.asarray(value, dtype=float)
    if array.ndim == 0:
        array = array * np.eye(size)
    elif array.shape == (size,):
        array = np.diag(array)
    full = matrix(array, size, size, name)
    if not np.isfinite(full).all():
        raise ValueError(f"{name} has values that are not finite")
    if (np.diag(full) < 0.0).any():
        raise ValueError(f"{name} has a negative variance at {first_place(np.diag(full) < 0.0)}")
    return 0.5 * (full + full.T)


def measured_channels(z: Array, mask: ArrayLike | None) -> Mask:
    """True where ``z`` (m,) is a number and ``mask`` (m,), if given, says to use it."""
    used = ~np.isnan(z)
    if mask is not None:
        wanted = np.asarray(mask)
        if wanted.dtype != np.bool_ or wanted.size != z.size:
            raise ValueError(
                f"mask has {wanted.size} values of type {wanted.dtype}; give {z.size} bools, True to use"
            )
        used &= wanted.reshape(-1)
    infinite = used & np.isinf(z)
    if infinite.any():
        raise ValueError(f"z is infinite in channel {first_place(infinite)}; mark a gap with NaN")
    return used


def require_finite(array: Array, what: str, place: str) -> None:
    """Refuse an array with values that are not finite; names what it is and the first place."""
    bad = ~np.isfinite(array)
    if bad.any():
        raise ValueError(
            f"{what} is not finite in {place} {first_place(bad)}; check the model and the covariances"
        )


def first_place(bad: Mask) -> int:
    """Index, along the first axis, of the first True."""
    return int(np.argwhere(bad)[0][0])
