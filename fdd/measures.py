"""Units of measure: what a profile or a channel map may write, and its factor to SI.

One table for both, so that ``unit: bar`` means the same wherever it stands. Oil
temperature stays in °C, as the contract's channel list has it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fdd.errors import InputError


@dataclass(frozen=True)
class Measure:
    """A unit of measure: ``si = factor * value + offset``, of one dimension."""

    dimension: str
    factor: float
    offset: float = 0.0


_TWO_PI = 2.0 * math.pi

MEASURES: dict[str, Measure] = {
    # length, speed, area, volume
    "m": Measure("length", 1.0), "cm": Measure("length", 1e-2), "mm": Measure("length", 1e-3),
    "um": Measure("length", 1e-6), "µm": Measure("length", 1e-6), "in": Measure("length", 0.0254),
    "m/s": Measure("speed", 1.0), "mm/s": Measure("speed", 1e-3),
    "m^2": Measure("area", 1.0), "cm^2": Measure("area", 1e-4), "mm^2": Measure("area", 1e-6),
    "m^3": Measure("volume", 1.0), "L": Measure("volume", 1e-3), "l": Measure("volume", 1e-3),
    "cm^3": Measure("volume", 1e-6), "mL": Measure("volume", 1e-6),
    # time
    "s": Measure("time", 1.0), "ms": Measure("time", 1e-3), "us": Measure("time", 1e-6),
    "ns": Measure("time", 1e-9), "1/s": Measure("rate", 1.0), "Hz": Measure("frequency", 1.0),
    "1/h": Measure("rate", 1.0 / 3600.0),
    # angle and its rate
    "rad": Measure("angle", 1.0), "deg": Measure("angle", math.pi / 180.0), "rev": Measure("angle", _TWO_PI),
    "rad/s": Measure("angular_speed", 1.0), "rpm": Measure("angular_speed", _TWO_PI / 60.0),
    "deg/s": Measure("angular_speed", math.pi / 180.0), "rev/s": Measure("angular_speed", _TWO_PI),
    # pressure (gauge unless a field says otherwise)
    "Pa": Measure("pressure", 1.0), "kPa": Measure("pressure", 1e3), "MPa": Measure("pressure", 1e6),
    "bar": Measure("pressure", 1e5), "mbar": Measure("pressure", 1e2),
    "psi": Measure("pressure", 6894.757293168),
    # force, mass, inertia, torque
    "N": Measure("force", 1.0), "kN": Measure("force", 1e3), "lbf": Measure("force", 4.4482216152605),
    "kg": Measure("mass", 1.0), "kg*m^2": Measure("inertia", 1.0), "N*m": Measure("torque", 1.0),
    "N*s/m": Measure("viscous_friction", 1.0), "N*m*s/rad": Measure("rotary_viscous_friction", 1.0),
    # electrical
    "A": Measure("current", 1.0), "mA": Measure("current", 1e-3), "V": Measure("voltage", 1.0),
    "mV": Measure("voltage", 1e-3), "ohm": Measure("resistance", 1.0), "H": Measure("inductance", 1.0),
    "mH": Measure("inductance", 1e-3), "N*m/A": Measure("torque_constant", 1.0),
    "V*s/rad": Measure("back_emf", 1.0),
    # oil
    "degC": Measure("temperature", 1.0), "°C": Measure("temperature", 1.0),
    "K": Measure("temperature", 1.0, -273.15), "degF": Measure("temperature", 5.0 / 9.0, -160.0 / 9.0),
    "kg/m^3": Measure("density", 1.0), "m^2/s": Measure("kinematic_viscosity", 1.0),
    "mm^2/s": Measure("kinematic_viscosity", 1e-6), "cSt": Measure("kinematic_viscosity", 1e-6),
    # hydraulics
    "m^3/rad": Measure("displacement", 1.0), "cm^3/rev": Measure("displacement", 1e-6 / _TWO_PI),
    "cm^3/rad": Measure("displacement", 1e-6),
    "m^3/s": Measure("flow", 1.0), "L/min": Measure("flow", 1e-3 / 60.0),
    "l/min": Measure("flow", 1e-3 / 60.0),
    "m^3/(s*Pa)": Measure("leakage_coefficient", 1.0),
    # noise that is summed up: its integral's deviation after one second
    "N*s^0.5": Measure("force_noise", 1.0), "rad/s^1.5": Measure("acceleration_noise", 1.0),
    "m^3/s^0.5": Measure("flow_noise", 1.0),
    # numbers
    "1": Measure("number", 1.0), "": Measure("number", 1.0), "%": Measure("number", 1e-2),
    "bool": Measure("number", 1.0),
}  # fmt: skip


def measure(name: str, dimension: str | None = None) -> Measure:
    """Look a unit of measure up.

    Parameters
    ----------
    name : as written in a profile or a map, e.g. ``"bar"``.
    dimension : what it must measure; None accepts any.

    Raises
    ------
    InputError : unknown name, or one that measures something else.

    Examples
    --------
    >>> measure("bar", "pressure").factor
    100000.0
    """
    found = MEASURES.get(name.strip())
    if found is None:
        of_dimension = [n for n, m in MEASURES.items() if m.dimension == dimension and n]
        known = of_dimension or [n for n in MEASURES if n]
        raise InputError(f"unknown unit {name!r}", mend=f"use one of: {', '.join(known)}")
    if dimension is not None and found.dimension != dimension:
        fitting = ", ".join(n for n, m in MEASURES.items() if m.dimension == dimension and n)
        raise InputError(
            f"unit {name!r} measures {found.dimension}, not {dimension}", mend=f"use one of: {fitting}"
        )
    return found
