"""Whether the steps are short enough: against steps half as long, and against a reference solver.

A difference counts against what a sensor cannot see: the root mean square of its white noise and of its
rounding, LSB/√12. For the encoders, which have no noise, that is LSB/√12 alone. Differences are those of the
true quantities, before any sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evidence.plant.cases import Case
from evidence.plant.peers import integrate
from fdd.plant import state as s
from fdd.unit import Unit

Array = NDArray[np.float64]

GAINED = "pump_angle in 1 s"
"""The angle gained in a second: accumulated, the angle is an integral that no loop closes, and errors of each
corner that a step runs over add up like a random walk."""


def unseen(unit: Unit, channel: str) -> float:
    """What a sensor cannot see (SI): rms of its noise and of its rounding.

    Examples
    --------
    >>> round(unseen(Unit.load("axis_a"), "position") * 1e9)
    289
    """
    sensor = unit.sensor(channel)
    return float(np.hypot(sensor.noise, sensor.resolution / np.sqrt(12.0)))


@dataclass(frozen=True)
class Difference:
    """How far two runs of a case lie apart, for each channel over `unseen`.

    Attributes
    ----------
    case : its name.
    rms, most : channel to root mean square and largest difference.
    first_count : s at which the loop's encoder first showed another count; NaN where it never did.
    """

    case: str
    rms: dict[str, float]
    most: dict[str, float]
    first_count: float = np.nan

    @property
    def worst(self) -> float:
        """Largest of the root mean squares, but for the angle's, which see."""
        return max(value for channel, value in self.rms.items() if channel not in ("pump_angle", GAINED))


def sensed(states: Array, found: Array | None, axis: int = 0) -> dict[str, Array]:
    """The quantities behind the sensors of an axis, from states (n, …) and findings."""
    own = states[:, s.SHARED + axis * s.AXIS_STATES :]
    out = {
        "position": states[:, s.X],
        "pump_angle": own[:, s.ANGLE],
        "pump_speed": own[:, s.SPEED],
        "pressure_difference": own[:, s.P1] - own[:, s.P2],
        "motor_current": own[:, s.CURRENT],
    }
    if states.shape[0] > 1000:
        out[GAINED] = own[1000:, s.ANGLE] - own[:-1000, s.ANGLE]
    if found is not None:
        out["pressure_accumulator"] = found[:, axis * s.FINDINGS + s.ACCUMULATOR]
    return out


def against_half_steps(case: Case, duration: float) -> Difference:
    """The case's usual run against steps half as long."""
    usual, halved = (case.states(duration, refine) for refine in (1.0, 2.0))
    changed = np.flatnonzero(np.abs(usual[2] - halved[2]).max(axis=1) > 1e-3)
    first = changed[0] * 1e-3 if changed.size else np.nan
    return _difference(case, usual[0], usual[1], halved[0], halved[1], first)


def against_radau(case: Case, duration: float, rtol: float = 1e-10) -> Difference:
    """The case's usual run against SciPy's Radau with tight tolerances, fed the same commands."""
    states, _, commands = case.states(duration)
    peer = integrate(case, commands, "Radau", rtol, 1e-2, duration)
    return _difference(case, states[: peer.states.shape[0]], None, peer.states, None, np.nan)


def _difference(
    case: Case, one: Array, found_one: Array | None, other: Array, found_other: Array | None, first: float
) -> Difference:
    rms: dict[str, float] = {}
    most: dict[str, float] = {}
    units = [case.unit, *([case.partner] if case.partner else [])]
    for axis, unit in enumerate(units):
        a, b = sensed(one, found_one, axis), sensed(other, found_other, axis)
        for channel in a:
            error = (a[channel] - b[channel]) / _scale(unit, channel)
            rms[channel] = max(rms.get(channel, 0.0), float(np.sqrt(np.mean(error**2))))
            most[channel] = max(most.get(channel, 0.0), float(np.abs(error).max()))
    return Difference(case.name, rms, most, first)


def _scale(unit: Unit, channel: str) -> float:
    """`unseen`, also where the loop's encoder was given no steps."""
    name = "pump_angle" if channel == GAINED else channel
    rounds = unit.sensor(name).resolution > 0.0
    return unseen(unit if rounds else Unit.load(unit.name), name)
