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
        between : std from
    log to log. within : std of a change within a healthy log, between the time before and after any moment.
    wander : std
    from hop to hop. noise : std of a row, a first guess. information, scatter : (n, n), of healthy logs,
    and of the scores of their stretches of 2 s.
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
        "gain": (0.0, 0.05, 0.001, 0.0005, 0.002), "compliance": (1.0, 0.4, 0.08, 0.03, 0.1),
        "air": (0.0, 0.15, 0.1, 0.02, 0.05), "lag": (0.0, 0.1, 0.03, 0.02, 0.05),
        "sensor_lag": (0.0, 0.2, 0.05, 0.02, 0.05), "density": (0.5, 0.3, 0.05, 0.03, 0.1),
        "leak": (1.0, 0.6, 0.1, 0.05, 0.15), "leak_square": (0.0, 0.2, 0.05, 0.05, 0.1),
        "case": (0.15, 0.3, 0.05, 0.03, 0.1), "wear": (0.0, 0.2, 0.1, 0.05, 0.1),
        "relief_12": (0.0, 0.005, 0.002, 0.002, 0.004), "relief_21": (0.0, 0.005, 0.002, 0.002, 0.004),
        "valve_1": (0.0, 0.005, 0.002, 0.002, 0.004), "valve_2": (0.0, 0.005, 0.002, 0.002, 0.004),
        "outside_1": (0.0, 0.05, 0.02, 0.02, 0.04), "outside_2": (0.0, 0.05, 0.02, 0.02, 0.04)}),
    "force": (0.1, {
        "load": (0.0, 50.0, 30.0, 10.0, 0.3), "spring": (0.0, 50.0, 50.0, 5.0, 0.3),
        "mass": (0.05, 0.3, 1.0, 0.02, 0.05),
        "damping": (0.0, 0.3, 0.3, 0.05, 0.1), "throttle": (0.0, 0.3, 10.0, 0.05, 0.1),
        "friction_forward": (1.0, 0.5, 0.15, 0.05, 0.1), "friction_reverse": (1.0, 0.5, 0.15, 0.05, 0.1)}),
    "torque": (1e-4, {
        "zero": (0.0, 0.01, 0.001, 0.0005, 0.003), "pressure": (1.0, 0.3, 0.02, 0.005, 0.02),
        "inertia": (1.0, 0.3, 0.01, 0.01, 0.02), "dry": (0.02, 0.03, 0.004, 0.001, 0.003),
        "viscous": (0.02, 0.03, 0.01, 0.003, 0.01), "mesh": (0.03, 0.05, 0.01, 0.003, 0.01)}),
    "shaft": (0.01, {
        "order_1": (0.003, 0.01, 0.002, 0.001, 0.004), "order_2": (0.003, 0.01, 0.002, 0.001, 0.004)}),
    "coherence": (0.002, {
        "zero": (0.0, 0.01, 0.001, 0.0002, 0.0005), "gain_1": (0.0, 0.02, 0.002, 0.0005, 0.002),
        "gain_2": (0.0, 0.02, 0.002, 0.0005, 0.002), "line": (0.0, 0.02, 0.002, 0.0005, 0.002),
        "line_square": (0.0, 0.02, 0.003, 0.001, 0.003)}),
    "refeed": (0.002, {
        "drop_1": (0.003, 0.005, 0.0005, 0.0005, 0.001), "drop_2": (0.003, 0.005, 0.0005, 0.0005, 0.001),
        "flow_1": (0.0, 0.01, 0.002, 0.002, 0.004), "flow_2": (0.0, 0.01, 0.002, 0.002, 0.004)}),
    "reservoir": (1e-3, {
        "drift": (0.0, 0.03, 0.02, 0.01, 0.03),
        "outside_1": (0.0, 0.03, 0.02, 0.01, 0.03), "outside_2": (0.0, 0.03, 0.02, 0.01, 0.03),
        "held": (1.0, 0.5, 0.1, 0.03, 0.2), "rod": (1.0, 0.3, 0.1, 0.03, 0.2),
        "stroke": (0.0, 0.1, 0.04, 0.02, 0.06)}),
}  # fmt: skip


def first_effects(name: str) -> Effects:
    """Effects of a unit of which only the data sheet is known."""
    noise, table = _PRIOR[name]
    mean, spread, between, within, wander = np.array([table[c] for c in BALANCES[name].columns]).T
    # Within a log a healthy unit changes less than it differs between logs: the sandwich sees the rest.
    none = np.zeros((mean.size, mean.size))
    return Effects(mean, np.diag(spread**2 + between**2), between, 0.3 * within, wander, noise, none, none)
