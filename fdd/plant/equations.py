"""The plant's equations: state, right-hand side, and what flows where.

Symbols
-------
p1, p2    chamber pressures, gauge              x, v   piston position and velocity
z         mean bristle deflection (eq. 5.8)     q      integrator of the velocity loop
w         velocity that the seal remembers
ρ1, ρ2    oil density over that at atmospheric pressure, ρ = exp ∫dp/β
m         oil flows counted at atmospheric density, so that what leaves one volume enters another

The thesis's eqs 3.14 to 3.18 with the geometric volume law (V1 + A1·x, V2 - A2·x) and with flows
in mass rather than volume: local volume flows between chambers of unlike pressure would make oil
(about 100 kPa of mean pressure in 10 s of strokes). Linearised about rest this is eq. 5.22.

Conserved while the air fraction stays: V1·ρ1 + V2·ρ2 + oil in the accumulator.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fdd.plant.conditions import (
    AIR,
    CASE_LEAKAGE,
    CROSS_LEAKAGE,
    FORCE,
    FRICTION,
    OPEN_1,
    OPEN_2,
    RELIEF_OPEN,
    TORQUE,
    VISCOUS,
)
from fdd.plant.conditions import REFEED_1 as REFEED_LEFT_1
from fdd.plant.conditions import REFEED_2 as REFEED_LEFT_2
from fdd.plant.oil import ATMOSPHERE
from fdd.plant.parameters import Parameters

Array = NDArray[np.float64]

# State.
X, V, P1, P2, Z, ANGLE, SPEED, DRIVE, STORE, PARTNER, MEMORY = range(11)
STATES = 11
"""x, v, p1, p2, z, pump angle, pump speed, drive integrator, oil taken by the accumulator since
the start (m³ at atmospheric density), pressure drop over the throttled partner, velocity as the seal
remembers it."""

# What else the right-hand side finds on its way.
(
    FRICTION_FORCE,
    LOAD_FORCE,
    STOP_FORCE,
    CURRENT,
    PUMP_FLOW,
    CROSS_FLOW,
    REFEED_1,
    REFEED_2,
    DRAIN_FLOW,
    RELIEF_FLOW,
    ACCUMULATOR,
    DECAY,
    OIL_MASS,
    STUCK_RELIEF_FLOW,
) = range(14)
FINDINGS = 14
"""Forces (N), motor current (A), flows (m³/s; refeeding and drain at atmospheric density), accumulator
pressure (Pa, gauge), decay rate of the bristle (1/s), all the oil inside (m³ at atmospheric density)."""

_LEAST_ABSOLUTE = 1.0  # Pa; guards the power law within a step, the air's compliance keeps the state above
_STARVED = 20e3
"""Pa, absolute: inlet pressure below which the pump no longer fills. Without it a pump that is not refed
would take more oil out of a chamber than is in it."""


@njit(cache=True, error_model="numpy")
def opening(excess: float, width: float) -> float:
    """Excess of pressure over a valve's setting, with a smooth start: softplus."""
    t = excess / width
    if t > 15.0:
        return excess
    if t < -15.0:
        return 0.0
    return width * math.log1p(math.exp(t))


@njit(cache=True, error_model="numpy")
def orifice(drop: float, flow_at_1_mpa: float, transition: float) -> float:
    """Signed flow through an orifice, laminar below the transition: k·Δp/(Δp² + Δp_tr²)^¼."""
    return flow_at_1_mpa * 1e-3 * drop / math.sqrt(math.sqrt(drop * drop + transition * transition))


@njit(cache=True, error_model="numpy")
def oil_at(
    pressure: float, air: float, ambient: float, stiff: float, inverse_n: float
) -> tuple[float, float]:
    """Bulk modulus (Pa) and density over that at atmospheric pressure."""
    absolute = max(pressure + ambient, _LEAST_ABSOLUTE)
    gas = (ATMOSPHERE / absolute) ** inverse_n
    modulus = 1.0 / (stiff + air * gas * inverse_n / absolute)
    return modulus, math.exp(pressure * stiff + air * (1.0 - gas))


