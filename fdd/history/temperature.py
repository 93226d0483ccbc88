"""Temperature taken out of estimates, by the oil's viscosity law or by what the logs themselves tell.

An answer's healthy leakage is that at its log's oil temperature: its logarithm is the covariate, straight
enough over the temperature (4 % a kelvin), and needs no profile.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fdd.history.line import Line, fit_line

Array = NDArray[np.float64]
Way = Literal["viscosity law", "regression", "not taken out"]

LEAST_LOGS = 8
"""From which on a regression on temperature is tried."""
LEAST_SPREAD = 0.06
"""Std of the covariate below which the logs have one temperature: 1.5 K."""


@dataclass(frozen=True)
class Fitted:
    """A line whose values are at one temperature.

    Attributes
    ----------
    line : of intercept, slope and, with a regression, what goes with the temperature. values, stds : (n,).
    way : how temperature was taken out. gain : log likelihood over the other way; None without choice.
    """

    line: Line
    values: Array
    stds: Array
    way: Way
    gain: float | None


def covariate(healthy_leakage: Array) -> Array:
    """ln of each log's healthy leakage over their median's (n,): 0 for all where none tells a temperature."""
    return np.asarray(np.log(healthy_leakage / np.median(healthy_leakage)))


def fit_over_time(
    time: Array, factors: Array, stds: Array, warmth: Array, between: float, *, leaks: bool
) -> Fitted:
    """A line through factors of the healthy value, temperature taken out the way that is likelier.

    The ways are compared by their likelihood of the same data, corrected for the one parameter more and few
    logs (AICc).

    Parameters
    ----------
    time : (n,). factors, stds : (n,), over the healthy value at each log's own temperature. warmth : (n,), by
        `covariate`. between : what healthy logs differ by, see `fit_line`.
    leaks : whether the quantity goes with viscosity, so that the factors are free of it.
    """
    n = time.size
    plain = np.column_stack([np.ones(n), time])
    line = fit_line(factors, stds, plain, between)
    way: Way = "viscosity law" if leaks and np.ptp(warmth) > 0.0 else "not taken out"
    if n < LEAST_LOGS or float(np.std(warmth)) < LEAST_SPREAD:
        return Fitted(_scaled(line, factors, stds, plain), factors, stds, way, None)
    scale = np.exp(warmth) if leaks else np.ones(n)
    raw, raw_stds, design = factors * scale, stds * scale, np.column_stack([plain, warmth])
    other = fit_line(raw, raw_stds, design, between)
    # The law's likelihood of the raw values: a density stretched by the scale. Scale and τ count in both.
    gain = other.log_likelihood - (line.log_likelihood - float(np.log(scale).sum()))
    if gain > _penalty(n, 5) - _penalty(n, 4):
        values = raw - other.coefficients[2] * warmth
        return Fitted(_scaled(other, raw, raw_stds, design), values, raw_stds, "regression", gain)
    return Fitted(_scaled(line, factors, stds, plain), factors, stds, way, -gain)


def _scaled(line: Line, values: Array, stds: Array, design: Array) -> Line:
    """The line, with the scale that all logs share: what their filters say, less what they scatter by."""
    rest = (values - design @ line.coefficients) / stds
    scatter = float(rest @ rest) / line.freedom
    return line.of_one_scale(float(np.sqrt(np.median(np.square(stds / values)) * max(1.0 - scatter, 0.0))))


def _penalty(n: int, parameters: int) -> float:
    return parameters * n / max(n - parameters - 1, 1)
