"""What follows from a profile's numbers, and whether an actuator can be like that."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from fdd.data_sheet.questions import QUESTIONS
from fdd.errors import InputError
from fdd.unit import Unit

LITRES_PER_MINUTE = 6e4
"""L/min in one m³/s."""


@dataclass(frozen=True)
class Remark:
    """Something odd about a profile.

    Attributes
    ----------
    keys : the data sheet's numbers that it is about, the likeliest culprit first.
    problem : with figures. mend : what to look at.
    impossible : no actuator is like that; else it is only unusual.
    """

    keys: tuple[str, ...]
    problem: str
    mend: str
    impossible: bool = False


@dataclass(frozen=True)
class Derived:
    """A quantity that follows: a person who knows the machine sees at once whether it is right."""

    quantity: str
    value: float
    unit: str


def derived(unit: Unit) -> list[Derived]:
    """What follows from the profile, for the table of ``fdd profile check``.

    Examples
    --------
    >>> rows = {r.quantity: r for r in derived(Unit.load("axis_a"))}
    >>> f"{rows['hydraulic resonance'].value:.0f} {rows['hydraulic resonance'].unit}"
    '56 Hz'
    """
    c, pump, relief = unit.cylinder, unit.pump, unit.accumulator.relief_pressure
    flow = pump.displacement * unit.drive.max_speed
    leak = pump.total_leakage * relief
    friction = unit.friction
    return [
        Derived("largest speed extending", 1e3 * flow / c.area_1, "mm/s"),
        Derived("largest speed retracting", 1e3 * flow / c.area_2, "mm/s"),
        Derived("travel per turn of the pump", 2e3 * math.pi * pump.displacement / c.area_1, "mm"),
        Derived("area ratio", c.area_2 / c.area_1, "1"),
        Derived("flow at the largest speed", LITRES_PER_MINUTE * flow, "L/min"),
        Derived("force at the relief setting", 1e-3 * relief * c.area_1, "kN"),
        Derived("stiffness at mid-stroke", 1e-6 * stiffness(unit), "N/µm"),
        Derived("hydraulic resonance", resonance(unit), "Hz"),
        Derived("leakage at the relief setting", LITRES_PER_MINUTE * leak, "L/min"),
        Derived("the same, of the largest flow", 100.0 * leak / flow, "%"),
        Derived("breakaway pressure extending", 1e-5 * friction.forward.static / c.area_1, "bar"),
        Derived("breakaway pressure retracting", 1e-5 * friction.reverse.static / c.area_2, "bar"),
        Derived("motor torque for the relief setting", pump.displacement * relief, "N*m"),
        Derived("largest motor torque", unit.drive.torque_constant * unit.drive.current_limit, "N*m"),
    ]


def stiffness(unit: Unit) -> float:
    """Of the oil columns at mid-stroke, both sides closed: β (A1²/V1 + A2²/V2), N/m."""
    c = unit.cylinder
    return unit.oil.bulk_modulus * (c.area_1**2 / c.volume_1 + c.area_2**2 / c.volume_2)


def resonance(unit: Unit) -> float:
    """Of the moving mass on the oil columns, Hz."""
    return math.sqrt(stiffness(unit) / unit.cylinder.moving_mass) / (2.0 * math.pi)


def unit_remarks(unit: Unit) -> list[Remark]:
    """What is odd about a profile, the impossible first.

    Examples
    --------
    >>> unit_remarks(Unit.load("axis_a"))
    []
    """
    return sorted((*_ranges(unit), *_shape(unit), *_pressures(unit), *_motion(unit)), key=_unusual_last)


def sheet_remarks(unit: Unit, values: dict[str, float]) -> list[Remark]:
    """`unit_remarks`, and what the sheet's own figures (SI) say beside each other."""
    return sorted((*_flow(values), *_rated(values), *unit_remarks(unit)), key=_unusual_last)


def require_plausible(remarks: list[Remark], where: str) -> None:
    """Refuse what cannot be.

    Raises
    ------
    InputError : the first impossible remark.
    """
    for remark in remarks:
        if remark.impossible:
            raise InputError(remark.problem, where=where, mend=remark.mend)


def _unusual_last(remark: Remark) -> bool:
    return not remark.impossible


def _ranges(unit: Unit) -> Iterator[Remark]:
    for question in QUESTIONS.values():
        if question.path is None:
            continue
        section, name = question.path.split(".")
        value = float(getattr(getattr(unit, section), name))
        if not question.low <= value <= question.high:
            yield Remark(
                (question.key,),
                f"{question.path} is {value:g} {question.unit}, not between {question.low:g} and "
                f"{question.high:g}",
                "check its unit of measure",
                impossible=True,
            )


def _shape(unit: Unit) -> Iterator[Remark]:
    c = unit.cylinder
    ratio = c.area_2 / c.area_1
    if not 0.25 <= ratio <= 4.0:
        yield Remark(
            ("piston_area_2", "piston_area_1"),
            f"the piston's areas differ by a factor of {max(ratio, 1 / ratio):.3g}",
            "check both areas and their units of measure",
            impossible=not 0.05 <= ratio <= 20.0,
        )
    for side, area, volume in (("1", c.area_1, c.volume_1), ("2", c.area_2, c.volume_2)):
        swept = 0.5 * area * c.stroke
        litres = f"chamber {side} holds {1e6 * volume:.4g} cm³ at mid-stroke"
        keys = (f"chamber_volume_{side}", "stroke", f"piston_area_{side}")
        # A sheet's volume may be a tenth off, and some leave the lines out.
        if volume < 0.8 * swept:
            problem = f"{litres}, less than the {1e6 * swept:.4g} cm³ that the piston sweeps from there"
            yield Remark(keys, problem, "check volume, stroke and area", impossible=True)
        elif volume < swept:
            problem = f"{litres}, barely less than the {1e6 * swept:.4g} cm³ that the piston sweeps"
            yield Remark(keys, problem, "add the lines' oil")
        elif volume > 30.0 * swept:
            problem = f"{litres}, {volume / swept:.3g} times what the piston sweeps from there"
            yield Remark(keys, problem, "check volume, stroke and area", impossible=volume > 300.0 * swept)


