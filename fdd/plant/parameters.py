"""The plant's constants as the compiled loop takes them: from the unit, the scenario and the run's draw."""

from __future__ import annotations

import math
from typing import NamedTuple

from fdd.errors import InputError
from fdd.plant.details import Details
from fdd.plant.load import Load
from fdd.plant.oil import ATMOSPHERE, stiff_bulk_modulus
from fdd.unit import Unit


class Parameters(NamedTuple):
    """Constants of one run, SI."""

    # cylinder and what it moves
    area_1: float
    area_2: float
    volume_1: float
    volume_2: float
    half_stroke: float
    mass: float
    stop_stiffness: float
    stop_damping: float
    # friction: LuGre, a curve for each direction, times the run's draw
    bristle_stiffness: float
    bristle_damping: float
    bristle_fade: float
    friction_memory: float
    seal_damping: float
    coulomb_forward: float
    static_forward: float
    stribeck_forward: float
    exponent_forward: float
    viscous_forward: float
    coulomb_reverse: float
    static_reverse: float
    stribeck_reverse: float
    exponent_reverse: float
    viscous_reverse: float
    # oil
    stiff_compliance: float
    polytropic_inverse: float
    ambient: float
    # pump and inner circuit
    displacement: float
    teeth: float
    ripple: float
    pump_compression: float
    refeed_cracking: float
    refeed_gain: float
    case_cracking: float
    check_width: float
    orifice_transition: float
    relief_pressure: float
    relief_gain: float
    relief_width: float
    gas_pressure: float
    gas_volume: float
    store_density: float
    # drive
    max_speed: float
    pole_sum: float
    pole_product: float
    feedthrough: float
    torque_constant: float
    torque_limit: float
    inertia: float
    rotary_viscous: float
    rotary_coulomb: float
    # load
    spring: float
    spring_centre: float
    throttle: float
    partner_area: float
    partner_compliance: float


def plant_parameters(
    unit: Unit,
    details: Details,
    load: Load,
    *,
    charge_factor: float = 1.0,
    ambient: float = ATMOSPHERE,
    friction_draw: tuple[float, float] = (1.0, 1.0),
) -> Parameters:
    """Everything constant over a run.

    Parameters
    ----------
    unit : the actuator.
    details : of the plant, beyond the unit.
    load : what the rod pushes against.
    charge_factor : accumulator charge (gauge) over the unit's.
    ambient : Pa, absolute pressure at gauge zero.
    friction_draw : this run's friction over the unit's, forward and reverse (Table 5.1's spread).

    Raises
    ------
    InputError : a chamber would be empty within the stroke, or the air alone too soft.
    """
    cylinder, pump, oil, drive = unit.cylinder, unit.pump, unit.oil, unit.drive
    half = 0.5 * cylinder.stroke
    for name, volume, area in (
        ("volume_1", cylinder.volume_1, cylinder.area_1),
        ("volume_2", cylinder.volume_2, cylinder.area_2),
    ):
        if volume <= 1.05 * area * half:
            raise InputError(
                f"{name} {volume * 1e6:.0f} cm³ is empty at the stroke's end ({area * half * 1e6:.0f} cm³)",
                where=f"unit {unit.name} cylinder",
                mend="enlarge it or shorten stroke",
            )
    charge = unit.accumulator.charge_pressure * charge_factor
    mass = cylinder.moving_mass + load.mass
    n = oil.polytropic_index
    stiff = 1.0 / stiff_bulk_modulus(oil)
    # Oil in the accumulator is counted at the density it has at charge pressure.
    free = oil.air_fraction * (1.0 - (ATMOSPHERE / (charge + ambient)) ** (1.0 / n))
    ahead, back = friction_draw
    forward, reverse = unit.friction.forward, unit.friction.reverse
    area = 0.5 * (cylinder.area_1 + cylinder.area_2)
    volume = 0.25 * (cylinder.volume_1 + cylinder.volume_2)
    return Parameters(
        area_1=cylinder.area_1,
        area_2=cylinder.area_2,
        volume_1=cylinder.volume_1,
        volume_2=cylinder.volume_2,
        half_stroke=half,
        mass=mass,
        stop_stiffness=details.stop_stiffness,
        stop_damping=details.stop_damping,
        bristle_stiffness=details.bristle_stiffness,
        bristle_damping=2.0
        * details.bristle_damping
        * math.sqrt(details.bristle_stiffness * cylinder.moving_mass),
        bristle_fade=details.bristle_fade,
        friction_memory=details.friction_memory,
        seal_damping=details.seal_damping,
        coulomb_forward=forward.coulomb * ahead,
        static_forward=forward.static * ahead,
        stribeck_forward=forward.stribeck_velocity,
        exponent_forward=forward.stribeck_exponent,
        viscous_forward=forward.viscous,
        coulomb_reverse=reverse.coulomb * back,
        static_reverse=reverse.static * back,
        stribeck_reverse=reverse.stribeck_velocity,
        exponent_reverse=reverse.stribeck_exponent,
        viscous_reverse=reverse.viscous,
        stiff_compliance=stiff,
        polytropic_inverse=1.0 / n,
        ambient=ambient,
        displacement=pump.displacement,
        teeth=float(details.pump_teeth),
        ripple=details.pump_ripple,
        pump_compression=details.pump_compression,
        refeed_cracking=unit.accumulator.refeed_cracking_pressure,
        refeed_gain=unit.accumulator.refeed_flow_gain,
        case_cracking=unit.accumulator.case_cracking_pressure,
        check_width=details.check_width,
        orifice_transition=details.orifice_transition,
        relief_pressure=unit.accumulator.relief_pressure,
        relief_gain=unit.accumulator.relief_flow_gain,
        relief_width=details.relief_width,
        gas_pressure=charge + ambient,
        gas_volume=unit.accumulator.gas_volume,
        store_density=math.exp(charge * stiff + free),
        max_speed=drive.max_speed,
        pole_sum=drive.pole_1 + drive.pole_2,
        pole_product=drive.pole_1 * drive.pole_2,
        feedthrough=drive.pole_1 * drive.pole_2 / drive.zero,
        torque_constant=drive.torque_constant,
        torque_limit=drive.torque_constant * drive.current_limit,
        inertia=drive.inertia,
        rotary_viscous=drive.viscous_friction,
        rotary_coulomb=details.pump_coulomb_torque,
        spring=load.stiffness,
        spring_centre=load.centre,
        # Pressure drop over the square root of which the partner's flow goes: R of Δp = R·Q².
        throttle=load.throttle_pressure / (100.0 * pump.displacement) ** 2,
        partner_area=area if load.throttle_pressure > 0.0 else 0.0,
        partner_compliance=volume / oil.bulk_modulus,
    )
