"""A straight line through estimates that err each by its own standard deviation, and by what no filter knows.

``y_i = X_i b + u_i + e_i`` with ``e_i ~ N(0, s_i²)`` and ``u_i ~ N(0, τ²)`` from log to log. τ² is found by
restricted maximum likelihood. Intervals are those of Knapp and Hartung (doi:10.1002/sim.2514): Student's t,
scaled by how the logs scatter about the line. A filter's s_i also holds what all logs of a unit have in
common (its pump's gain); then they scatter by less, and `fit_over_time` puts it back.

Temperature is taken out by the oil's viscosity law or by what the logs themselves tell. An answer's healthy
leakage is that at its log's oil temperature: its logarithm is the covariate, straight enough over the
temperature (4 % a kelvin), and needs no profile.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

Array = NDArray[np.float64]
Way = Literal["viscosity law", "regression", "not taken out"]

LEAST_LOGS = 8
"""From which on a regression on temperature is tried."""
LEAST_SPREAD = 0.06
"""Std of the covariate below which the logs have one temperature: 1.5 K."""


@dataclass(frozen=True)
class Line:
    """Coefficients (p,) and what they are worth."""

    coefficients: Array
    covariance: Array
    between: float
    """τ, std from log to log."""
    freedom: int
    log_likelihood: float
    """The largest there is over coefficients and scale, to compare designs by."""

    def interval(self, place: int, share: float = 0.95) -> tuple[float, float]:
        """Interval that holds a coefficient with probability `share`."""
        std = float(np.sqrt(self.covariance[place, place]))
        low, high = student.interval(share, self.freedom, self.coefficients[place], std)
        return float(low), float(high)

    def p_value(self, place: int) -> float:
        """Two-sided, of a coefficient that is zero."""
        std = float(np.sqrt(self.covariance[place, place]))
        return float(2.0 * student.sf(abs(self.coefficients[place]) / std, self.freedom))

    def band(self, design: Array, share: float = 0.95) -> tuple[Array, Array]:
        """The line (m,) and half the width (m,) of its interval at rows (m, p) of a design."""
        half = student.ppf(0.5 + 0.5 * share, self.freedom)
        spread = np.sqrt(np.einsum("ij,jk,ik->i", design, self.covariance, design))
        return design @ self.coefficients, half * spread

    def crossing(self, level: float, share: float = 0.8) -> tuple[float, float, float] | None:
        """Where ``b0 + b1 t`` is `level`, and the least and the greatest t of Fieller's interval, which holds
        `share`; None where that has no end."""
        b0, b1 = (float(b) for b in self.coefficients[:2])
        q = float(student.ppf(0.5 + 0.5 * share, self.freedom)) ** 2
        v = self.covariance
        # (level - b0 - b1 t)² = q (v00 + 2 v01 t + v11 t²)
        square = b1 * b1 - q * v[1, 1]
        linear = b1 * (b0 - level) - q * v[0, 1]
        root = linear * linear - square * ((b0 - level) ** 2 - q * v[0, 0])
        if square <= 0.0 or root < 0.0:
            return None
        low, high = (-linear - np.sqrt(root)) / square, (-linear + np.sqrt(root)) / square
        return (level - b0) / b1, float(low), float(high)


def fit_line(values: Array, stds: Array, design: Array, between: float = 0.0) -> Line:
    """The line through estimates (n,) of n logs; `design` (n, p) is of full rank, p < n.

    `between` is the least τ. Of a few logs it is often found to be 0; the one that says it knows best then
    bends the line, and of level lines a test at 5 % rejects up to 15 %.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 9)
    >>> line = fit_line(1.0 + 2.0 * t, np.full(9, 0.1), np.column_stack([np.ones(9), t]))
    >>> line.coefficients.round(6).tolist(), line.freedom, round(line.between, 3)
    ([1.0, 2.0], 7, 0.0)
    """
    n, p = design.shape
    own = np.square(stds)
    plain = np.linalg.lstsq(design, values, rcond=None)[0]
    most = float(np.square(values - design @ plain).sum()) / (n - p) + float(own.max())

    def loss(square: float) -> float:
        """-2 restricted log likelihood over 2, but for a constant."""
        variance = own + square
        gram = design.T @ (design / variance[:, None])
        rest = values - design @ np.linalg.solve(gram, design.T @ (values / variance))
        spread = np.log(variance).sum() + np.linalg.slogdet(gram)[1]
        return float(0.5 * (spread + (np.square(rest) / variance).sum()))

    found = minimize_scalar(
        lambda u: loss(most * np.exp(u)), bounds=(-14.0, 3.0), method="bounded", options={"xatol": 1e-4}
    )
    square = 0.0 if loss(0.0) <= found.fun else float(most * np.exp(found.x))
    square = max(square, between**2)
    variance = own + square
    covariance = np.linalg.inv(design.T @ (design / variance[:, None]))
    coefficients = covariance @ (design.T @ (values / variance))
    # A line without any scatter is a made-up one: its interval still has a width.
    scale = max(float((np.square(values - design @ coefficients) / variance).sum()) / (n - p), 1e-9)
    likely = -0.5 * (n * np.log(2.0 * np.pi * scale * (n - p) / n) + np.log(variance).sum() + n)
    return Line(coefficients, scale * covariance, float(np.sqrt(square)), n - p, float(likely))


@dataclass(frozen=True)
class Fitted:
    """A line whose values, (n,), are at one temperature."""

    line: Line
    """Of intercept, slope and, with a regression, what goes with the temperature."""
    values: Array
    stds: Array
    way: Way
    gain: float | None
    """Log likelihood over the other way to take temperature out; None without choice."""


def fit_over_time(
    time: Array, factors: Array, stds: Array, warmth: Array, between: float, *, leaks: bool
) -> Fitted:
    """A line through factors of the healthy value, temperature taken out the way that is likelier.

    The ways are compared by their likelihood of the same data, corrected for the one parameter more and few
    logs (AICc).

    `factors` and `stds` are over the healthy value at each log's own temperature; `warmth` is ln of each
    log's healthy leakage over their median's, (n,) each. `between` is what healthy logs differ by, see
    `fit_line`. What `leaks` goes with viscosity, so that the factors are free of it.
    """
    n = time.size
    plain = np.column_stack([np.ones(n), time])

    def scaled(line: Line, values: Array, stds: Array, design: Array) -> Line:
        """With the scale that all logs share: what their filters say, less what they scatter by. A slope of 0
        is one on any scale: its test is what it was."""
        rest = (values - design @ line.coefficients) / stds
        scatter = float(rest @ rest) / line.freedom
        relative = float(np.sqrt(np.median(np.square(stds / values)) * max(1.0 - scatter, 0.0)))
        shared = relative**2 * np.outer(line.coefficients, line.coefficients)
        return replace(line, covariance=line.covariance + shared)

    line = fit_line(factors, stds, plain, between)
    way: Way = "viscosity law" if leaks and np.ptp(warmth) > 0.0 else "not taken out"
    gain = None
    if n >= LEAST_LOGS and float(np.std(warmth)) >= LEAST_SPREAD:
        scale = np.exp(warmth) if leaks else np.ones(n)
        raw, raw_stds, design = factors * scale, stds * scale, np.column_stack([plain, warmth])
        other = fit_line(raw, raw_stds, design, between)
        # The law's likelihood of the raw values: a density stretched by the scale. Scale and τ count in both.
        gain = other.log_likelihood - (line.log_likelihood - float(np.log(scale).sum()))
        four, five = (k * n / max(n - k - 1, 1) for k in (4, 5))
        if gain > five - four:
            values = raw - other.coefficients[2] * warmth
            return Fitted(scaled(other, raw, raw_stds, design), values, raw_stds, "regression", gain)
    return Fitted(scaled(line, factors, stds, plain), factors, stds, way, None if gain is None else -gain)


def holm(p_values: list[float]) -> list[float]:
    """p values made larger for how many there are, by Holm's step-down rule."""
    least, out = 0.0, [0.0] * len(p_values)
    for rank, k in enumerate(np.argsort(p_values)):
        least = max(least, min((len(p_values) - rank) * p_values[k], 1.0))
        out[k] = least
    return out
