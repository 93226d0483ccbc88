"""Units of measure: what a profile or a channel map may write, and its factor to SI.

One table for both, so that ``unit: bar`` means the same wherever it stands; what it does not have, pint
knows. Oil temperature stays in °C, as the contract's channel list has it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

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
    "1/h": Measure("rate", 1.0 / 3600.0), "1/K": Measure("expansion", 1.0),
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
    "W": Measure("power", 1.0), "kW": Measure("power", 1e3),
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


ATMOSPHERE_PA = 101_325.0
"""Standard atmosphere, ISO 2533: what an absolute pressure is more than a gauge pressure."""
_SI = {
    "length": "m", "speed": "m/s", "area": "m**2", "volume": "m**3", "time": "s", "angle": "rad",
    "angular_speed": "rad/s", "pressure": "Pa", "force": "N", "mass": "kg", "inertia": "kg*m**2",
    "torque": "N*m", "current": "A", "voltage": "V", "resistance": "ohm", "inductance": "H",
    "temperature": "degC", "density": "kg/m**3", "kinematic_viscosity": "m**2/s", "flow": "m**3/s",
    "frequency": "Hz", "displacement": "m**3/rad", "power": "W",
}  # fmt: skip
"""What pint converts to, by dimension."""
_SPELLED = {
    "u/min": "rpm", "umdr/min": "rpm", "tr/min": "rpm", "1/min": "rpm", "min^-1": "rpm", "min-1": "rpm",
    "r/min": "rpm", "rev/min": "rpm", "u/s": "rev/s", "1/s": "rev/s", "s^-1": "rev/s", "s-1": "rev/s",
    "hz": "rev/s", "grad": "deg", "°": "deg", "grad/s": "deg/s", "°/s": "deg/s", "u": "rev", "umdr": "rev",
    "turn": "rev", "tr": "rev", "c": "degC", "f": "degF", "°f": "degF", "grad c": "degC", "deg c": "degC",
    "celsius": "degC", "fahrenheit": "degF", "kelvin": "K", "inch": "in", '"': "in", "zoll": "in",
    "sec": "s", "sek": "s", "seconds": "s", "msec": "ms", "usec": "us", "µs": "us", "micron": "um",
    "mikrometer": "um", "ampere": "A", "amp": "A", "amps": "A", "newton": "N",
}  # fmt: skip
"""How rigs write units, in small letters, where a letter alone or a rate is meant as this field means it."""
_OF_DIMENSION = {"u": ("angle",), "c": ("temperature",), "f": ("temperature",), "tr": ("angle",)}
_ABSOLUTE = re.compile(r"[ _(\[]*(?:abs(?:olute?)?|a)\.?[)\]]*$", re.IGNORECASE)
_GAUGE = re.compile(r"[ _(\[]*(?:gauge|rel|ü|g)\.?[)\]]*$", re.IGNORECASE)


def find_measure(text: str, dimension: str) -> Measure | None:
    """A unit of measure as a rig's maker wrote it; None where it measures something else or nothing.

    Takes what `MEASURES` and pint know (``1/min``, ``inH2O``, ``kgf/cm²``), German and French spellings
    (``U/min``, ``tr/min``) and absolute pressures (``bar abs``, ``psia``), less `ATMOSPHERE_PA`.

    Parameters
    ----------
    dimension : what it has to measure. Rates of an ``angular_speed`` count revolutions.

    Examples
    --------
    >>> round(find_measure("U/min", "angular_speed").factor, 6), find_measure("kPa abs", "pressure").offset
    (0.10472, -101325.0)
    >>> round(find_measure("kgf/cm²", "pressure").factor, 1), find_measure("kgf/cm²", "length")
    (98066.5, None)
    """
    plain = text.strip().strip("[]() ").replace("**", "^").replace("·", "*")
    plain = re.sub(r"(?<=[A-Za-z])(?=[23]\b)", "^", plain.replace("²", "2").replace("³", "3"))  # cm2, cm³
    found = _plain_measure(plain, dimension)
    if found is None and dimension == "pressure":
        for pattern, offset in ((_ABSOLUTE, -ATMOSPHERE_PA), (_GAUGE, 0.0)):
            shorter = pattern.sub("", plain)
            if shorter and shorter != plain and (of := _plain_measure(shorter, dimension)) is not None:
                return Measure(of.dimension, of.factor, of.offset + offset)
    return found


@lru_cache(maxsize=512)
def _plain_measure(text: str, dimension: str) -> Measure | None:
    spelled = _SPELLED.get(text.lower())
    for name in (text, spelled if dimension in _OF_DIMENSION.get(text.lower(), (dimension,)) else None):
        if name in MEASURES and MEASURES[name].dimension == dimension:
            return MEASURES[name]
    if not text or len(text) > 40 or dimension not in _SI or not re.fullmatch(r"[\w µ°%/*^().\-]+", text):
        return None
    try:
        return _by_pint(text, dimension)
    except Exception:  # pint's own errors, and those of tokenize, for text that is no unit
        return None


def _by_pint(text: str, dimension: str) -> Measure | None:
    registry = _registry()
    unit, si = registry.Unit(text), registry.Unit(_SI[dimension])
    if unit.dimensionality != si.dimensionality:
        return None
    at_zero, at_one = (registry.Quantity(v, unit).to(si).magnitude for v in (0.0, 1.0))
    if dimension == "length" and at_one > 1.0:  # furlongs and miles measure land, not a stroke
        return None
    return Measure(dimension, float(at_one - at_zero), float(at_zero))


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


def measure(name: str, dimension: str | None = None) -> Measure:
    """Look a unit of measure up.

    Parameters
    ----------
    name : as written in a profile or a map, e.g. ``"bar"``.
    dimension : what it must measure; None accepts any of `MEASURES`.

    Raises
    ------
    InputError : unknown name, or one that measures something else.

    Examples
    --------
    >>> measure("bar", "pressure").factor
    100000.0
    """
    found = MEASURES.get(name.strip())
    if found is not None and dimension in (None, found.dimension):
        return found
    spelled = None if dimension is None else find_measure(name, dimension)
    if spelled is not None:
        return spelled
    fitting = ", ".join(n for n, m in MEASURES.items() if n and dimension in (None, m.dimension))
    if found is None:
        raise InputError(f"unknown unit {name!r}", mend=f"use one of: {fitting}")
    raise InputError(
        f"unit {name!r} measures {found.dimension}, not {dimension}", mend=f"use one of: {fitting}"
    )
