"""Hydraulics of one axis: pump, inner circuit, valves, chambers (eqs 3.14 to 3.19 and 3.33), compiled.

Flows are counted in mass, as volume at atmospheric density, so that what leaves one volume enters another;
the volume law is the geometric one (V1 + A1·x, V2 - A2·x). Local volume flows between chambers of unlike
pressure, or the thesis's 2(V_o ± A·x), would make oil. Linearised about rest this is eq. 5.22.

Conserved while the air fraction stays: oil in chambers and lines + in accumulators + lost.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.compiled import njit
from fdd.plant.laws import free_in_the_end, gas_pressure, lifted, oil_at, opening, orifice, poppet
from fdd.plant.parameters import Constants

Array = NDArray[np.float64]

_STARVED = 20e3
"""Pa, absolute: inlet pressure below which the pump no longer fills. Without it a pump that is not refed
would take more oil out of a chamber than is in it."""
_CHARGE_BAND = 20e3
"""Pa below its relief valve's setting from which on the charging pump's flow goes over that valve."""
_LEAST_CASE = 1e-30  # m³/(s·Pa); keeps the case's pressure defined where nothing leaks into it
_KNEE = 5e4
"""Pa over an open refeeding valve from which on its flow goes with the root of pressure (assumption)."""
_EMPTY = 1e-8
"""m³ of oil in an external accumulator below which it gives less and less."""


@njit(error_model="numpy", inline="always")
def coupling_slip(y: Array, torque: float, now: Array, par: Constants, dy: Array) -> float:
    """Speed that the pump falls behind the motor's (rad/s), also as the rate of the gap.

    A sound coupling is rigid (7.6e4 N·m/rad). A worn one lets the pump, whose own inertia is small (1.6e-5
    kg·m²), fall back through the play until its flanks carry the hydraulic torque.
    """
    gap, slip = y[s.GAP], 0.0
    if now[c.PLAY] > 0.0 or gap != 0.0:
        half = 0.5 * now[c.PLAY]
        excess = max(gap - half, 0.0) + min(gap + half, 0.0)
        slip = (torque - par.coupling_stiffness * excess) / par.coupling_damping
    dy[s.GAP] = slip
    return slip


@njit(error_model="numpy", inline="always")
def coming_free(pressure: float, free: float, par: Constants) -> float:
    """Rate (1/s) of the share of a chamber's air that is free, towards what its pressure leaves free."""
    final = free_in_the_end(pressure, par.dissolving_pressure)
    return (final - free) * (par.releasing_rate if final > free else par.dissolving_rate)


