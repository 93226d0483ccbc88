"""The plant's constants as the compiled loop takes them: from the unit, the scenario and the run's draw."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from fdd.errors import InputError
from fdd.plant.circuit import Circuit
from fdd.plant.details import Details
from fdd.plant.load import Load
from fdd.plant.oil import ATMOSPHERE, BUNSEN, SOFTENING, VAPOUR_PRESSURE, stiff_bulk_modulus, viscosity
from fdd.unit import Drive, Unit

FRICTION_LAWS = ("elastoplastic", "lugre", "dahl", "smooth")
ELASTOPLASTIC, LUGRE, DAHL, SMOOTH = range(4)
_FULL = 0.95
"""Of the shell: most that is oil, before the separator reaches its stop."""

Constants = Any
"""Constants of one run, SI: a NumPy record, which compiled functions read by name without copying."""


def record(values: Mapping[str, float]) -> Constants:
    """Numbers that compiled functions read by name."""
    kind = np.dtype([(name, np.float64) for name in values])
    return np.rec.array([tuple(values.values())], dtype=kind)[0]


def _numbers(part: BaseModel) -> dict[str, float]:
    """What a part of the unit, the details or a load give as it is."""
    return {name: value for name, value in part if isinstance(value, int | float)}


def velocity_loop(drive: Drive, current_lag: float) -> tuple[float, float, float, float]:
    """Gains of the velocity loop that has the drive's poles and zero (eq. 6.11), and the current loop's rate.

    With a current loop of lag τ (s) the speed follows ω/c = (f·s + k2)/(τs³ + s² + k1·s + k2). Two of its
    poles are the drive's; their sum is 1/τ, so the third lies at p3 = 1/τ - p1 - p2. The `current_lag`
    wanted is shortened where the drive's own poles are nearly as fast. Gives k1 (1/s), k2 (1/s²), f (1/s)
    and 1/τ (1/s).
    """
    total, product = drive.pole_1 + drive.pole_2, drive.pole_1 * drive.pole_2
    rate = max(1.0 / current_lag, 3.0 * total)
    third = rate - total
    integral = product * third / rate
    return (product + third * total) / rate, integral, integral / drive.zero, rate


def plant_parameters(
    unit: Unit, details: Details, load: Load, *, circuit: Circuit | None = None, charge_factor: float = 1.0,
    ambient: float = ATMOSPHERE, friction_draw: tuple[float, float] = (1.0, 1.0), surroundings: float = 40.0,
    joined_mass: float = 0.0, shares: bool = False,
) -> Constants:  # fmt: skip
    """Everything constant over a run.

    Parameters
    ----------
    charge_factor : accumulator charge (gauge) over the unit's.
    ambient : Pa, absolute pressure at gauge zero.
    friction_draw : this run's friction over the unit's, forward and reverse (Table 5.1's spread).
    surroundings : °C around the actuator.
    joined_mass : kg of another axis's piston on the same rod.
    shares : the axis has no accumulator but the first one's.

    Raises
    ------
    InputError : a chamber would be empty within the stroke, or the air alone too soft.
    """
    cylinder, pump, oil, drive = unit.cylinder, unit.pump, unit.oil, unit.drive
    circuit = circuit or Circuit()
    half = 0.5 * cylinder.stroke
    # The valve between pump and cylinder lies in the middle: V_o on either side of it (eqs 3.14 to 3.17).
    share = 0.5 if circuit.blocked else 1.0
    sides = (cylinder.volume_1, cylinder.area_1), (cylinder.volume_2, cylinder.area_2)
    for side, (volume, area) in enumerate(sides, 1):
        swept = area * half
        if share * volume <= 1.05 * swept:
            raise InputError(
                f"volume_{side} {volume * 1e6:.0f} cm³ is empty at the stroke's end ({swept * 1e6:.0f} cm³)",
                where=f"unit {unit.name} cylinder",
                mend="enlarge it or shorten stroke",
            )
    tank = unit.accumulator
    charge = tank.charge_pressure * charge_factor
    gain, integral, feed, rate = velocity_loop(drive, details.current_lag)
    external = circuit.accumulators
    n = oil.polytropic_index
    stiff = 1.0 / stiff_bulk_modulus(oil)
    thickness = float(viscosity(oil, oil.reference_temperature))
    critical = math.sqrt(details.bristle_stiffness * cylinder.moving_mass)
    shell = tank.gas_volume + tank.oil_at_rest
    dissolves = float(details.air_law == "dissolving")
    left = 1.0 - 0.9 * dissolves * min(oil.reference_pressure / details.dissolving_pressure, 1.0)
    ahead, back = friction_draw
    loads = {"added": 0.0, "gap": 0.0, "pressure": 0.0, **_numbers(load)}
    forward, reverse = unit.friction.forward, unit.friction.reverse
    area = 0.5 * (cylinder.area_1 + cylinder.area_2)
    volume = 0.25 * (cylinder.volume_1 + cylinder.volume_2)
    return record({
        **_numbers(cylinder), **_numbers(drive), **_numbers(pump), **_numbers(details),
        "cylinder_volume_1": 0.5 * cylinder.volume_1, "cylinder_volume_2": 0.5 * cylinder.volume_2,
        "line_volume_1": 0.5 * cylinder.volume_1, "line_volume_2": 0.5 * cylinder.volume_2,
        # 1 where the valve between pump and cylinder is shut, 0 where it is open.
        "blocked": float(circuit.blocked),
        "half_stroke": half,
        "mass": cylinder.moving_mass + joined_mass + loads["added"],
        "bristle_damping": 2.0 * details.bristle_damping * critical,
        "friction_rate": 1.0 / details.friction_memory,
        # LuGre, a curve for each direction, times the run's draw.
        "coulomb_forward": forward.coulomb * ahead, "static_forward": forward.static * ahead,
        "stribeck_forward": forward.stribeck_velocity, "exponent_forward": forward.stribeck_exponent,
        "viscous_forward": forward.viscous,
        "coulomb_reverse": reverse.coulomb * back, "static_reverse": reverse.static * back,
        "stribeck_reverse": reverse.stribeck_velocity, "exponent_reverse": reverse.stribeck_exponent,
        "viscous_reverse": reverse.viscous,
        "friction_law": float(FRICTION_LAWS.index(details.friction_law)),
        # m², by which the mean pressure of both chambers adds to the seals' friction.
        "seal_area": details.seal_pressure * area,
        # Oil.
        "stiff_compliance": stiff, "softening": SOFTENING, "expansion": oil.thermal_expansion,
        "reference_temperature": oil.reference_temperature,
        "vapour_pressure": VAPOUR_PRESSURE,
        "polytropic_inverse": 1.0 / n,
        "ambient": ambient,
        # 1/Pa: one over the gauge pressure at which air is as dissolved as it gets (0: it stays free),
        # and air that comes out of solution for each pascal below the surroundings' pressure.
        "dissolving": dissolves / details.dissolving_pressure,
        "releasing": dissolves * BUNSEN / ATMOSPHERE,
        "dissolving_rate": 1.0 / details.dissolving_time, "releasing_rate": 1.0 / details.releasing_time,
        # All air over what is free at the oil's reference pressure.
        "air_scale": 1.0 / left,
        # Pump and inner circuit.
        "teeth": float(details.pump_teeth),
        "ripple": details.pump_ripple,
        "refeed_cracking": tank.refeed_cracking_pressure, "refeed_gain": tank.refeed_flow_gain,
        "case_cracking": tank.case_cracking_pressure, "case_gain": tank.refeed_flow_gain,
        # 1/s of the refeeding valves' poppets.
        "check_rate": 1.0 / details.check_lag,
        "relief_pressure": tank.relief_pressure,
        "relief_gain": tank.relief_flow_gain,
        "relief_rate": 1.0 / details.relief_lag,
        # Pa, absolute, and m³ of the accumulator's gas at rest; m³ of oil at which the separator comes to
        # its stop on the gas's side.
        "gas_pressure": charge + ambient,
        "gas_volume": tank.gas_volume,
        "shell_volume": shell,
        "full": _FULL * shell,
        "full_stiffness": oil.bulk_modulus / details.gallery_volume,
        "gallery_gas": details.gallery_gas * details.gallery_volume,
        # Share of its absolute temperature at rest by which a joule of work heats the gas: (γ - 1)/(p·V).
        "gas_work": 0.4 / ((charge + ambient) * tank.gas_volume),
        "gas_rate": 1.0 / details.gas_time,
        "gas_warming": details.gas_warming / (surroundings + 273.15),
        # 1 where the axis has no accumulator but the first axis's.
        "shares": float(shares),
        # Of the accumulator's oil at its charge pressure and the reference temperature.
        "store_density": math.exp(charge * stiff),
        "charging_pressure": circuit.charging_pressure,
        "external_flow": external.valve_flow if external else 0.0,
        "external_pressure": external.gas_charge + ambient if external else 1.0,
        "external_volume": external.gas_volume if external else 1.0,
        # Drive.
        "loop_gain": gain, "loop_integral": integral, "loop_feed": feed, "current_rate": rate,
        "back_emf": drive.back_emf_constant,
        "rotary_viscous": drive.viscous_friction,
        "rotary_coulomb": details.pump_coulomb_torque,
        "pump_drag": details.pump_drag * oil.density * thickness * pump.displacement,
        "cogging_torque": details.cogging_torque * pump.displacement * tank.relief_pressure,
        "winding_rate": 1.0 / details.winding_time,
        "continuous_current": details.continuous_share * drive.current_limit,
        # Load.
        "spring": load.stiffness, "spring_centre": load.centre, "spring_play": 0.5 * loads["gap"],
        # 1 where the spring only presses, beyond its centre.
        "one_sided": float(load.one_sided),
        # Pressure drop over the square root of which the partner's flow goes: R of Δp = R·Q².
        "throttle": loads["pressure"] / (100.0 * pump.displacement) ** 2,
        "partner_area": area if loads["pressure"] > 0.0 else 0.0,
        "partner_compliance": volume / oil.bulk_modulus,
        "surroundings": surroundings,
    })  # fmt: skip
