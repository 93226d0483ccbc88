"""The plant's constants as the compiled loop takes them: from the unit, the scenario and the run's draw."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fdd.errors import InputError
from fdd.plant.circuit import Circuit
from fdd.plant.details import Details
from fdd.plant.load import Load
from fdd.plant.oil import ATMOSPHERE, BUNSEN, SOFTENING, VAPOUR_PRESSURE, stiff_bulk_modulus, viscosity
from fdd.unit import Drive, Unit


class Parameters(NamedTuple):
    """Constants of one run, SI."""

    # cylinder and what it moves
    area_1: float
    area_2: float
    volume_1: float
    volume_2: float
    cylinder_volume_1: float
    cylinder_volume_2: float
    line_volume_1: float
    line_volume_2: float
    blocked: float
    """1 where the valve between pump and cylinder is shut, 0 where it is open."""
    half_stroke: float
    mass: float
    stop_stiffness: float
    stop_damping: float
    cushion_length: float
    cushion_damping: float
    # friction: LuGre, a curve for each direction, times the run's draw
    bristle_stiffness: float
    bristle_damping: float
    bristle_fade: float
    friction_rate: float
    breakaway: float
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
    friction_law: float
    """Index into `FRICTION_LAWS`."""
    smooth_width: float
    seal_area: float
    """m², by which the mean pressure of both chambers adds to the seals' friction."""
    # oil
    stiff_compliance: float
    softening: float
    expansion: float
    reference_temperature: float
    vapour_pressure: float
    polytropic_inverse: float
    ambient: float
    dissolving: float
    """1/Pa: one over the gauge pressure at which air is as dissolved as it gets; 0 where it stays free."""
    releasing: float
    """1/Pa: air that comes out of solution for each pascal below the surroundings' pressure."""
    dissolving_rate: float
    releasing_rate: float
    air_scale: float
    """All air over what is free at the oil's reference pressure."""
    film_share: float
    # pump and inner circuit
    displacement: float
    teeth: float
    ripple: float
    pump_compression: float
    line_loss: float
    coupling_stiffness: float
    coupling_damping: float
    refeed_cracking: float
    refeed_gain: float
    case_cracking: float
    case_gain: float
    check_width: float
    check_rate: float
    """1/s of the refeeding valves' poppets."""
    check_hysteresis: float
    pilot_ratio: float
    pilot_cracking: float
    pilot_band: float
    orifice_transition: float
    relief_pressure: float
    relief_gain: float
    relief_width: float
    relief_rate: float
    relief_hysteresis: float
    gas_pressure: float
    """Pa, absolute, of the gas at rest."""
    gas_volume: float
    """m³ of the gas at rest."""
    shell_volume: float
    full: float
    """m³ of oil at which the separator comes to its stop on the gas's side."""
    full_stiffness: float
    gallery_gas: float
    gas_work: float
    """Share of its absolute temperature at rest by which a joule of work heats the gas: (γ - 1)/(p·V)."""
    gas_rate: float
    gas_warming: float
    shares: float
    """1 where the axis has no accumulator but the first axis's."""
    store_density: float
    """Of the accumulator's oil at its charge pressure and the reference temperature."""
    charging_pressure: float
    external_flow: float
    external_pressure: float
    external_volume: float
    # drive
    max_speed: float
    command_dead_band: float
    loop_gain: float
    loop_integral: float
    loop_feed: float
    current_rate: float
    current_limit: float
    voltage_limit: float
    winding_resistance: float
    winding_inductance: float
    back_emf: float
    torque_constant: float
    inertia: float
    rotary_viscous: float
    rotary_coulomb: float
    pump_friction: float
    pump_drag: float
    pole_pairs: float
    cogging_torque: float
    winding_rate: float
    continuous_current: float
    # load
    spring: float
    spring_centre: float
    spring_play: float
    one_sided: float
    """1 where the spring only presses, beyond its centre."""
    throttle: float
    partner_area: float
    partner_compliance: float
    # heat
    heat_capacity: float
    cooling: float
    surroundings: float


FRICTION_LAWS = ("elastoplastic", "lugre", "dahl", "smooth")
ELASTOPLASTIC, LUGRE, DAHL, SMOOTH = range(4)
_FULL = 0.95
"""Of the shell: most that is oil, before the separator reaches its stop."""

Constants = Any
"""`Parameters` as the compiled functions take them, by reference: a NumPy record with the same names."""


