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


def fit_over_time(time: Array, factors: Array, stds: Array, warmth: Array, *, leaks: bool) -> Fitted:
    """A line through factors of the healthy value, temperature taken out the way that is likelier.

    The ways are compared by their likelihood of the same data, corrected for the one parameter more and few
    logs (AICc).

    Parameters
    ----------
    time : (n,). factors, stds : (n,), over the healthy value at each log's own temperature. warmth : (n,), by
        `covariate`. leaks : whether the quantity goes with viscosity, so that the factors are free of it.
    """
    n = time.size
    plain = np.column_stack([np.ones(n), time])
    known = bool(np.ptp(warmth) > 0.0)
    law = Fitted(fit_line(factors, stds, plain), factors, stds, "viscosity law", None)
    if not leaks or not known:
        law = Fitted(law.line, factors, stds, "not taken out", None)
    if n < LEAST_LOGS or float(np.std(warmth)) < LEAST_SPREAD:
        return law
    scale = np.exp(warmth) if leaks else np.ones(n)
    raw, raw_stds = factors * scale, stds * scale
    line = fit_line(raw, raw_stds, np.column_stack([plain, warmth]))
    # The law's likelihood of the raw values: a density stretched by the scale. Scale and τ count in both.
    gain = line.log_likelihood - (law.line.log_likelihood - float(np.log(scale).sum()))
    if gain > _penalty(n, 5) - _penalty(n, 4):
        return Fitted(line, raw - line.coefficients[2] * warmth, raw_stds, "regression", gain)
    return Fitted(law.line, factors, stds, law.way, -gain)


def _penalty(n: int, parameters: int) -> float:
    return parameters * n / max(n - parameters - 1, 1)
