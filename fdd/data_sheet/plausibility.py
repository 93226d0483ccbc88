"""What follows from a profile's numbers, and whether an actuator can be like that; an accumulator's size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from fdd.data_sheet.profile import QUESTIONS
from fdd.errors import InputError
from fdd.unit import Unit

LITRES_PER_MINUTE = 6e4
"""L/min in one m³/s."""
SLIPS = {
    "2π: turn or radian": 2.0 * math.pi,
    "60/2π: rpm or rad/s": 30.0 / math.pi,
    "60: minute or second": 60.0,
}
"""Factors that a mistaken unit of measure makes."""
WARMING_K = 20.0
"""Between cold and warm oil in service, which the accumulator has to take."""

EXPANSION = 7e-4
"""1/K, of mineral oil's volume (typical data sheet of an ISO VG 32 oil)."""
RESERVE = 1.1
"""Oil at rest over what the circuit can take."""
HIGHEST, LOWEST = 1.6, 0.6
"""Absolute gas pressure over that at rest: hottest, and coldest under load."""
STEP_M3 = 1e-5
"""10 cm³: volumes are rounded up to it."""


class Remark(NamedTuple):
    """Something that may be odd about a profile: unusual, or `impossible`, as no actuator is. `keys` are the
    data sheet's numbers that it is about, the likeliest culprit first; `problem` has figures."""

    odd: bool
    impossible: bool
    keys: tuple[str, ...]
    problem: str
    mend: str


Remarks = Iterator[tuple[bool, bool, tuple[str, ...], str, str]]


class Derived(NamedTuple):
    """A quantity that follows: a person who knows the machine sees at once whether it is right."""

    quantity: str
    value: float
    unit: str


def derived(unit: Unit) -> list[Derived]:
    """What follows from the profile, for the table of ``fdd profile check``."""
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


def unit_remarks(unit: Unit, sheet: dict[str, float] | None = None) -> list[Remark]:
    """What is odd about a profile and in its data `sheet` (SI), the impossible first."""
    of_sheet = () if sheet is None else _sheet(sheet)
    parts = (of_sheet, _ranges(unit), _cylinder(unit), _accumulator(unit), _machine(unit))
    odd = [remark for part in parts for remark in map(Remark._make, part) if remark.odd]
    return sorted(odd, key=lambda remark: not remark.impossible)


def require_plausible(remarks: list[Remark], where: str) -> None:
    """Raise the first of `unit_remarks` as an InputError, where it cannot be."""
    if remarks and remarks[0].impossible:
        raise InputError(remarks[0].problem, where=where, mend=remarks[0].mend)


def _ranges(unit: Unit) -> Remarks:
    for q in QUESTIONS.values():
        if q.path is not None:
            section, name = q.path.split(".")
            value = getattr(getattr(unit, section), name)
            if value is None:
                continue  # derived from another number, which has a question too
            outside = not q.low <= value <= q.high
            problem = f"{q.path} is {value:g} {q.unit}, not between {q.low:g} and {q.high:g}"
            yield outside, outside, (q.key,), problem, "check its unit of measure"


def _cylinder(unit: Unit) -> Remarks:
    c = unit.cylinder
    factor = max(c.area_2 / c.area_1, c.area_1 / c.area_2)
    yield (
        factor > 4.0, factor > 20.0, ("piston_area_2", "piston_area_1"),
        f"the piston's areas differ by a factor of {factor:.3g}",
        "check both areas and their units of measure",
    )  # fmt: skip
    for side, area, volume in (("1", c.area_1, c.volume_1), ("2", c.area_2, c.volume_2)):
        swept = 0.5 * area * c.stroke
        keys = (f"chamber_volume_{side}", "stroke", f"piston_area_{side}")
        held = f"chamber {side} holds {1e6 * volume:.4g} cm³ at mid-stroke"
        sweeps = f"than the {1e6 * swept:.4g} cm³ that the piston sweeps"
        # A sheet's volume may be a tenth off, and some leave the lines out.
        little, barely = volume < 0.8 * swept, 0.8 * swept <= volume < swept
        yield little, little, keys, f"{held}, less {sweeps} from there", "check volume, stroke and area"
        yield barely, False, keys, f"{held}, barely less {sweeps}", "add the lines' oil"
        problem = f"{held}, {volume / swept:.3g} times what the piston sweeps from there"
        yield volume > 30.0 * swept, volume > 300.0 * swept, keys, problem, "check volume, stroke and area"