def as_record(parameters: Parameters) -> Constants:
    """The parameters as a NumPy record, which compiled functions read by name without copying."""
    kind = np.dtype([(name, np.float64) for name in Parameters._fields])
    return np.rec.array([tuple(parameters)], dtype=kind)[0]


def velocity_loop(drive: Drive, current_lag: float) -> tuple[float, float, float, float]:
    """Gains of the velocity loop that has the drive's poles and zero, and the current loop's rate.

    With a current loop of lag τ the speed follows ω/c = (f·s + k2)/(τs³ + s² + k1·s + k2). Two of its poles
    are the drive's; their sum is 1/τ, so the third lies at p3 = 1/τ - p1 - p2.

    Parameters
    ----------
    drive : poles and zero of eq. 6.11 (1/s).
    current_lag : τ wanted (s); shortened where the drive's own poles are nearly as fast.

    Returns
    -------
    loop_gain k1 (1/s), loop_integral k2 (1/s²), loop_feed f (1/s), current_rate 1/τ (1/s).

    Examples
    --------
    >>> k1, k2, f, rate = velocity_loop(Unit.load("axis_a").drive, 4e-4)
    >>> sorted(round(-float(p.real), 1) for p in np.roots([1 / rate, 1.0, k1, k2]))[:2]
    [242.9, 517.9]
    """
    total, product = drive.pole_1 + drive.pole_2, drive.pole_1 * drive.pole_2
    rate = max(1.0 / current_lag, 3.0 * total)
    third = rate - total
    integral = product * third / rate
    return (product + third * total) / rate, integral, integral / drive.zero, rate


