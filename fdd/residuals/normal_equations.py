"""Normal equations of a balance's regression, and the marginal ones where coefficients are random effects."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def marginalised(information: Array, vector: Array, std: Array) -> tuple[Array, Array]:
    """Normal equations with a random effect marginalised: their coefficients differ by N(0, Q = diag(std²))
    from those sought.

    Information ``M (I + Q M)⁻¹`` and vector ``(I + M Q)⁻¹ m``, by the eigenvalues of ``√Q M √Q``, which keeps
    the information positive semidefinite however unequal the columns' scales are.

    Parameters
    ----------
    information, vector : (…, n, n) and (…, n). std : (n,) of the random effect.
    """
    values, vectors = np.linalg.eigh(information * std * std[:, None])
    values = values.clip(0.0)[..., None, :]
    turned = np.swapaxes(vectors, -1, -2)
    wide = (vectors * (values / (1.0 + values))) @ turned / std / std[:, None]
    kept = ((vectors / (1.0 + values)) @ turned @ (vector * std)[..., None])[..., 0] / std
    return wide, kept


class NormalEquations(NamedTuple):
    """Of a balance in one frame: information (n, n) ``XᵀX/σ²`` and vector (n,) ``Xᵀy/σ²``, the number of rows
    behind them, and their variance σ²."""

    information: Array
    vector: Array
    rows: float
    variance: float
