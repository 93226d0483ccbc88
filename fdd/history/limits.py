"""How far a quantity may go: what severity 1 of the fault catalogue makes of it, or what the user says."""

from __future__ import annotations

from collections.abc import Sequence

from fdd.diagnosis.findings import ESTIMATED
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.residuals.oil import air_compliance
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

Limits = dict[str, tuple[float | None, float | None]]
"""Quantity to its least and greatest factor of the profile's; None where there is no limit."""


def severity_one(unit: Unit) -> Limits:
    """What faults of severity 1 make of the estimates, as factors of the profile's.

    Examples
    --------
    >>> limits = severity_one(Unit.load("axis_a"))
    >>> round(limits["leakage"][1], 2), round(limits["bulk_modulus"][0], 2), limits["coulomb_friction"]
    (2.84, 0.35, (0.35, 2.0))
    """
    rubbing = {f.name: f.value for f in CATALOGUE["seal_wear"].figures}
    friction = (rubbing["loose_friction"], rubbing["tight_friction"])
    air = next(f.value for f in CATALOGUE["aeration"].figures if f.name == "free_air")
    oil = unit.oil
    softer = air * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    return {
        "leakage": (None, 1.0 + Scales.of(unit).fault_leakage / unit.pump.total_leakage),
        "bulk_modulus": (1.0 / (1.0 + oil.bulk_modulus * softer), None),
        "coulomb_friction": friction,
        "viscous_friction": friction,
    }


def given_limits(texts: Sequence[str]) -> Limits:
    """Limits as a command line gives them.

    Raises
    ------
    InputError : no such quantity, or no factor.

    Examples
    --------
    >>> given_limits(["leakage=2.0", "bulk_modulus=0.5"])
    {'leakage': (None, 2.0), 'bulk_modulus': (0.5, None)}
    """
    out: Limits = {}
    for text in texts:
        name, _, factor = text.partition("=")
        try:
            value = float(factor)
        except ValueError:
            value = 1.0
        if name not in ESTIMATED or not 0.0 < value < 1e6 or value == 1.0:
            raise InputError(
                f"--limit {text!r}: not a quantity and a factor of the profile's",
                mend=f"write e.g. leakage=2.0; quantities: {', '.join(ESTIMATED)}",
            )
        least, most = out.get(name, (None, None))
        out[name] = (least, value) if value > 1.0 else (value, most)
    return out