def _accumulator(unit: Unit) -> Remarks:
    """The gas gives way to what the rod displaces and to the warming oil, else the circuit cannot move."""
    a, c = unit.accumulator, unit.cylinder
    chambers = c.volume_1 + c.volume_2
    moved = 0.5 * c.stroke * abs(c.area_1 - c.area_2) + unit.oil.thermal_expansion * WARMING_K * chambers
    gas = f"the accumulator's gas is {1e6 * a.gas_volume:.3g} cm³"
    keys, mend = ("gas_volume",), "check the gas volume and its unit of measure"
    yield (
        a.gas_volume < moved, a.gas_volume < 0.1 * moved, keys,
        f"{gas}, less than the {1e6 * moved:.3g} cm³ of oil that the rod and {WARMING_K:.0f} K move", mend,
    )  # fmt: skip
    much = f"{gas}, {a.gas_volume / chambers:.3g} times what both chambers hold"
    yield a.gas_volume > 30.0 * chambers, a.gas_volume > 300.0 * chambers, keys, much, mend


def _machine(unit: Unit) -> Remarks:
    a, c, d = unit.accumulator, unit.cylinder, unit.drive
    keys: tuple[str, ...] = ("charge_pressure", "relief_pressure")
    above, charge = a.charge_pressure >= a.relief_pressure, f"the charge, {_bar(a.charge_pressure)}, is"
    problem = f"{charge} not below the relief setting, {_bar(a.relief_pressure)}"
    yield above, above, keys, problem, "check both units"
    high = not above and a.charge_pressure > 0.5 * a.relief_pressure
    yield high, False, keys, f"{charge} more than half the relief setting", "check both units of measure"
    static = 0.5 * (unit.friction.forward.static / c.area_1 + unit.friction.reverse.static / c.area_2)
    share = static / a.relief_pressure
    problem = f"the piston breaks away at {_bar(static)}, {share:.0%} of the relief setting"
    yield share > 0.15, share > 0.5, ("breakaway_pressure",), problem, "check friction or area"
    flow = unit.pump.displacement * d.max_speed
    fastest = flow / min(c.area_1, c.area_2)
    yield (
        not 0.01 <= fastest <= 2.0, not 1e-3 <= fastest <= 10.0,
        ("pump_displacement", "piston_area_1", "max_speed"),
        f"the piston's largest speed would be {1e3 * fastest:.3g} mm/s",
        "check displacement, areas and largest speed",
    )  # fmt: skip
    lost = unit.pump.total_leakage * a.relief_pressure / flow
    problem = f"at the relief setting {100 * lost:.3g} % of the largest flow leaks away"
    yield not 1e-3 <= lost <= 0.3, lost > 0.8, ("leakage",), problem, "check the leakage and its unit"
    needed, available = unit.pump.displacement * a.relief_pressure, d.torque_constant * d.current_limit
    yield (
        not 0.7 <= available / needed <= 20.0, False,
        ("torque_constant", "current_limit", "pump_displacement"),
        f"the motor gives {available:.3g} N*m, the pump takes {needed:.3g} N*m at the relief setting",
        "check torque constant, current limit and displacement",
    )  # fmt: skip
    frequency, keys = resonance(unit), ("moving_mass", "bulk_modulus")
    problem = f"the hydraulic resonance would be at {frequency:.3g} Hz"
    yield not 2.0 <= frequency <= 2000.0, False, keys, problem, "check mass, volumes and bulk modulus"


