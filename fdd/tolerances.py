"""How far a healthy unit may lie from the base profile of its kind, as standard deviations of a logarithm.

A base is a data sheet or a sister unit. What its numbers may be off by belongs to it: the kind's usual
tolerance, and with it in quadrature what the profile itself states. Identification takes these as priors,
its judgement as what is left open.
"""

from __future__ import annotations

from math import hypot
from operator import attrgetter

from fdd.unit import Unit

_STEPPED = (
    0.067,
    "half a step of the R10 series (ISO 3) either way, evenly: 0.115 / √3. Pumps and bores are stepped at "
    "least so, and farther off the next size is nearer",
)
TOLERANCES: dict[str, tuple[float, str]] = {
    "pump.displacement": _STEPPED,
    "cylinder.area_1": _STEPPED,
    "cylinder.area_2": (0.035, "over area_1: both chambers have the bore in common, rods are stepped"),
    "cylinder.volume": (0.15, "lines and blocks differ"),
    "pump.leakage": (0.31, "thesis 5.2: axes A and B differ by 1.5, 0.29 in ln; gap flow goes with its cube"),
    "pump.case_share": (0.3, "gaps of gears and of shaft, of one make"),
    "pump.inlet": (0.3, "evenly between 0 and 1: see fdd.identification.volume_steps"),
    "oil.bulk_modulus": (0.3, "hoses, walls and air: a third of oil's own stiffness, and of it again"),
    "friction": (0.45, "seal friction differs by two to three between makes, by 1.4 within one (Table 5.2)"),
    "drive.torque_constant": (0.08, "10 % of the winding evenly, 6 % of magnets that are 60 K warmer"),
    "accumulator.charge_pressure": (0.3, "gas at 20 to 80 °C, a charge at either end of its range, leaks"),
}
"""Quantity to the standard deviation of its ln among units of one kind, and why."""
RELIEF_SHUT = 0.8
"""Of the relief setting, up to which no healthy valve passes: it cracks at nine tenths of its setting, and of
one kind settings differ by a tenth."""
JOINT = {
    "pump.displacement": ("pump.displacement", "cylinder.area_1"),
    "drive.torque_constant": ("drive.torque_constant", "cylinder.area_1"),
}
"""What identification counts with the base's area_1, and so carries its tolerance too."""
STATED = {"pump.leakage": "pump.cross_port_leakage", "friction": "friction.forward.coulomb"}
"""The profile's number whose standard deviation is the quantity's."""


def tolerance(base: Unit, quantity: str) -> float:
    """Standard deviation of ln(unit / base) of a quantity of `TOLERANCES` that the base profile leaves open;
    travel per rad goes by the displacement's name.

    Examples
    --------
    >>> round(tolerance(Unit.load("axis_a"), "pump.displacement"), 3)
    0.095
    """
    parts = JOINT.get(quantity, (quantity,))
    return hypot(*(hypot(TOLERANCES[part][0], _stated(base, STATED.get(part, part))) for part in parts))


def _stated(base: Unit, path: str) -> float:
    """Relative standard deviation that the profile states for a number, 0 where it states none."""
    way, _, name = path.rpartition(".")
    section = attrgetter(way)(base)
    value, std = getattr(section, name, 0.0), section.std_of(name)
    return float(std / value) if std is not None and value > 0.0 else 0.0
