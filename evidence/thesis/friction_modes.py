"""What sections 5.3's friction tests share: the four operating modes and the drive by both pumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.runs import both_pumps, run_speed
from fdd.plant.details import Details
from fdd.plant.simulate import Simulation
from fdd.unit import FrictionBranch, Unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mode:
    """One of the thesis's operating modes.

    Attributes
    ----------
    axis, sign : A or B, and 1 forward or -1 reverse.
    static, spread : Table 5.1, mean and standard deviation (N).
    branch : Table 5.2 with eqs 5.15 to 5.18, the consistent set.
    other : Table 5.3's curve, which contradicts it; None for A forward, where it does not.
    """

    axis: str
    sign: float
    static: float
    spread: float
    branch: FrictionBranch
    other: FrictionBranch | None

    @property
    def name(self) -> str:
        """As the thesis names it."""
        return f"{self.axis} {'forward' if self.sign > 0 else 'reverse'}"


def _branch(
    coulomb: float, static: float, velocity: float, exponent: float, viscous: float
) -> FrictionBranch:
    return FrictionBranch(
        coulomb=coulomb,
        static=static,
        stribeck_velocity=velocity,
        stribeck_exponent=exponent,
        viscous=viscous,
    )


MODES = (
    Mode("A", 1.0, 510.4, 41.5, _branch(151.1, 510.2, 0.026, 0.590, 0.0), None),
    Mode(
        "A", -1.0, 448.0, 42.1,
        _branch(113.0, 448.0, 0.007, 0.776, 123.0), _branch(0.0, 448.0, 0.010, 0.356, 720.0),
    ),
    Mode(
        "B", 1.0, 467.7, 48.0,
        _branch(75.0, 472.2, 0.010, 0.743, 138.0), _branch(0.0, 467.7, 0.015, 0.526, 487.0),
    ),
    Mode(
        "B", -1.0, 479.2, 43.9,
        _branch(72.0, 479.2, 0.016, 0.835, 109.0), _branch(0.0, 479.2, 0.025, 0.631, 430.0),
    ),
)  # fmt: skip
"""Tables 5.1, 5.2 and 5.3. B forward: eq. 5.17 has 75 + 397.2 N at rest where Table 5.1 has 467.7 N."""


def drive_both(mode: Mode, units: dict[str, Unit], speed: Array, seed: int, details: Details) -> Simulation:
    """Drive one cylinder in one direction by both pumps, without load, from near the stroke's end.

    Parameters
    ----------
    mode : which cylinder, which way.
    units : A and B.
    speed : (n,) rad/s, magnitude commanded of both pumps.
    seed : of the trial.
    details : for one pump; its dry friction is doubled.
    """
    other = "B" if mode.axis == "A" else "A"
    driven = both_pumps(units[mode.axis], units[other])
    twice = details.model_copy(update={"pump_coulomb_torque": 2.0 * details.pump_coulomb_torque})
    return run_speed(driven, mode.sign * speed, start=-0.12 * mode.sign, seed=seed, details=twice)


def measured_force(mode: Mode, out: Simulation) -> Array:
    """Force of the pressures along the motion (N), by the differential sensor, (n,)."""
    area = 0.5 * (out.unit.cylinder.area_1 + out.unit.cylinder.area_2)
    return np.asarray(mode.sign * area * out.samples["pressure_difference"])