def _sheet(values: dict[str, float]) -> Remarks:
    """What the sheet's own figures say beside each other."""
    flow, ideal = values["rated_flow"], values["pump_displacement"] * values["max_speed"]
    ratio = flow / ideal
    off = max(ratio, 1.0 / ratio)
    slip = next((f" (off by nearly {name})" for name, f in SLIPS.items() if abs(off / f - 1.0) < 0.2), "")
    yield (
        not 0.6 <= ratio <= 1.1, not 0.3 <= ratio <= 2.0, ("pump_displacement", "max_speed", "rated_flow"),
        f"displacement times largest speed gives {LITRES_PER_MINUTE * ideal:.3g} L/min, the rated flow "
        f"is {LITRES_PER_MINUTE * flow:.3g} L/min",
        f"check the units of displacement, speed and flow{slip}",
    )  # fmt: skip
    rated, relief, end = (values[n] for n in ("rated_pressure", "relief_pressure", "pressure_full_scale"))
    keys: tuple[str, ...] = ("relief_pressure", "rated_pressure")
    below, setting = relief < rated, f"the relief setting, {_bar(relief)}, is"
    yield below, below, keys, f"{setting} below the rated {_bar(rated)}", "check both units"
    problem = f"{setting} far above the rated {_bar(rated)}"
    yield relief > 2.0 * rated, False, keys, problem, "check both units of measure"
    keys = ("pressure_full_scale", "rated_pressure")
    problem = f"the pressure sensors end at {_bar(end)}, below the rated {_bar(rated)}"
    yield end < rated, False, keys, problem, "check both units of measure"
    lost = values["leakage"] * rated / flow
    problem = f"at the rated pressure {lost:.0%} of the rated flow leaks away"
    yield lost > 0.5, lost > 0.5, ("leakage",), problem, "check the leakage and its unit"


def _bar(pressure: float) -> str:
    return f"{1e-5 * pressure:.3g} bar"


def accumulator_volumes(
    total_oil: float, loaded_oil: float, relief_pressure: float, bulk_modulus: float, shifted: float,
    cooling: float, heating: float,
) -> tuple[float, float]:  # fmt: skip
    """Gas and oil volume at rest (m³) such that the circuit is neither starved nor overcharged.

    The thesis (section 4.4) sizes its 13 cm³ by what may leak between services alone. A closed circuit needs
    besides, each rounded up to 10 cm³:

    - oil: 1.1 times what contracts down to the coldest temperature, what the loaded chamber takes in at the
      relief pressure, and what unequal areas shift over half a stroke;
    - gas, isothermal: below 1.6 times its absolute pressure at rest when the hottest oil and the shifted oil
      have come in, above 0.6 times when all of the oil above is gone.

    Only ratios of absolute pressures count, so the charge does not enter. `total_oil` (m³) is in both
    chambers with their lines, `loaded_oil` in the one under load, `shifted` the difference of the piston
    areas times half the stroke, of any sign; `cooling`, `heating`: K, at least 0, from the reference
    temperature.

    Examples
    --------
    The prototype's axis (Table 4.21, 2 V_o in each chamber), 40 °C, 10 to 70 °C:

    >>> gas, oil = accumulator_volumes(4.32e-3, 2.16e-3, 3.44e6, 2.1e8, 0.0, 30.0, 30.0)
    >>> round(1e6 * gas), round(1e6 * oil)
    (250, 140)
    """
    per_kelvin, shift = EXPANSION * total_oil, abs(shifted)
    taken = per_kelvin * cooling + loaded_oil * relief_pressure / bulk_modulus + shift
    given = per_kelvin * heating + shift
    gas = max(given * HIGHEST / (HIGHEST - 1.0), taken * LOWEST / (1.0 - LOWEST))
    # Less a hair: 20 cm³ that a sum gives as 20.000000000000004 stay 20.
    gas, oil = (STEP_M3 * math.ceil(volume / STEP_M3 - 1e-9) for volume in (gas, RESERVE * taken))
    return gas, oil