@njit(cache=True, error_model="numpy")
def right_hand_side(y: Array, command: float, now: Array, par: Parameters, dy: Array, found: Array) -> None:
    """Time derivative of the state.

    Parameters
    ----------
    y : (STATES,) state.
    command : rad/s, speed demanded of the drive (after its delay).
    now : (COLUMNS,) conditions of this millisecond.
    par : constants.
    dy : (STATES,) is filled with the derivative.
    found : (FINDINGS,) is filled with forces, flows and current.
    """
    x, v, p1, p2, z, speed = y[X], y[V], y[P1], y[P2], y[Z], y[SPEED]
    dp = p1 - p2

    # Oil and accumulator (isothermal gas).
    air = now[AIR]
    beta_1, rho_1 = oil_at(p1, air, par.ambient, par.stiff_compliance, par.polytropic_inverse)
    beta_2, rho_2 = oil_at(p2, air, par.ambient, par.stiff_compliance, par.polytropic_inverse)
    rho = 0.5 * (rho_1 + rho_2)
    gas = par.gas_volume - y[STORE] / par.store_density
    pa = par.gas_pressure * par.gas_volume / gas - par.ambient

    # Flows. The pump moves its displacement at the ports' mean density unless told otherwise.
    pump = par.displacement * speed * (1.0 + par.ripple * math.cos(par.teeth * y[ANGLE]))
    pumped = pump * rho - par.pump_compression * abs(pump) * 0.5 * (rho_1 - rho_2)
    inlet = (p2 if pump > 0.0 else p1) + par.ambient
    if inlet < _STARVED:
        pumped *= max(inlet, 0.0) / _STARVED
    cross = now[CROSS_LEAKAGE] * dp
    relief = par.relief_gain * (
        opening(dp - par.relief_pressure, par.relief_width)
        - opening(-dp - par.relief_pressure, par.relief_width)
    )
    stuck = orifice(dp, now[RELIEF_OPEN], par.orifice_transition) if now[RELIEF_OPEN] != 0.0 else 0.0
    mean = 0.5 * (p1 + p2)
    # The case drain's check valve passes outwards only: the case sits at the accumulator's
    # pressure plus cracking, or at the ports' mean where that is lower.
    case = mean - opening(mean - pa - par.case_cracking, par.check_width)
    leak_1 = rho * now[CASE_LEAKAGE] * (p1 - case)
    leak_2 = rho * now[CASE_LEAKAGE] * (p2 - case)
    refeed_1 = now[REFEED_LEFT_1] * par.refeed_gain * opening(pa - p1 - par.refeed_cracking, par.check_width)
    refeed_2 = now[REFEED_LEFT_2] * par.refeed_gain * opening(pa - p2 - par.refeed_cracking, par.check_width)
    if now[OPEN_1] != 0.0:
        refeed_1 += orifice(pa - p1, now[OPEN_1], par.orifice_transition)
    if now[OPEN_2] != 0.0:
        refeed_2 += orifice(pa - p2, now[OPEN_2], par.orifice_transition)
    refeed_1 *= par.store_density
    refeed_2 *= par.store_density

    across = pumped - rho * (cross + (relief + stuck))
    v1 = par.volume_1 + par.area_1 * x
    v2 = par.volume_2 - par.area_2 * x
    dy[P1] = beta_1 / v1 * ((across - leak_1 + refeed_1) / rho_1 - par.area_1 * v)
    dy[P2] = beta_2 / v2 * ((-across - leak_2 + refeed_2) / rho_2 + par.area_2 * v)
    dy[STORE] = leak_1 + leak_2 - refeed_1 - refeed_2

    # Friction: LuGre, with the curve of the present direction (eqs 5.8 to 5.12). The lubricant's
    # film, and with it the curve, follows the velocity with a lag; the seal resists what is quicker.
    # Without that, the falling curve would drive the hydraulic resonance to its limit at any speed.
    size = abs(v)
    memory = y[MEMORY]
    dy[MEMORY] = (v - memory) / par.friction_memory
    film = abs(memory)
    if v >= 0.0:
        coulomb, static = par.coulomb_forward, par.static_forward
        stribeck, exponent, viscous = par.stribeck_forward, par.exponent_forward, par.viscous_forward
    else:
        coulomb, static = par.coulomb_reverse, par.static_reverse
        stribeck, exponent, viscous = par.stribeck_reverse, par.exponent_reverse, par.viscous_reverse
    steady = now[FRICTION] * (coulomb + (static - coulomb) * math.exp(-((film / stribeck) ** exponent)))
    decay = par.bristle_stiffness * size / max(steady, 1e-3)
    dz = v - decay * z
    fade = par.bristle_fade * par.bristle_fade
    friction = (
        par.bristle_stiffness * z
        + par.bristle_damping * fade / (fade + v * v) * dz
        + par.seal_damping * (v - memory)
        + now[VISCOUS] * viscous * v
    )
    dy[Z] = dz

    # Load, end stops, piston.
    partner = y[PARTNER]
    load = now[FORCE] + par.spring * (x - par.spring_centre) + par.partner_area * partner
    if par.partner_area > 0.0:
        through = partner / math.sqrt(
            par.throttle * math.sqrt(partner * partner + par.orifice_transition * par.orifice_transition)
        )
        dy[PARTNER] = (par.partner_area * v - through) / par.partner_compliance
    else:
        dy[PARTNER] = 0.0
    stop = 0.0
    if x > par.half_stroke:
        stop = max(par.stop_stiffness * (x - par.half_stroke) * (1.0 + par.stop_damping * v), 0.0)
    elif x < -par.half_stroke:
        stop = min(par.stop_stiffness * (x + par.half_stroke) * (1.0 - par.stop_damping * v), 0.0)
    dy[X] = v
    dy[V] = (par.area_1 * p1 - par.area_2 * p2 - friction - load - stop) / par.mass

    # Drive: the velocity loop of eq. 6.11 as the PI controller that gives it, so that load torque
    # disturbs it and the current can limit it; the current loop itself is taken as fast.
    turning = par.rotary_viscous * speed + par.rotary_coulomb * speed / math.sqrt(1.0 + speed * speed)
    wanted = (
        par.inertia * (y[DRIVE] - par.pole_sum * speed + par.feedthrough * command)
        + par.rotary_viscous * speed
    )
    # Torques as the drive counts them, by the healthy motor's constant: it does not know of a weaker one.
    allowed = min(max(wanted, -par.torque_limit), par.torque_limit)
    torque = now[TORQUE] * allowed
    dy[ANGLE] = speed
    dy[SPEED] = (torque - par.displacement * dp - turning) / par.inertia
    dy[DRIVE] = par.pole_product * (command - speed) + par.pole_sum * (allowed - wanted) / par.inertia

    found[FRICTION_FORCE] = friction
    found[LOAD_FORCE] = load
    found[STOP_FORCE] = stop
    found[CURRENT] = allowed / par.torque_constant
    found[PUMP_FLOW] = pump
    found[CROSS_FLOW] = cross
    found[REFEED_1] = refeed_1
    found[REFEED_2] = refeed_2
    found[DRAIN_FLOW] = leak_1 + leak_2
    found[RELIEF_FLOW] = relief
    found[STUCK_RELIEF_FLOW] = stuck
    found[ACCUMULATOR] = pa
    found[DECAY] = decay
    found[OIL_MASS] = v1 * rho_1 + v2 * rho_2 + y[STORE]