@njit(error_model="numpy", inline="always")
def hydraulic_rates(
    y: Array, x: float, v: float, linked_1: float, linked_2: float, now: Array, par: Constants,
    dy: Array, found: Array,
) -> tuple[float, float]:  # fmt: skip
    """Hydraulic torque on the pump (N·m) and power lost in the oil (W); fills the rates of all pressures.

    Parameters
    ----------
    y, dy, found : this axis's part of the state, its rates and findings.
    x, v : m and m/s of the piston.
    linked_1, linked_2 : m³/s at atmospheric density, into this axis's lines from the other's.
    """
    p1, p2 = y[s.P1], y[s.P2]
    air, ambient, stiff, inverse_n = now[c.AIR], par.ambient, par.stiff_compliance, par.polytropic_inverse
    air_1, air_2 = air, air
    if par.dissolving > 0.0:
        air_1, air_2 = air * y[s.FREE_1], air * y[s.FREE_2]
    soft_1, rho_1 = oil_at(p1, air_1, ambient, stiff, inverse_n)
    soft_2, rho_2 = oil_at(p2, air_2, ambient, stiff, inverse_n)
    if par.dissolving > 0.0:
        # Dissolved air takes no room: oil is counted with all its air free at atmospheric pressure.
        rho_1 *= math.exp(air - air_1)
        rho_2 *= math.exp(air - air_2)
    a, b, rho_a, rho_b = p1, p2, rho_1, rho_2
    soft_a, soft_b = soft_1, soft_2
    if par.blocked > 0.0:
        a, b = y[s.LINE_1], y[s.LINE_2]
        soft_a, rho_a = oil_at(a, air_1, ambient, stiff, inverse_n)
        soft_b, rho_b = oil_at(b, air_2, ambient, stiff, inverse_n)
        rho_a *= math.exp(air - air_1)
        rho_b *= math.exp(air - air_2)
    rho = 0.5 * (rho_a + rho_b)
    pa = gas_pressure(par.gas_pressure, par.gas_volume, y[s.STORE] / par.store_density) - ambient

    # The pump moves its displacement at the ports' mean density unless told otherwise.
    displacement = par.displacement * now[c.DISPLACEMENT]
    wave = par.ripple + now[c.RIPPLE]
    if wave != 0.0:
        displacement *= 1.0 + wave * math.cos(par.teeth * (y[s.ANGLE] - y[s.GAP]))
    # A coupling out of line swings the speed once a turn.
    swing = 1.0
    if now[c.ECCENTRICITY] != 0.0:
        swing += now[c.ECCENTRICITY] * math.cos(y[s.ANGLE])
    lever = displacement * swing
    turning = (y[s.SPEED] - coupling_slip(y, lever * (a - b), now, par, dy)) * swing
    pump = displacement * turning
    # Line losses lie between pump and cylinder (eqs 3.33 to 3.36).
    loss = par.line_loss * pump * abs(pump)
    a += loss
    b -= loss
    dp = a - b
    pumped = pump * rho - par.pump_compression * abs(pump) * 0.5 * (rho_a - rho_b)
    inlet = (b if pump > 0.0 else a) + ambient
    if inlet < _STARVED:
        pumped *= max(inlet, 0.0) / _STARVED

    # Across the ports: leakage, relief valves.
    cross = (now[c.CROSS_LEAKAGE] + now[c.SPEED_LEAKAGE] * abs(turning)) * dp
    if now[c.CROSS_ORIFICE] != 0.0:
        cross += orifice(dp, now[c.CROSS_ORIFICE], par.orifice_transition)
    relief = par.relief_gain * (
        opening(dp - par.relief_pressure, par.relief_width)
        - opening(-dp - par.relief_pressure, par.relief_width)
    )
    stuck = orifice(dp, now[c.RELIEF_OPEN], par.orifice_transition) if now[c.RELIEF_OPEN] != 0.0 else 0.0

    # Case drain: fed by both ports, drained through its check valve into the accumulator, losing past the
    # shaft's seal. Its volume is small and its valve wide, so its pressure is the one that balances.
    leak, shaft = now[c.CASE_LEAKAGE], now[c.SHAFT_LEAKAGE]
    both = 2.0 * leak + shaft + _LEAST_CASE
    closed = leak * (a + b) / both
    excess = opening(closed - pa - par.case_cracking, par.check_width)
    share = par.case_gain / (both + par.case_gain)
    case = closed - excess * share
    leak_a = rho * leak * (a - case)
    leak_b = rho * leak * (b - case)
    dripping = rho * shaft * max(case, 0.0)

    # Refeeding through the check valves (eq. 3.18).
    if par.check_rate == 0.0:
        refeed_a = par.refeed_gain * opening(pa - a - par.refeed_cracking, par.check_width)
        refeed_b = par.refeed_gain * opening(pa - b - par.refeed_cracking, par.check_width)
        dy[s.VALVE_1] = 0.0
        dy[s.VALVE_2] = 0.0
    else:
        # A poppet that takes its time lets oil back meanwhile; one that the other side lifts, all the time.
        crack, width = par.refeed_cracking, par.check_width
        ratio, pilot, band = par.pilot_ratio, par.pilot_cracking, par.pilot_band
        dy[s.VALVE_1] = (lifted(a, b, pa, crack, width, ratio, pilot, band) - y[s.VALVE_1]) * par.check_rate
        dy[s.VALVE_2] = (lifted(b, a, pa, crack, width, ratio, pilot, band) - y[s.VALVE_2]) * par.check_rate
        refeed_a = poppet(pa - a, par.refeed_gain * max(y[s.VALVE_1], 0.0), _KNEE)
        refeed_b = poppet(pa - b, par.refeed_gain * max(y[s.VALVE_2], 0.0), _KNEE)
    refeed_a *= now[c.REFEED_1]
    refeed_b *= now[c.REFEED_2]
    if now[c.OPEN_1] != 0.0:
        refeed_a += orifice(pa - a, now[c.OPEN_1], par.orifice_transition)
    if now[c.OPEN_2] != 0.0:
        refeed_b += orifice(pa - b, now[c.OPEN_2], par.orifice_transition)
    refeed_a *= par.store_density
    refeed_b *= par.store_density
    charge = 0.0
    if now[c.CHARGE] != 0.0:
        charge = par.store_density * now[c.CHARGE]
        charge *= min(max((par.charging_pressure - pa) / _CHARGE_BAND, 0.0), 1.0)

    across = pumped - rho * (cross + relief + stuck)
    to_a = across - leak_a + refeed_a + linked_1
    to_b = -across - leak_b + refeed_b + linked_2

    # At the cylinder: its seal, by-pass and throttle, leaks to the outside, external accumulators.
    past = now[c.SEAL_LEAKAGE] * (p1 - p2)
    if now[c.BYPASS] != 0.0:
        past += orifice(p1 - p2, now[c.BYPASS], par.orifice_transition)
    past_mass = past * 0.5 * (rho_1 + rho_2)
    out_1 = rho_1 * now[c.OUTSIDE_1] * max(p1, 0.0)
    out_2 = rho_2 * now[c.OUTSIDE_2] * max(p2, 0.0)
    to_1 = -past_mass - out_1
    to_2 = past_mass - out_2
    dy[s.EXTERNAL_1] = 0.0
    dy[s.EXTERNAL_2] = 0.0
    if par.external_flow > 0.0:
        for i in range(2):
            held = y[s.EXTERNAL_1 + i]
            gas = gas_pressure(par.external_pressure, par.external_volume, held) - ambient
            flow = orifice((p1 if i == 0 else p2) - gas, par.external_flow, par.orifice_transition)
            if flow < 0.0:
                flow *= min(max(held / _EMPTY, 0.0), 1.0)
            dy[s.EXTERNAL_1 + i] = flow
            if i == 0:
                to_1 -= flow
            else:
                to_2 -= flow

    push_1, push_2 = par.area_1 * v, par.area_2 * v
    if par.blocked > 0.0:
        v1 = par.cylinder_volume_1 + par.area_1 * x
        v2 = par.cylinder_volume_2 - par.area_2 * x
        dy[s.LINE_1] = to_a / (soft_a * rho_a * par.line_volume_1)
        dy[s.LINE_2] = to_b / (soft_b * rho_b * par.line_volume_2)
        dy[s.P1] = (to_1 - rho_1 * push_1) / (soft_1 * rho_1 * v1)
        dy[s.P2] = (to_2 + rho_2 * push_2) / (soft_2 * rho_2 * v2)
        inside = v1 * rho_1 + v2 * rho_2 + par.line_volume_1 * rho_a + par.line_volume_2 * rho_b
    else:
        v1 = par.volume_1 + par.area_1 * x
        v2 = par.volume_2 - par.area_2 * x
        dy[s.P1] = (to_a + to_1 - rho_1 * push_1) / (soft_1 * rho_1 * v1)
        dy[s.P2] = (to_b + to_2 + rho_2 * push_2) / (soft_2 * rho_2 * v2)
        dy[s.LINE_1] = dy[s.P1]
        dy[s.LINE_2] = dy[s.P2]
        inside = v1 * rho_1 + v2 * rho_2
    dy[s.FREE_1] = 0.0
    dy[s.FREE_2] = 0.0
    if par.dissolving > 0.0:
        dy[s.FREE_1] = coming_free(p1, y[s.FREE_1], par)
        dy[s.FREE_2] = coming_free(p2, y[s.FREE_2], par)
        # Of the logarithm of volume over oil, what free air takes is in proportion to its share.
        dy[s.P1] += (air + p1 * stiff - math.log(rho_1)) * dy[s.FREE_1] / (y[s.FREE_1] * soft_1)
        dy[s.P2] += (air + p2 * stiff - math.log(rho_2)) * dy[s.FREE_2] / (y[s.FREE_2] * soft_2)
        if par.blocked > 0.0:
            dy[s.LINE_1] += (
                (air + y[s.LINE_1] * stiff - math.log(rho_a)) * dy[s.FREE_1] / (y[s.FREE_1] * soft_a)
            )
            dy[s.LINE_2] += (
                (air + y[s.LINE_2] * stiff - math.log(rho_b)) * dy[s.FREE_2] / (y[s.FREE_2] * soft_b)
            )
        else:
            dy[s.LINE_1] = dy[s.P1]
            dy[s.LINE_2] = dy[s.P2]
    outside = out_1 + out_2 + dripping
    dy[s.STORE] = leak_a + leak_b - dripping - refeed_a - refeed_b + charge
    dy[s.LOST] = outside - charge

    found[s.PUMP_FLOW] = pump
    found[s.CROSS_FLOW] = cross
    found[s.BYPASS_FLOW] = past
    found[s.REFEED_FLOW_1] = refeed_a
    found[s.REFEED_FLOW_2] = refeed_b
    found[s.DRAIN_FLOW] = leak_a + leak_b
    found[s.RELIEF_FLOW] = relief
    found[s.STUCK_RELIEF_FLOW] = stuck
    found[s.OUTSIDE_FLOW] = outside
    found[s.CONNECT_FLOW_1] = linked_1
    found[s.CONNECT_FLOW_2] = linked_2
    found[s.ACCUMULATOR] = pa
    found[s.CASE_PRESSURE] = case
    found[s.PORT_DIFFERENCE] = dp
    found[s.OIL_MASS] = inside + y[s.STORE] + y[s.LOST] + y[s.EXTERNAL_1] + y[s.EXTERNAL_2]
    heat = (cross + relief + stuck) * dp + past * (p1 - p2) + 2.0 * abs(loss * pump)
    # The torque pulses and swings as the flow does: a pump that gave more than it takes would make energy.
    return lever * dp, heat