def plant_parameters(
    unit: Unit,
    details: Details,
    load: Load,
    *,
    circuit: Circuit | None = None,
    charge_factor: float = 1.0,
    ambient: float = ATMOSPHERE,
    friction_draw: tuple[float, float] = (1.0, 1.0),
    surroundings: float = 40.0,
    joined_mass: float = 0.0,
    shares: bool = False,
) -> Parameters:
    """Everything constant over a run.

    Parameters
    ----------
    unit : the actuator.
    details : of the plant, beyond the unit.
    load : what the rod pushes against.
    circuit : the rig's valves around it (section 4.6).
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
    for name, volume, area in (
        ("volume_1", cylinder.volume_1, cylinder.area_1),
        ("volume_2", cylinder.volume_2, cylinder.area_2),
    ):
        if share * volume <= 1.05 * area * half:
            raise InputError(
                f"{name} {volume * 1e6:.0f} cm³ is empty at the stroke's end ({area * half * 1e6:.0f} cm³)",
                where=f"unit {unit.name} cylinder",
                mend="enlarge it or shorten stroke",
            )
    charge = unit.accumulator.charge_pressure * charge_factor
    mass = cylinder.moving_mass + joined_mass + load.mass
    gain, integral, feed, rate = velocity_loop(drive, details.current_lag)
    external = circuit.accumulators
    n = oil.polytropic_index
    stiff = 1.0 / stiff_bulk_modulus(oil)
    tank = unit.accumulator
    shell = tank.gas_volume + tank.oil_at_rest
    dissolves = float(details.air_law == "dissolving")
    left = 1.0 - 0.9 * dissolves * min(oil.reference_pressure / details.dissolving_pressure, 1.0)
    ahead, back = friction_draw
    forward, reverse = unit.friction.forward, unit.friction.reverse
    area = 0.5 * (cylinder.area_1 + cylinder.area_2)
    volume = 0.25 * (cylinder.volume_1 + cylinder.volume_2)
    return Parameters(
        area_1=cylinder.area_1,
        area_2=cylinder.area_2,
        volume_1=cylinder.volume_1,
        volume_2=cylinder.volume_2,
        cylinder_volume_1=0.5 * cylinder.volume_1,
        cylinder_volume_2=0.5 * cylinder.volume_2,
        line_volume_1=0.5 * cylinder.volume_1,
        line_volume_2=0.5 * cylinder.volume_2,
        blocked=float(circuit.blocked),
        half_stroke=half,
        mass=mass,
        stop_stiffness=details.stop_stiffness,
        stop_damping=details.stop_damping,
        cushion_length=details.cushion_length,
        cushion_damping=details.cushion_damping,
        bristle_stiffness=details.bristle_stiffness,
        bristle_damping=2.0
        * details.bristle_damping
        * math.sqrt(details.bristle_stiffness * cylinder.moving_mass),
        bristle_fade=details.bristle_fade,
        friction_rate=1.0 / details.friction_memory,
        breakaway=details.breakaway,
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
        friction_law=float(FRICTION_LAWS.index(details.friction_law)),
        smooth_width=details.smooth_width,
        seal_area=details.seal_pressure * area,
        stiff_compliance=stiff,
        softening=SOFTENING,
        expansion=oil.thermal_expansion,
        reference_temperature=oil.reference_temperature,
        vapour_pressure=VAPOUR_PRESSURE,
        polytropic_inverse=1.0 / n,
        ambient=ambient,
        dissolving=dissolves / details.dissolving_pressure,
        releasing=dissolves * BUNSEN / ATMOSPHERE,
        dissolving_rate=1.0 / details.dissolving_time,
        releasing_rate=1.0 / details.releasing_time,
        air_scale=1.0 / left,
        film_share=details.film_share,
        displacement=pump.displacement,
        teeth=float(details.pump_teeth),
        ripple=details.pump_ripple,
        pump_compression=details.pump_compression,
        line_loss=details.line_loss,
        coupling_stiffness=details.coupling_stiffness,
        coupling_damping=details.coupling_damping,
        refeed_cracking=unit.accumulator.refeed_cracking_pressure,
        refeed_gain=unit.accumulator.refeed_flow_gain,
        case_cracking=unit.accumulator.case_cracking_pressure,
        case_gain=unit.accumulator.refeed_flow_gain,
        check_width=details.check_width,
        check_rate=1.0 / details.check_lag,
        check_hysteresis=details.check_hysteresis,
        pilot_ratio=details.pilot_ratio,
        pilot_cracking=details.pilot_cracking,
        pilot_band=details.pilot_band,
        orifice_transition=details.orifice_transition,
        relief_pressure=unit.accumulator.relief_pressure,
        relief_gain=unit.accumulator.relief_flow_gain,
        relief_width=details.relief_width,
        relief_rate=1.0 / details.relief_lag,
        relief_hysteresis=details.relief_hysteresis,
        gas_pressure=charge + ambient,
        gas_volume=tank.gas_volume,
        shell_volume=shell,
        full=_FULL * shell,
        full_stiffness=oil.bulk_modulus / details.gallery_volume,
        gallery_gas=details.gallery_gas * details.gallery_volume,
        gas_work=0.4 / ((charge + ambient) * tank.gas_volume),
        gas_rate=1.0 / details.gas_time,
        gas_warming=details.gas_warming / (surroundings + 273.15),
        shares=float(shares),
        store_density=math.exp(charge * stiff),
        charging_pressure=circuit.charging_pressure,
        external_flow=external.valve_flow if external else 0.0,
        external_pressure=external.gas_charge + ambient if external else 1.0,
        external_volume=external.gas_volume if external else 1.0,
        max_speed=drive.max_speed,
        command_dead_band=details.command_dead_band,
        loop_gain=gain,
        loop_integral=integral,
        loop_feed=feed,
        current_rate=rate,
        current_limit=drive.current_limit,
        voltage_limit=drive.voltage_limit,
        winding_resistance=drive.winding_resistance,
        winding_inductance=drive.winding_inductance,
        back_emf=drive.back_emf_constant,
        torque_constant=drive.torque_constant,
        inertia=drive.inertia,
        rotary_viscous=drive.viscous_friction,
        rotary_coulomb=details.pump_coulomb_torque,
        pump_friction=details.pump_friction,
        pump_drag=details.pump_drag
        * oil.density
        * float(viscosity(oil, oil.reference_temperature))
        * pump.displacement,
        pole_pairs=float(details.pole_pairs),
        cogging_torque=details.cogging_torque * pump.displacement * unit.accumulator.relief_pressure,
        winding_rate=1.0 / details.winding_time,
        continuous_current=details.continuous_share * drive.current_limit,
        spring=load.stiffness,
        spring_centre=load.centre,
        spring_play=load.play,
        one_sided=float(load.one_sided),
        # Pressure drop over the square root of which the partner's flow goes: R of Δp = R·Q².
        throttle=load.throttle_pressure / (100.0 * pump.displacement) ** 2,
        partner_area=area if load.throttle_pressure > 0.0 else 0.0,
        partner_compliance=volume / oil.bulk_modulus,
        heat_capacity=details.heat_capacity,
        cooling=details.cooling,
        surroundings=surroundings,
    )
