"""Eq. 5.22: the hydraulic transfer function that a profile's numbers give."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

from fdd.unit import Unit


@dataclass(frozen=True)
class Coefficients:
    """v/ω = numerator / (s² + damping·s + stiffness), as eq. 5.22 without its integrator."""

    numerator: float
    damping: float
    stiffness: float

    @property
    def natural_hz(self) -> float:
        """Undamped natural frequency."""
        return sqrt(self.stiffness) / (2.0 * pi)


def from_profile(unit: Unit, viscous: float) -> Coefficients:
    """Eq. 5.22 with the unit's numbers and friction `viscous` (N·s/m).

    Examples
    --------
    >>> round(from_profile(Unit.load("axis_a"), 0.0).natural_hz, 1)
    55.5
    """
    cylinder = unit.cylinder
    area, mass, leakage = cylinder.area_1, cylinder.moving_mass, unit.pump.total_leakage
    # Each side holds 2 V_o.
    stiffness = unit.oil.bulk_modulus / (0.25 * (cylinder.volume_1 + cylinder.volume_2))
    return Coefficients(
        numerator=area * stiffness * unit.pump.displacement / mass,
        damping=viscous / mass + leakage * stiffness,
        stiffness=(area**2 + leakage * viscous) * stiffness / mass,
    )
