"""What healthy logs differ by, and stretches scatter by, as Student's t."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fdd.diagnosis.fitting import BalancePosterior, Parts

Array = NDArray[np.float64]

STUDENT = 4.0
"""Degrees of freedom of Student's t of what a unit's healthy logs differ by, and of the scores of its healthy
stretches. The likeliest are 3 to 7, by balance, for logs that the spreads were not learnt from (140 simulated
units), and 4 for stretches (25 of them). Lange, Little and Taylor 1989 (doi
10.1080/01621459.1989.10478852) take 4 where nothing is known."""


def unusual(balances: Mapping[str, BalancePosterior], parts: Parts, overdispersion: Array) -> Array:
    """Excess (f,) of a log's variance about its unit over the usual one, by the directions of the
    coefficients in which no fault acts.

    What logs differ by is a multivariate Student's t: one that is unusual is so in all directions. The
    variance is the posterior mean of its scale, and no less than usual.
    """
    square, count = np.zeros((2, len(parts.signed)))
    for name, columns in parts.columns.items():
        e, mine = balances[name], np.flatnonzero(columns[:, 0].any(axis=1))
        root = np.linalg.cholesky(e.healthy.covariance)
        told, turned = np.linalg.eigh(root.T @ e.total @ root)
        basis = root @ turned / np.sqrt(told.clip(1e-9) * (1.0 + told.clip(1e-9)))
        weight = told.clip(0.0) / (1.0 + told.clip(0.0))
        off = (e.rest.sum(axis=0) + e.total @ (e.solution - e.healthy.mean)) @ basis
        acting = parts.time_profiles[mine] @ e.information.reshape(len(e.information), -1)
        acting = acting.reshape(*acting.shape[:2], *e.total.shape)
        sums = np.einsum("fpij,fpj->fpi", acting, columns[mine]) @ basis
        _, size, q = np.linalg.svd(sums, full_matrices=False)
        q = np.where(size[..., None] > 1e-9 * size[:, :1, None], q, 0.0)
        left = off - np.einsum("fpi,fp->fi", q, q @ off)
        square[mine] += np.square(left) @ weight
        count[mine] += weight.sum() - np.square(q).sum(axis=1) @ weight
    square /= 1.0 + overdispersion
    return np.asarray(np.maximum(square - count, 0.0) / (STUDENT + count))


def freedom(healthy: Array, blocks: Array) -> Array:
    """Degrees of freedom (f,) of amplitudes, by Welch's formula (1947, doi 10.1093/biomet/34.1-2.28).

    Parameters
    ----------
    healthy : share of the variance that is what healthy logs differ by; the rest is noise. blocks : effective
        number of stretches behind the amplitude: many make it normal, one alone may be a singular event, as a
        machine's start is.
    """
    noise = np.square(1.0 - healthy) / np.maximum(blocks, 1.0)
    return np.asarray(STUDENT / np.maximum(np.square(healthy) + noise, 1e-6))


def heavy_tailed(ratio: Array, freedom: Array) -> Array:
    """Log likelihood ratio (f,) by Student's t of what is `ratio` by a normal of the same scale."""
    return np.asarray(0.5 * (freedom + 1.0) * np.log1p(2.0 * np.maximum(ratio, 0.0) / freedom))


def as_normal(ratio: Array, freedom: Array) -> Array:
    """Inverse of `heavy_tailed`."""
    return np.asarray(0.5 * freedom * np.expm1(np.minimum(2.0 * ratio / (freedom + 1.0), 700.0)))


def log_normal(z: float) -> float:
    """Logarithm of the normal distribution function; `scipy.special` takes a quarter of a second to import.

    Examples
    --------
    >>> round(log_normal(0.0), 6), round(log_normal(-50.0), 3)
    (-0.693147, -1254.831)
    """
    if z > 0.0:
        return math.log1p(-0.5 * math.erfc(z / math.sqrt(2.0)))
    if z > -30.0:
        return math.log(0.5 * math.erfc(-z / math.sqrt(2.0)))
    r = 1.0 / z**2  # the asymptotic series: erfc is too small to be written from here on
    return -0.5 * z**2 - math.log(-z * math.sqrt(2.0 * math.pi)) + math.log1p(-r * (1 - r * (3 - 15 * r)))
