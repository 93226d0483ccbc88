"""A straight line through estimates that err each by its own standard deviation, and by what no filter knows.

``y_i = X_i b + u_i + e_i`` with ``e_i ~ N(0, s_i²)`` and ``u_i ~ N(0, τ²)`` from log to log. τ² is found by
restricted maximum likelihood. Intervals are those of Knapp and Hartung (doi:10.1002/sim.2514): Student's t,
scaled by how the logs scatter about the line. A filter's s_i also holds what all logs of a unit have in
common (its pump's gain); then they scatter by less, and `Line.of_one_scale` puts it back.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """Coefficients and what they are worth.

    Attributes
    ----------
    coefficients : (p,). covariance : (p, p). between : τ, std from log to log. freedom : of Student's t.
    log_likelihood : the largest there is over coefficients and scale, to compare designs by.
    """

    coefficients: Array
    covariance: Array
    between: float
    freedom: int
    log_likelihood: float

    def interval(self, place: int, share: float = 0.95) -> tuple[float, float]:
        """Interval that holds a coefficient with probability `share`."""
        half = float(student.ppf(0.5 + 0.5 * share, self.freedom)) * self._std(place)
        middle = float(self.coefficients[place])
        return middle - half, middle + half

    def p_value(self, place: int) -> float:
        """Two-sided, of a coefficient that is zero."""
        return float(2.0 * student.sf(abs(self.coefficients[place]) / self._std(place), self.freedom))

    def band(self, design: Array, share: float = 0.95) -> tuple[Array, Array]:
        """The line (m,) and half the width (m,) of its interval at rows (m, p) of a design."""
        half = student.ppf(0.5 + 0.5 * share, self.freedom)
        spread = np.sqrt(np.einsum("ij,jk,ik->i", design, self.covariance, design))
        return design @ self.coefficients, half * spread

    def crossing(self, level: float, share: float = 0.8) -> tuple[float, float, float] | None:
        """Where ``b0 + b1 t`` is `level`, with Fieller's interval; None where that has no end.

        Parameters
        ----------
        level : of y. share : that the interval holds.

        Returns
        -------
        t, and the least and greatest t.
        """
        b0, b1 = (float(b) for b in self.coefficients[:2])
        q = float(student.ppf(0.5 + 0.5 * share, self.freedom)) ** 2
        v = self.covariance
        # (level - b0 - b1 t)² = q (v00 + 2 v01 t + v11 t²)
        square = b1 * b1 - q * v[1, 1]
        linear = b1 * (b0 - level) - q * v[0, 1]
        constant = (b0 - level) ** 2 - q * v[0, 0]
        root = linear * linear - square * constant
        if square <= 0.0 or root < 0.0:
            return None
        low, high = (-linear - np.sqrt(root)) / square, (-linear + np.sqrt(root)) / square
        return (level - b0) / b1, float(low), float(high)

    def of_one_scale(self, relative: float) -> Line:
        """The line where all values share a scale that is uncertain by `relative` (one standard deviation).

        A slope of 0 is one on any scale: its test is what it was.
        """
        shared = relative**2 * np.outer(self.coefficients, self.coefficients)
        return replace(self, covariance=self.covariance + shared)

    def _std(self, place: int) -> float:
        return float(np.sqrt(self.covariance[place, place]))


def fit_line(values: Array, stds: Array, design: Array, between: float = 0.0) -> Line:
    """The line through estimates of n logs.

    Parameters
    ----------
    values, stds : (n,). design : (n, p), of full rank, p < n. between : the least τ. Of a few logs it is
        often found to be 0; the one that says it knows best then bends the line, and of level lines a test at
        5 % rejects up to 15 %.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 9)
    >>> line = fit_line(1.0 + 2.0 * t, np.full(9, 0.1), np.column_stack([np.ones(9), t]))
    >>> line.coefficients.round(6).tolist(), line.freedom, round(line.between, 3)
    ([1.0, 2.0], 7, 0.0)
    """
    n, p = design.shape
    variance = np.square(stds)
    plain = np.linalg.lstsq(design, values, rcond=None)[0]
    most = float(np.square(values - design @ plain).sum()) / (n - p) + float(variance.max())

    def loss(square: float) -> float:
        return -_restricted(values, variance + square, design)

    found = minimize_scalar(
        lambda u: loss(most * np.exp(u)), bounds=(-14.0, 3.0), method="bounded", options={"xatol": 1e-4}
    )
    square = 0.0 if loss(0.0) <= found.fun else float(most * np.exp(found.x))
    square = max(square, between**2)
    variance = variance + square
    covariance = np.linalg.inv(design.T @ (design / variance[:, None]))
    coefficients = covariance @ (design.T @ (values / variance))
    # A line without any scatter is a made-up one: its interval still has a width.
    scale = max(float((np.square(values - design @ coefficients) / variance).sum()) / (n - p), 1e-9)
    likely = -0.5 * (n * np.log(2.0 * np.pi * scale * (n - p) / n) + np.log(variance).sum() + n)
    return Line(coefficients, scale * covariance, float(np.sqrt(square)), n - p, float(likely))


def _restricted(values: Array, variance: Array, design: Array) -> float:
    """Restricted log likelihood, but for a constant."""
    gram = design.T @ (design / variance[:, None])
    rest = values - design @ np.linalg.solve(gram, design.T @ (values / variance))
    spread = np.log(variance).sum() + np.linalg.slogdet(gram)[1]
    return float(-0.5 * (spread + (np.square(rest) / variance).sum()))


def holm(p_values: list[float]) -> list[float]:
    """p values made larger for how many there are, by Holm's step-down rule."""
    order = np.argsort(p_values)
    least, out = 0.0, [0.0] * len(p_values)
    for rank, k in enumerate(order):
        least = max(least, min((len(p_values) - rank) * p_values[k], 1.0))
        out[k] = least
    return out
