"""Is a filter as good as it claims? Chi-square tests of its innovations and errors.

A filter is consistent when its errors are as large as its covariances say. For one step::

    NIS   = y' S^-1 y                    chi-square, dim z degrees of freedom
    NEES  = (x - x^)' P^-1 (x - x^)      chi-square, dim x; needs the truth, so simulation

and the mean over n independent steps or runs lies in [chi2(a/2, n dim), chi2(1-a/2, n dim)] / n
with probability 1 - a.

A NIS above its band says that the filter is too sure of itself, or the plant has changed; one
below, that its noise is set too large.

Source: Bar-Shalom, Li and Kirubarajan 2001, section 5.4, doi 10.1002/0471221279.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from estimators.linalg import Array


def nis_band(dim: int, n: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Band that the mean of ``n`` independent NIS (or NEES) values of a consistent filter falls in.

    Parameters
    ----------
    dim : degrees of freedom of each value: channels used for NIS, states for NEES.
    n : number of values in the mean.
    probability : of falling inside; ``1 - probability`` is the rate of false alarms.

    Returns
    -------
    low, high : in the units of NIS (none); the expected value is ``dim``.

    Raises
    ------
    ValueError : dim or n below 1, probability not between 0 and 1.

    Examples
    --------
    >>> low, high = nis_band(2, n=50)
    >>> round(low, 2), round(high, 2)
    (1.48, 2.59)
    """
    if not (dim >= 1 and n >= 1):
        raise ValueError(f"dim is {dim} and n is {n}; give at least 1 of each")
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability is {probability:g}; give a value between 0 and 1")
    from scipy.special import gammaincinv  # a quarter of a second that a diagnosis need not wait for

    shape = 0.5 * dim * n
    tail = 0.5 * (1.0 - probability)
    return float(2.0 * gammaincinv(shape, tail) / n), float(2.0 * gammaincinv(shape, 1.0 - tail) / n)


nees_band = nis_band
"""Of the mean NEES of n runs: successive values of one run are correlated, so count runs, not samples."""


def squared_distance(error: ArrayLike, covariance: ArrayLike) -> Array:
    """NEES or NIS of many steps at once: ``e' C^-1 e``.

    Parameters
    ----------
    error : (..., d) truth minus estimate, or innovations.
    covariance : (..., d, d) what the filter says of them; leading dimensions broadcast.

    Returns
    -------
    (...) array.

    Raises
    ------
    ValueError : shapes that do not fit, or a covariance that is not positive definite.

    Examples
    --------
    >>> squared_distance([[2.0, 0.0], [0.0, 3.0]], [[4.0, 0.0], [0.0, 1.0]]).tolist()
    [1.0, 9.0]
    """
    white = standardised(error, covariance)
    return np.asarray((white**2).sum(axis=-1))


def standardised(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Errors in units of their own standard deviation, decorrelated: ``L^-1 e`` with ``C = L L'``.

    Parameters and errors as in :func:`squared_distance`.

    Returns
    -------
    (..., d) array, N(0, I) for a consistent filter.

    Examples
    --------
    >>> standardised([3.0, 1.0], [[9.0, 0.0], [0.0, 4.0]]).tolist()
    [1.0, 0.5]
    """
    e, C = np.asarray(error, float), np.asarray(covariance, float)
    if e.ndim < 1 or C.ndim < 2 or C.shape[-2:] != (e.shape[-1], e.shape[-1]):
        raise ValueError(
            f"error {e.shape} and covariance {C.shape} do not fit; give (..., d) and (..., d, d)"
        )
    variance = np.diagonal(C, axis1=-2, axis2=-1)
    if not (variance > 0.0).all():
        raise ValueError("covariance has a variance that is not positive")
    scale = np.sqrt(variance)
    try:
        L = np.linalg.cholesky(C / (scale[..., :, None] * scale[..., None, :]))
    except np.linalg.LinAlgError:
        raise ValueError("covariance is not positive definite") from None
    return np.asarray(np.linalg.solve(L, (e / scale)[..., None])[..., 0])


@dataclass(frozen=True)
class BandTest:
    """Outcome of :func:`nis_test`: ``consistent`` when ``low <= mean <= high``."""

    mean: float
    low: float
    high: float
    n: int
    false_alarm_rate: float

    @property
    def consistent(self) -> bool:
        """True when the mean is inside the band."""
        return self.low <= self.mean <= self.high


def nis_test(nis: ArrayLike, dim: int | ArrayLike, probability: float = 0.95) -> BandTest:
    """Test the mean of recorded NIS values against its band.

    Parameters
    ----------
    nis : (n,) values; those with ``dim`` 0 (no channel measured) are left out.
    dim : degrees of freedom, one for all or one for each (``channels_used``).
    probability : of passing when the filter is consistent.

    Raises
    ------
    ValueError : no values, NaN among them, or shapes that do not fit.

    Examples
    --------
    >>> outcome = nis_test([1.2, 0.1, 2.5, 0.4], dim=1)
    >>> outcome.consistent, round(outcome.mean, 2), round(outcome.high, 2)
    (True, 1.05, 2.79)
    """
    values = np.asarray(nis, float).reshape(-1)
    degrees = np.asarray(dim, float).reshape(-1)
    if degrees.size not in (1, values.size):
        raise ValueError(f"dim has {degrees.size} values for {values.size} of nis; give one, or as many")
    degrees = np.broadcast_to(degrees, values.shape)
    values, degrees = values[degrees > 0], degrees[degrees > 0]
    if values.size == 0 or np.isnan(values).any():
        raise ValueError(
            f"nis has {values.size} values, {int(np.isnan(values).sum())} of them NaN; give numbers"
        )
    n = values.size
    total = int(degrees.sum())
    # The sum of independent chi-squares has the sum of their degrees of freedom.
    low, high = nis_band(total, 1, probability)
    return BandTest(float(values.mean()), low / n, high / n, n, 1.0 - probability)
