"""The plant's constants, as the compiled loop takes them: from the unit, the scenario, the run's draw, and
the details that no unit profile knows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from pydantic import BaseModel, Field

from fdd.errors import InputError
from fdd.plant import Constants, Ranges, Validated
from fdd.plant.oil import ATMOSPHERE, BUNSEN, SOFTENING, VAPOUR_PRESSURE, stiff_bulk_modulus, viscosity
from fdd.plant.rig import Circuit, Load, PressLoad
from fdd.unit import Drive, Unit

FrictionLaw = Literal["elastoplastic", "lugre", "dahl", "smooth"]
ELASTOPLASTIC, LUGRE, DAHL, SMOOTH = range(4)
_FULL = 0.95
"""Of the shell: most that is oil, before the separator reaches its stop."""


class Details(Validated):
    """What the thesis and data sheets leave open: assumptions. A campaign draws it per rig from `usual`."""

    usual: ClassVar[Ranges] = {
        "bristle_stiffness": (4e5, 3e6), "bristle_damping": (0.3, 1.0), "bristle_fade": (0.003, 0.03),
        "breakaway": (0.3, 0.9), "friction_memory": (0.015, 0.06), "seal_damping": (200.0, 1000.0),
        "pump_teeth": (9, 14), "pump_ripple": (0.0, 0.02), "pump_compression": (0.0, 1.0),
        "pump_coulomb_torque": (0.02, 0.15), "line_loss": (0.0, 1.5e12), "heat_capacity": (8e3, 4e4),
        "cooling": (2.0, 20.0), "loose_seal_leakage": (0.0, 1e-12), "pump_friction": (0.02, 0.08),
        "pump_drag": (1e4, 4e4), "cogging_torque": (0.0, 2.5e-2), "check_lag": (1e-3, 6e-3),
        "check_hysteresis": (0.0, 3e3), "relief_lag": (3e-3, 1.5e-2), "relief_hysteresis": (0.0, 0.1),
        "gas_time": (2.0, 20.0), "gas_warming": (0.2, 1.0), "film_share": (0.1, 0.5),
    }  # fmt: skip

    # Seals
    bristle_stiffness: Annotated[float, Field(ge=1e3, le=1e9)] = 1e6
    """σ0 of eq. 5.8 (N/m); 1e6 gives half a millimetre of pre-sliding at 500 N, as elastomer seals do."""
    bristle_damping: Annotated[float, Field(ge=0.05, le=2.0)] = 0.5
    """Of the stuck piston on its bristles, relative to critical."""
    bristle_fade: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    """m/s, velocity at which the bristle damping has fallen to half."""
    breakaway: Annotated[float, Field(ge=0.0, le=0.95)] = 0.65
    """Share of its steady deflection up to which a bristle holds without sliding; 0 is eq. 5.9, 0.65 gives
    the means of Table 5.1's static friction in the thesis's own experiment; the peaks still rise with the
    step's size by 7 to 16 N/V, most of it the piston's inertia; figure 5.8 shows no rise."""
    friction_memory: Annotated[float, Field(ge=1e-3, le=1.0)] = 0.025
    """s, lag of the friction curve behind the velocity (Hess and Soom; Armstrong-Hélouvry). Section 5.3 reads
    its steady curves off a run-up of 0.11 m/s², in which 40 ms shift them by 4.4 mm/s and 5 to 9 %; with 25
    ms they agree with Table 5.2. With 20 ms the piston sticks and slips at 0.011 m/s, the thesis's slowest
    motion."""
    seal_damping: Annotated[float, Field(ge=0.0, le=1e6)] = 340.0
    """N·s/m, of velocity changes quicker than that lag; steady friction is untouched. The pole pair of eq.
    6.13 decays with 50.9 1/s whatever the bulk modulus, which over twice the moving mass is 375 N·s/m; lines,
    leakage and motor make up some 35 of them."""
    film_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    """Share of the seals' Coulomb friction that the oil's film carries: it goes with the root of viscosity
    (elastohydrodynamic seals: Nikas, doi:10.1243/13506501JET607)."""
    friction_law: FrictionLaw = "elastoplastic"
    """``elastoplastic`` LuGre with a film that lags; plain ``lugre``, whose film follows at once (eq. 5.9);
    ``dahl``, a bristle without the falling curve; ``smooth``, the Stribeck curve through zero as a tanh."""
    smooth_width: Annotated[float, Field(ge=5e-4, le=0.1)] = 3e-3
    """m/s of that tanh."""
    seal_pressure: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    """Rise of the seals' friction with the chambers' mean pressure, over pressure times area; a lip that the
    pressure presses on gives 0.002 to 0.01 (assumption)."""
    loose_seal_leakage: Annotated[float, Field(ge=0.0, le=1e-9)] = 0.0
    """Cross-port leakage that a fully loose seal adds (m³/(s·Pa))."""

    # Pump, motor and drive
    pump_teeth: Annotated[int, Field(ge=1, le=100)] = 12
    """Flow pulses per turn of the gear pump."""
    pump_ripple: Annotated[float, Field(ge=0.0, le=0.2)] = 0.01
    """Amplitude of these pulses over the mean flow."""
    pump_compression: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """0 the pump moves its displacement at the ports' mean density; 1 at its inlet's. Between them lies an
    apparent leakage of D·ω/(2β) per pressure."""
    pump_coulomb_torque: Annotated[float, Field(ge=0.0, le=100.0)] = 0.045
    """Dry friction of motor and pump (N·m)."""
    pump_friction: Annotated[float, Field(ge=0.0, le=0.3)] = 0.04
    """Torque by which the load rubs in the gears and their bearings, over D·Δp."""
    pump_drag: Annotated[float, Field(ge=0.0, le=1e6)] = 2e4
    """Viscous torque of the pump over μ·D·ω. With both a gear pump of the thesis's size gives 88 % of its
    torque at 3.44 MPa and full speed, 94 % at 20.68 MPa; catalogues have 85 to 95 %."""
    line_loss: Annotated[float, Field(ge=0.0, le=1e16)] = 6e11
    """K_pipe of eq. 3.33 (Pa·s²/m⁶); 6e11 gives 20 kPa at the pump's full flow."""
    current_lag: Annotated[float, Field(ge=1e-4, le=1e-3)] = 4e-4
    """s, of the drive's current loop."""
    command_dead_band: Annotated[float, Field(ge=0.0, le=5.0)] = 0.0346
    """rad/s, of the drive's input; Table 6.1 gives the motor 0.0011 V of ±10 V."""
    pole_pairs: Annotated[int, Field(ge=1, le=50)] = 4
    """Of the motor."""
    cogging_torque: Annotated[float, Field(ge=0.0, le=0.2)] = 8e-3
    """Of magnets and slots, over the torque of the relief setting."""
    winding_time: Annotated[float, Field(ge=0.1, le=1e4)] = 30.0
    """s, thermal time constant of the winding, for I²t protection."""
    continuous_share: Annotated[float, Field(ge=0.05, le=1.0)] = 0.6
    """Share of the current limit that the winding bears for good."""
    coupling_stiffness: Annotated[float, Field(ge=1.0, le=1e7)] = 500.0
    """N·m/rad of a worn coupling's flanks; a sound one is rigid."""
    coupling_damping: Annotated[float, Field(ge=1e-3, le=1e4)] = 0.25
    """N·m·s/rad of these."""

    # Valves
    check_width: Annotated[float, Field(ge=200.0, le=1e5)] = 1e3
    """Pa over which refeeding valves begin to open."""
    check_lag: Annotated[float, Field(ge=5e-4, le=0.2)] = 2e-3
    """s, by which a refeeding valve's poppet follows the pressure that moves it: all but closed after four or
    five of them."""
    check_hysteresis: Annotated[float, Field(ge=0.0, le=1e6)] = 1e3
    """Pa by which a raised poppet stays up longer."""
    pilot_ratio: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Of refeeding valves that the other chamber's pressure opens too, over their seat's area; 0 is a plain
    check valve. Unequal areas need them, for what the smaller chamber cannot take."""
    pilot_cracking: Annotated[float, Field(ge=0.0, le=1e6)] = 2e4
    """Pa beyond which that piston lifts the poppet."""
    pilot_band: Annotated[float, Field(ge=1e3, le=1e7)] = 1e5
    """Pa over which it does so."""
    relief_width: Annotated[float, Field(ge=1e3, le=1e6)] = 2e4
    """Pa over which relief valves begin to open."""
    relief_lag: Annotated[float, Field(ge=1e-3, le=0.1)] = 5e-3
    """s, by which a relief valve follows the pressure."""
    relief_hysteresis: Annotated[float, Field(ge=0.0, le=0.3)] = 0.05
    """How far below its setting an open one shuts, over the setting. Its override, the rise at full flow, is
    the unit's flow gain."""
    orifice_transition: Annotated[float, Field(ge=1e3, le=1e5)] = 1e4
    """Pa below which a stuck valve's orifice is laminar."""

    # Cylinder, heat, gas and air
    stop_stiffness: Annotated[float, Field(ge=1e5, le=1e11)] = 2e7
    """N/m of the cylinder's end stops."""
    stop_damping: Annotated[float, Field(ge=0.0, le=100.0)] = 5.0
    """s/m of these (force over spring force and velocity)."""
    cushion_length: Annotated[float, Field(ge=1e-3, le=0.1)] = 12e-3
    """m before the stop over which the cylinder's cushions take hold (section 4.5 names them)."""
    cushion_damping: Annotated[float, Field(ge=0.0, le=1e9)] = 1e5
    """N·s²/m², force of a cushion over velocity squared."""
    heat_capacity: Annotated[float, Field(ge=100.0, le=1e8)] = 17e3
    """J/K of oil and housing: 3.7 kg of oil and about 20 kg of steel."""
    cooling: Annotated[float, Field(ge=0.0, le=1e4)] = 8.0
    """W/K given to the surroundings: about 0.8 m² at 10 W/(m²·K)."""
    gas_time: Annotated[float, Field(ge=0.1, le=1e4)] = 8.0
    """s, with which the accumulator's gas takes its shell's temperature: 2 to 20 s for 0.1 to 5 l
    (Pourmovahed and Otis, doi:10.1115/1.2894128)."""
    gas_warming: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    """Share of the oil's warming that the shell takes, between the surroundings and the oil."""
    gallery_volume: Annotated[float, Field(ge=1e-7, le=1e-1)] = 1e-4
    """m³ of oil in pump case and passages around the accumulator."""
    gallery_gas: Annotated[float, Field(ge=1e-3, le=0.2)] = 0.01
    """Volume of the gas in it over that, at charge pressure: all that gives once the accumulator is empty."""
    air_law: Literal["free", "dissolving"] = "dissolving"
    """``free`` air is compressed only; where it is ``dissolving`` pressure drives it into the oil."""
    dissolving_pressure: Annotated[float, Field(ge=1e5, le=1e8)] = 2e6
    """Pa, gauge, from which on all but a tenth of the air dissolves in the end."""
    dissolving_time: Annotated[float, Field(ge=0.01, le=3600.0)] = 120.0
    """s; air comes out faster than it goes in, hence the hysteresis (assumption: minutes in, tenths of a
    second out)."""
    releasing_time: Annotated[float, Field(ge=0.01, le=600.0)] = 0.2
    """s."""


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
    unit: Unit, details: Details, load: Load, *, circuit: Circuit = Circuit(), charge_factor: float = 1.0,
    ambient: float = ATMOSPHERE, friction_draw: tuple[float, float] = (1.0, 1.0), surroundings: float = 40.0,
    joined_mass: float = 0.0, shares: bool = False,
) -> Constants:  # fmt: skip
    """Everything constant over a run; an `InputError` where a chamber would be empty within the stroke, or
    air alone too soft.

    `charge_factor` is the accumulator's charge (gauge) over the unit's, `ambient` (Pa, absolute) the pressure
    at gauge zero, `friction_draw` this run's friction over the unit's, forward and reverse (Table 5.1's
    spread), `surroundings` (°C) the temperature around the actuator, `joined_mass` (kg) that of the other
    axis's piston on the same rod. With `shares` the axis has no accumulator but the first one's.
    """
    cylinder, pump, oil, drive = unit.cylinder, unit.pump, unit.oil, unit.drive
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
    tank, external = unit.accumulator, circuit.accumulators
    charge = tank.charge_pressure * charge_factor
    gain, integral, feed, rate = velocity_loop(drive, details.current_lag)
    stiff = 1.0 / stiff_bulk_modulus(oil)
    thickness = float(viscosity(oil, oil.reference_temperature))
    critical = math.sqrt(details.bristle_stiffness * cylinder.moving_mass)
    shell = tank.gas_volume + tank.oil_at_rest
    dissolves = float(details.air_law == "dissolving")
    left = 1.0 - 0.9 * dissolves * min(oil.reference_pressure / details.dissolving_pressure, 1.0)
    ahead, back = friction_draw
    loads = dict.fromkeys(("added", "gap", "pressure", "rate", "slack"), 0.0) | _numbers(load)
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
        "friction_law": float(get_args(FrictionLaw).index(details.friction_law)),
        # m², by which the mean pressure of both chambers adds to the seals' friction.
        "seal_area": details.seal_pressure * area,
        # Oil.
        "stiff_compliance": stiff, "softening": SOFTENING, "expansion": oil.thermal_expansion,
        "reference_temperature": oil.reference_temperature, "vapour_pressure": VAPOUR_PRESSURE,
        "polytropic_inverse": 1.0 / oil.polytropic_index, "ambient": ambient,
        # 1/Pa: one over the gauge pressure at which air is as dissolved as it gets (0: it stays free),
        # and air that comes out of solution for each pascal below the surroundings' pressure.
        "dissolving": dissolves / details.dissolving_pressure,
        "releasing": dissolves * BUNSEN / ATMOSPHERE,
        "dissolving_rate": 1.0 / details.dissolving_time, "releasing_rate": 1.0 / details.releasing_time,
        # All air over what is free at the oil's reference pressure.
        "air_scale": 1.0 / left,
        # Pump and inner circuit.
        "teeth": float(details.pump_teeth), "ripple": details.pump_ripple,
        "refeed_cracking": tank.refeed_cracking_pressure, "refeed_gain": tank.refeed_flow_gain,
        "case_cracking": tank.case_cracking_pressure, "case_gain": tank.refeed_flow_gain,
        # 1/s of the refeeding valves' poppets.
        "check_rate": 1.0 / details.check_lag,
        "relief_pressure": tank.relief_pressure, "relief_gain": tank.relief_flow_gain,
        "relief_rate": 1.0 / details.relief_lag,
        # Pa, absolute, and m³ of the accumulator's gas at rest; m³ of oil at which the separator comes to
        # its stop on the gas's side.
        "gas_pressure": charge + ambient, "gas_volume": tank.gas_volume, "shell_volume": shell,
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
        "back_emf": drive.back_emf_constant, "rotary_viscous": drive.viscous_friction,
        "rotary_coulomb": details.pump_coulomb_torque,
        "pump_drag": details.pump_drag * oil.density * thickness * pump.displacement,
        "cogging_torque": details.cogging_torque * pump.displacement * tank.relief_pressure,
        "winding_rate": 1.0 / details.winding_time,
        "continuous_current": details.continuous_share * drive.current_limit,
        # Load.
        "spring": loads["rate"], "spring_centre": loads["slack"], "spring_play": 0.5 * loads["gap"],
        # 1 where the spring only presses, beyond its centre.
        "one_sided": float(isinstance(load, PressLoad)),
        # Pressure drop over the square root of which the partner's flow goes: R of Δp = R·Q².
        "throttle": loads["pressure"] / (100.0 * pump.displacement) ** 2,
        "partner_area": area if loads["pressure"] > 0.0 else 0.0,
        "partner_compliance": volume / oil.bulk_modulus,
        "surroundings": surroundings,
    })  # fmt: skip
