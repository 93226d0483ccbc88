"""What the fits share: estimates, least squares that outliers do not decide, the jackknife."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation, both SI."""

    value: float
    std: float

    @property
    def relative(self) -> float:
        """Standard deviation over value."""
        return self.std / abs(self.value) if self.value else float("inf")

    def wider(self, share: float) -> Estimate:
        """With `share` of the value, another standard deviation, beside its own."""
        return Estimate(self.value, float(np.hypot(self.std, share * self.value)))


def huber(
    m: Array, y: Array, limit: float, *, rounds: int = 10, least: float = 0.0, rcond: float | None = None
) -> tuple[Array, Array]:
    """Least squares with a Huber loss, by reweighting: (k,) solution, (n,) square roots of the weights.

    Parameters
    ----------
    m, y : (n, k) and (n,). limit : robust standard deviations from which a residual counts less.
    least : standard deviation, as `y`, that is there in any case. rcond : of `numpy.linalg.lstsq`.
    """
    largest = np.abs(m).max(axis=0)
    scale = np.where(largest > 0.0, largest, 1.0)
    scaled, weights = m / scale, np.ones(y.size)
    for _ in range(rounds):
        theta = np.linalg.lstsq(scaled * weights[:, None], y * weights, rcond=rcond)[0]
        residual = np.abs(y - scaled @ theta)
        sigma = 1.4826 * np.median(residual) + least
        weights = np.sqrt(np.minimum(1.0, limit * sigma / np.maximum(residual, 1e-30)))
    return theta / scale, weights


def jackknife_std(parts: Array) -> Array:
    """Standard deviation of an estimate from (n, ...) ones that each lack one of n groups.

    Examples
    --------
    >>> values = np.array([1.0, 2.0, 6.0])
    >>> means = np.array([np.delete(values, k).mean() for k in range(3)])
    >>> bool(np.isclose(jackknife_std(means), values.std(ddof=1) / np.sqrt(3)))
    True
    """
    n = len(parts)
    return np.asarray(np.sqrt((n - 1) / n * np.sum((parts - parts.mean(axis=0)) ** 2, axis=0)))
