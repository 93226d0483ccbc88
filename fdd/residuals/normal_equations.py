"""Normal equations of a stretch of a balance, and what they tell where coefficients wander."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def widened(information: Array, vector: Array, std: Array) -> tuple[Array, Array]:
    """What normal equations tell when their coefficients differ by N(0, std²) from those sought; any
    leading axes.

    ``M (I + Q M)⁻¹`` and ``(I + M Q)⁻¹ m``, the likelihood with the difference integrated out, by the
    eigenvalues of
    ``√Q M √Q``: never negative, whatever the sizes of the columns.
    """
    values, vectors = np.linalg.eigh(information * std * std[:, None])
    values = values.clip(0.0)[..., None, :]
    turned = np.swapaxes(vectors, -1, -2)
    wide = (vectors * (values / (1.0 + values))) @ turned / std / std[:, None]
    kept = ((vectors / (1.0 + values)) @ turned @ (vector * std)[..., None])[..., 0] / std
    return wide, kept


class NormalEquations(NamedTuple):
    """What a frame tells of a balance: information (n, n), vector (n,), rows behind it, and their
    variance."""

    information: Array
    vector: Array
    rows: float
    variance: float
