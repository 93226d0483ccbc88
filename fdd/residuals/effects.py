"""How a healthy unit's coefficients lie, and how they err: random effects between logs, within a log, and
from hop to hop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.residuals.balances import BALANCES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Effects:
    """Random effects of one balance's coefficients, (n,) each.

    Attributes
    ----------
    mean : of the healthy unit. covariance : (n, n), of a log about the mean, and of the mean itself.
        between : std from log to log. within : std of what changes in some minutes of a healthy log and no
        sensor tells; assumed: a magnet loses 0.1 % of its torque a kelvin and warms by 20, a position
        transducer 0.01 to 0.03 % of its gain a kelvin. wander : std from hop to hop. noise : std of a row, a
        first guess. information, scatter : (n, n), of healthy logs, and of the scores of their stretches of
        2 s.
    """

    mean: Array
    covariance: Array
    between: Array
    within: Array
    wander: Array
    noise: float
    information: Array
    scatter: Array


_PRIOR: dict[str, tuple[float, dict[str, tuple[float, float, float, float, float]]]] = {
    # healthy mean, spread of units about it, between logs, within a log, hop to hop
    "volume": (1e-8, {
        "gain": (0.0, 0.05, 0.002, 0.003, 0.001), "compliance": (1.0, 0.4, 0.16, 0.009, 0.05),
        "air": (0.0, 0.15, 0.2, 0.006, 0.025), "lag": (0.0, 0.1, 0.06, 0.006, 0.025),
        "sensor_lag": (0.0, 0.2, 0.1, 0.006, 0.025), "density": (0.5, 0.3, 0.1, 0.009, 0.05),
        "leak": (1.0, 0.6, 0.2, 0.015, 0.075), "leak_square": (0.0, 0.2, 0.1, 0.015, 0.05),
        "case": (0.15, 0.3, 0.1, 0.009, 0.05), "wear": (0.0, 0.2, 0.2, 0.015, 0.05),
        "relief_12": (0.0, 0.005, 0.004, 0.0006, 0.002), "relief_21": (0.0, 0.005, 0.004, 0.0006, 0.002),
        "valve_1": (0.0, 0.005, 0.004, 0.0006, 0.002), "valve_2": (0.0, 0.005, 0.004, 0.0006, 0.002),
        "outside_1": (0.0, 0.05, 0.04, 0.006, 0.02), "outside_2": (0.0, 0.05, 0.04, 0.006, 0.02)}),
    "force": (0.1, {
        "load": (0.0, 50.0, 60.0, 3.0, 0.15), "spring": (0.0, 50.0, 100.0, 1.5, 0.15),
        "mass": (0.05, 0.3, 2.0, 0.006, 0.025),
        "damping": (0.0, 0.3, 0.6, 0.015, 0.05), "throttle": (0.0, 0.3, 20.0, 0.015, 0.05),
        "friction_forward": (1.0, 0.5, 0.3, 0.015, 0.05), "friction_reverse": (1.0, 0.5, 0.3, 0.015, 0.05)}),
    "torque": (1e-4, {
        "zero": (0.0, 0.01, 0.002, 0.00015, 0.0015), "pressure": (1.0, 0.3, 0.04, 0.02, 0.01),
        "inertia": (1.0, 0.3, 0.02, 0.02, 0.01), "dry": (0.02, 0.03, 0.008, 0.0003, 0.0015),
        "viscous": (0.02, 0.03, 0.02, 0.0009, 0.005), "mesh": (0.03, 0.05, 0.02, 0.0009, 0.005)}),
    "shaft": (0.01, {
        "order_1": (0.003, 0.01, 0.004, 0.0003, 0.002), "order_2": (0.003, 0.01, 0.004, 0.0003, 0.002)}),
    "coherence": (0.002, {
        "zero": (0.0, 0.01, 0.002, 0.00006, 0.00025), "gain_1": (0.0, 0.02, 0.004, 0.00015, 0.001),
        "gain_2": (0.0, 0.02, 0.004, 0.00015, 0.001), "line": (0.0, 0.02, 0.004, 0.00015, 0.001),
        "line_square": (0.0, 0.02, 0.006, 0.0003, 0.0015)}),
    "refeed": (0.002, {
        "drop_1": (0.003, 0.005, 0.001, 0.00015, 0.0005), "drop_2": (0.003, 0.005, 0.001, 0.00015, 0.0005),
        "flow_1": (0.0, 0.01, 0.004, 0.0006, 0.002), "flow_2": (0.0, 0.01, 0.004, 0.0006, 0.002)}),
    "reservoir": (1e-3, {
        "drift": (0.0, 0.03, 0.04, 0.003, 0.015),
        "outside_1": (0.0, 0.03, 0.04, 0.003, 0.015), "outside_2": (0.0, 0.03, 0.04, 0.003, 0.015),
        "held": (1.0, 0.5, 0.2, 0.009, 0.1), "rod": (1.0, 0.3, 0.2, 0.009, 0.1),
        "stroke": (0.0, 0.1, 0.08, 0.006, 0.03)}),
}  # fmt: skip


def first_effects(name: str) -> Effects:
    """Effects of a unit of which only the data sheet is known."""
    noise, table = _PRIOR[name]
    mean, spread, between, within, wander = np.array([table[c] for c in BALANCES[name].columns]).T
    none = np.zeros((mean.size, mean.size))
    return Effects(mean, np.diag(spread**2 + between**2), between, within, wander, noise, none, none)