def _pressures(unit: Unit) -> Iterator[Remark]:
    a, c = unit.accumulator, unit.cylinder
    if a.charge_pressure >= a.relief_pressure:
        problem = (
            f"the charge, {_bar(a.charge_pressure)}, is not below the relief setting, "
            f"{_bar(a.relief_pressure)}"
        )
        yield Remark(("charge_pressure", "relief_pressure"), problem, "check both units", impossible=True)
    elif a.charge_pressure > 0.5 * a.relief_pressure:
        problem = f"the charge, {_bar(a.charge_pressure)}, is more than half the relief setting"
        yield Remark(("charge_pressure", "relief_pressure"), problem, "check both units of measure")
    static = 0.5 * (unit.friction.forward.static / c.area_1 + unit.friction.reverse.static / c.area_2)
    share = static / a.relief_pressure
    if share > 0.15:
        problem = f"the piston breaks away at {_bar(static)}, {share:.0%} of the relief setting"
        yield Remark(("breakaway_pressure",), problem, "check friction or area", impossible=share > 0.5)


def _motion(unit: Unit) -> Iterator[Remark]:
    d = unit.drive
    flow = unit.pump.displacement * d.max_speed
    fastest = flow / min(unit.cylinder.area_1, unit.cylinder.area_2)
    keys: tuple[str, ...] = ("pump_displacement", "piston_area_1", "max_speed")
    if not 0.01 <= fastest <= 2.0:
        problem = f"the piston's largest speed would be {1e3 * fastest:.3g} mm/s"
        impossible = not 1e-3 <= fastest <= 10.0
        yield Remark(keys, problem, "check displacement, areas and largest speed", impossible=impossible)
    lost = unit.pump.total_leakage * unit.accumulator.relief_pressure / flow
    if not 1e-3 <= lost <= 0.3:
        problem = f"at the relief setting {100 * lost:.3g} % of the largest flow leaks away"
        yield Remark(("leakage",), problem, "check the leakage and its unit", impossible=lost > 0.8)
    needed = unit.pump.displacement * unit.accumulator.relief_pressure
    available = d.torque_constant * d.current_limit
    if not 0.7 <= available / needed <= 20.0:
        problem = (
            f"the motor gives {available:.3g} N*m, the pump takes {needed:.3g} N*m at the relief setting"
        )
        keys = ("torque_constant", "current_limit", "pump_displacement")
        yield Remark(keys, problem, "check torque constant, current limit and displacement")
    frequency = resonance(unit)
    if not 2.0 <= frequency <= 2000.0:
        problem = f"the hydraulic resonance would be at {frequency:.3g} Hz"
        yield Remark(("moving_mass", "bulk_modulus"), problem, "check mass, volumes and bulk modulus")


def _flow(values: dict[str, float]) -> Iterator[Remark]:
    rated, ideal = values["rated_flow"], values["pump_displacement"] * values["max_speed"]
    ratio = rated / ideal
    if not 0.6 <= ratio <= 1.1:
        problem = (
            f"displacement times largest speed gives {LITRES_PER_MINUTE * ideal:.3g} L/min, the rated flow "
            f"is {LITRES_PER_MINUTE * rated:.3g} L/min"
        )
        off = max(ratio, 1.0 / ratio)
        slip = next((f" (off by nearly {name})" for name, f in SLIPS.items() if abs(off / f - 1.0) < 0.2), "")
        yield Remark(
            ("pump_displacement", "max_speed", "rated_flow"),
            problem,
            f"check the units of displacement, speed and flow{slip}",
            impossible=not 0.3 <= ratio <= 2.0,
        )


SLIPS = {
    "2π: turn or radian": 2.0 * math.pi,
    "60/2π: rpm or rad/s": 30.0 / math.pi,
    "60: minute or second": 60.0,
}
"""Factors that a mistaken unit of measure makes."""


def _rated(values: dict[str, float]) -> Iterator[Remark]:
    rated = values["rated_pressure"]
    if values["relief_pressure"] < rated:
        problem = f"the relief setting, {_bar(values['relief_pressure'])}, is below the rated {_bar(rated)}"
        yield Remark(("relief_pressure", "rated_pressure"), problem, "check both units", impossible=True)
    elif values["relief_pressure"] > 2.0 * rated:
        problem = (
            f"the relief setting, {_bar(values['relief_pressure'])}, is far above the rated {_bar(rated)}"
        )
        yield Remark(("relief_pressure", "rated_pressure"), problem, "check both units of measure")
    if values["pressure_full_scale"] < rated:
        end = _bar(values["pressure_full_scale"])
        problem = f"the pressure sensors end at {end}, below the rated {_bar(rated)}"
        yield Remark(("pressure_full_scale", "rated_pressure"), problem, "check both units of measure")
    lost = values["leakage"] * rated / values["rated_flow"]
    if lost > 0.5:
        problem = f"at the rated pressure {lost:.0%} of the rated flow leaks away"
        yield Remark(("leakage",), problem, "check the leakage and its unit", impossible=True)


def _bar(pressure: float) -> str:
    return f"{1e-5 * pressure:.3g} bar"
