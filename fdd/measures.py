"""Units of measure: what a profile or a channel map may write, and its factor to SI. What the table does not
have, pint knows. Oil temperature stays in °C, as the contract's channel list has it."""

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
_FACTORS: dict[str, dict[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "in": 0.0254},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
    "area": {"m^2": 1.0, "cm^2": 1e-4, "mm^2": 1e-6},
    "volume": {"m^3": 1.0, "L": 1e-3, "l": 1e-3, "cm^3": 1e-6, "mL": 1e-6},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "rate": {"1/s": 1.0, "1/h": 1.0 / 3600.0},
    "frequency": {"Hz": 1.0},
    "expansion": {"1/K": 1.0},
    "angle": {"rad": 1.0, "deg": math.pi / 180.0, "rev": _TWO_PI},
    "angular_speed": {"rad/s": 1.0, "rpm": _TWO_PI / 60.0, "deg/s": math.pi / 180.0, "rev/s": _TWO_PI},
    # gauge unless a field says otherwise
    "pressure": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 1e2, "psi": 6894.757293168},
    "force": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
    "mass": {"kg": 1.0},
    "inertia": {"kg*m^2": 1.0},
    "torque": {"N*m": 1.0},
    "power": {"W": 1.0, "kW": 1e3},
    "viscous_friction": {"N*s/m": 1.0},
    "rotary_viscous_friction": {"N*m*s/rad": 1.0},
    "current": {"A": 1.0, "mA": 1e-3},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "resistance": {"ohm": 1.0},
    "inductance": {"H": 1.0, "mH": 1e-3},
    "torque_constant": {"N*m/A": 1.0},
    "back_emf": {"V*s/rad": 1.0},
    "temperature": {"degC": 1.0, "°C": 1.0, "K": 1.0, "degF": 5.0 / 9.0},
    "density": {"kg/m^3": 1.0},
    "kinematic_viscosity": {"m^2/s": 1.0, "mm^2/s": 1e-6, "cSt": 1e-6},
    "displacement": {"m^3/rad": 1.0, "cm^3/rev": 1e-6 / _TWO_PI, "cm^3/rad": 1e-6},
    "flow": {"m^3/s": 1.0, "L/min": 1e-3 / 60.0, "l/min": 1e-3 / 60.0},
    "leakage_coefficient": {"m^3/(s*Pa)": 1.0},
    # noise that is summed up: its integral's deviation after one second
    "force_noise": {"N*s^0.5": 1.0},
    "acceleration_noise": {"rad/s^1.5": 1.0},
    "flow_noise": {"m^3/s^0.5": 1.0},
    "number": {"1": 1.0, "": 1.0, "%": 1e-2, "bool": 1.0},
}
"""Dimension to its units of measure, SI first, and their factors to it."""
_OFFSETS = {"K": -273.15, "degF": -160.0 / 9.0}

MEASURES: dict[str, Measure] = {
    name: Measure(dimension, factor, _OFFSETS.get(name, 0.0))
    for dimension, units in _FACTORS.items()
    for name, factor in units.items()
}

ATMOSPHERE_PA = 101_325.0
"""Standard atmosphere, ISO 2533: what an absolute pressure is more than a gauge pressure."""
_NOT_BY_PINT = {
    "rate", "expansion", "viscous_friction", "rotary_viscous_friction", "torque_constant", "back_emf",
    "leakage_coefficient", "force_noise", "acceleration_noise", "flow_noise", "number",
}  # fmt: skip
"""Dimensions that pint would not tell from others (a rate is no speed), or that nobody spells otherwise."""
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
    """A unit of measure of a dimension, as a rig's maker wrote it; None where it is none.

    Takes what `MEASURES` and pint know (``1/min``, ``inH2O``, ``kgf/cm²``), German and French spellings
    (``U/min``, ``tr/min``) and absolute pressures (``bar abs``, ``psia``), less `ATMOSPHERE_PA`. Rates of an
    ``angular_speed`` count revolutions.

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
    known = dimension in _FACTORS.keys() - _NOT_BY_PINT
    if not text or len(text) > 40 or not known or not re.fullmatch(r"[\w µ°%/*^().\-]+", text):
        return None
    try:
        return _by_pint(text, dimension)
    except Exception:  # pint's own errors, and those of tokenize, for text that is no unit
        return None


def _by_pint(text: str, dimension: str) -> Measure | None:
    registry = _registry()
    unit, si = registry.Unit(text), registry.Unit(next(iter(_FACTORS[dimension])))
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
    """Look a unit of measure up, as written in a profile or a map; dimension None accepts any of `MEASURES`.
    An InputError where it is unknown, or measures something else."""
    known = MEASURES.get(name.strip())
    if known is not None and dimension in (None, known.dimension):
        return known
    if dimension is not None and (spelled := find_measure(name, dimension)) is not None:
        return spelled
    fitting = ", ".join(n for n, m in MEASURES.items() if n and dimension in (None, m.dimension))
    wrong = f"unknown unit {name!r}"
    if known is not None:
        wrong = f"unit {name!r} measures {known.dimension}, not {dimension}"
    raise InputError(wrong, mend=f"use one of: {fitting}")
