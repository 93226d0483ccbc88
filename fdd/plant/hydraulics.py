"""Hydraulics of one axis: pump, inner circuit, valves, chambers (eqs 3.14 to 3.19 and 3.33), compiled.

Flows are counted in mass, as volume of pure oil at gauge zero and the reference temperature, so that what
leaves one volume enters another; the volume law is the geometric one (V1 + A1·x, V2 - A2·x). Local volume
flows between chambers of unlike pressure, or the thesis's 2(V_o ± A·x), would make oil. Linearised about rest
this is eq. 5.22. Air is no oil: where it comes or goes, oil is what is conserved.

Conserved: oil in chambers and lines + in accumulators + lost.
"""

from __future__ import annotations

import math

from fdd.plant import Array, Constants
from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.compiled import njit
from fdd.plant.oil import oil_at, settled_air

_STARVED = 20e3
"""Pa, absolute: inlet pressure below which the pump no longer fills. Without it a pump that is not refed
would take more oil out of a chamber than is in it."""
_CHARGE_BAND = 20e3
"""Pa below its relief valve's setting from which on the charging pump's flow goes over that valve."""
_LEAST_CASE = 1e-30  # m³/(s·Pa); keeps the case's pressure defined where nothing leaks into it
_KNEE = 5e4
"""Pa over an open refeeding valve from which on its flow goes with the root of pressure (assumption)."""
_SHUT = 1e-7
"""Lift below which a refeeding valve passes nothing."""
_EMPTY = 1e-8
"""m³ of oil in an external accumulator below which it gives less and less."""


@njit(error_model="numpy", inline="always")
def opening(excess: float, width: float) -> float:
    """Excess of pressure over a valve's setting, with a smooth start.

    The polynomial of fourth degree that leaves zero at -width and meets `excess` at +width with equal
    slope and curvature: a closed valve is exactly closed, unlike a softplus.
    """
    if excess >= width:
        return excess
    if excess <= -width:
        return 0.0
    u = excess / width
    return width * (0.1875 + u * (0.5 + u * (0.375 - 0.0625 * u * u)))


@njit(error_model="numpy", inline="always")
def past_band(value: float, band: float) -> float:
    """What of a value lies beyond ± `band`, with its sign: through a play or a dead band."""
    return max(value - band, 0.0) + min(value + band, 0.0)


@njit(error_model="numpy", inline="always")
def orifice(drop: float, flow_at_1_mpa: float, transition: float) -> float:
    """Signed flow through an orifice, laminar below the transition: k·Δp/(Δp² + Δp_tr²)^¼.

    Ellman and Piché's two-regime idea (doi:10.1115/1.2802540) in one smooth formula.
    """
    return flow_at_1_mpa * 1e-3 * drop / math.sqrt(math.sqrt(drop * drop + transition * transition))


@njit(error_model="numpy", inline="always")
def lift_rate(
    own: float, other: float, inner: float, lift: float, crack: float, stick: float, par: Constants
) -> float:
    """Rate (1/s) of a refeeding valve's poppet, towards the lift at which its spring or pilot lets it rest.

    Friction holds a raised poppet until the pressure falls by the hysteresis. A pilot of area ratio r lifts
    it off its seat once the other chamber's pressure beats its own, fully over a band. A poppet that sticks
    does not shut before its own chamber presses on it with `stick`.
    """
    drop = inner - own
    rest, held = 0.0, 0.0
    if drop > 1.0:
        excess = drop - par.refeed_cracking - crack
        rest = opening(excess, par.check_width) / drop
        if lift > rest:
            held = opening(excess + par.check_hysteresis, par.check_width) / drop
    if par.pilot_ratio > 0.0:
        excess = opening(par.pilot_ratio * (other - inner) + drop - par.pilot_cracking, par.check_width)
        rest = max(rest, min(excess / par.pilot_band, 1.0))
    if lift > rest:
        if stick > 0.0 and -drop < stick:
            return 0.0
        return min(max(rest, held) - lift, 0.0) * par.check_rate
    return (rest - lift) * par.check_rate


@njit(error_model="numpy", inline="always")
def poppet(drop: float, gain: float, knee: float) -> float:
    """Signed flow through an open poppet valve: linear with that gain, a square root beyond the knee."""
    return gain * drop / math.sqrt(1.0 + abs(drop) / knee)


@njit(error_model="numpy", inline="always")
def coupling_slip(y: Array, torque: float, now: Array, par: Constants, dy: Array) -> float:
    """Speed that the pump falls behind the motor's (rad/s), also as the rate of the gap.

    A sound coupling is rigid (7.6e4 N·m/rad). A worn one lets the pump, whose own inertia is small (1.6e-5
    kg·m²), fall back through the play until its flanks carry the hydraulic torque.
    """
    gap, slip = y[s.GAP], 0.0
    if now[c.PLAY] > 0.0 or gap != 0.0:
        excess = past_band(gap, 0.5 * now[c.PLAY])
        slip = (torque - par.coupling_stiffness * excess) / par.coupling_damping
    dy[s.GAP] = slip
    return slip


@njit(error_model="numpy", inline="always")
def air_rate(pressure: float, free: float, air: float, par: Constants) -> float:
    """Rate (1/s) of a chamber's free air towards what its pressure leaves free: out quicker than in."""
    final = settled_air(pressure, air * par.air_scale, par)
    return (final - free) * (par.releasing_rate if final > free else par.dissolving_rate)


@njit(error_model="numpy", inline="always")
def relief_rate(drop: float, lift: float, setting: float, par: Constants) -> float:
    """Rate (Pa/s) of the relief valves' lift: their friction holds it until the pressure falls by the
    hysteresis."""
    if lift == 0.0 and abs(drop) < setting - par.relief_width:
        return 0.0
    sign = -1.0 if drop < 0.0 else 1.0
    excess, raised = sign * drop - setting, sign * lift
    rising = opening(excess, par.relief_width)
    if raised < rising:
        return sign * (rising - raised) * par.relief_rate
    falling = opening(excess + par.relief_hysteresis * setting, par.relief_width)
    return sign * min(falling - raised, 0.0) * par.relief_rate


@njit(error_model="numpy", inline="always")
def outside_flow(pressure: float, laminar: float, turbulent: float, opened: float, width: float) -> float:
    """Volume flow (m³/s) to the outside of a chamber at a gauge pressure."""
    if pressure <= 0.0:
        return 0.0
    flow = (laminar + opened * pressure) * pressure
    if turbulent != 0.0:
        flow += orifice(pressure, turbulent, width)
    return flow


@njit(error_model="numpy", inline="always")
def hydraulic_rates(
    y: Array, x: float, v: float, pa: float, linked_1: float, linked_2: float, now: Array, par: Constants,
    dy: Array, found: Array,
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """Hydraulic torque on the pump (N·m), power lost in the oil (W), and what a kelvin of warming adds to
    each pressure, chambers and lines (Pa/K); fills the rates of all pressures.

    `y`, `dy`, `found` are this axis's part of the state, its rates and findings, `x` (m) and `v` (m/s) the
    piston's, `pa` (Pa, gauge) of the accumulator that the axis has or shares, `linked_1`, `linked_2` mass
    flows into its lines from the other's.
    """
    p1, p2, free_1, free_2 = y[s.P1], y[s.P2], y[s.FREE_1], y[s.FREE_2]
    warm = y[s.TEMPERATURE] - par.reference_temperature
    vapour = now[c.VAPOUR]
    width = par.orifice_transition * now[c.TRANSITION]
    soft_1, log_1, gas_1, swell_1 = oil_at(p1, free_1, warm, vapour, par)
    soft_2, log_2, gas_2, swell_2 = oil_at(p2, free_2, warm, vapour, par)
    rho_1, rho_2 = math.exp(log_1), math.exp(log_2)
    a, b, rho_a, rho_b = p1, p2, rho_1, rho_2
    soft_a, soft_b, gas_a, gas_b, swell_a, swell_b = soft_1, soft_2, gas_1, gas_2, swell_1, swell_2
    if par.blocked > 0.0:
        a, b = y[s.LINE_1], y[s.LINE_2]
        soft_a, log_a, gas_a, swell_a = oil_at(a, free_1, warm, vapour, par)
        soft_b, log_b, gas_b, swell_b = oil_at(b, free_2, warm, vapour, par)
        rho_a, rho_b = math.exp(log_a), math.exp(log_b)
    rho = 0.5 * (rho_a + rho_b)
    rho_store = now[c.STORE_DENSITY]

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
    line_a, line_b = a, b
    a += loss
    b -= loss
    dp = a - b
    pumped = pump * rho - par.pump_compression * abs(pump) * 0.5 * (rho_a - rho_b)
    inlet = (b if pump > 0.0 else a) + par.ambient
    if inlet < _STARVED:
        pumped *= max(inlet, 0.0) / _STARVED

    # Across the ports: leakage, relief valves.
    cross = now[c.CROSS_LEAKAGE] + now[c.SPEED_LEAKAGE] * abs(turning) + now[c.CROSS_OPENING] * abs(dp)
    cross *= dp
    if now[c.CROSS_ORIFICE] != 0.0:
        cross += orifice(dp, now[c.CROSS_ORIFICE], width)
    setting = par.relief_pressure * now[c.RELIEF_SETTING]
    dy[s.RELIEF] = relief_rate(dp, y[s.RELIEF], setting, par)
    relief = 0.0
    if y[s.RELIEF] != 0.0:
        # Below the setting less, as less pressure drives it.
        drives = min(max(dp / setting, -1.0), 1.0)
        relief = par.relief_gain * now[c.RELIEF_GAIN] * abs(y[s.RELIEF]) * drives
    stuck = orifice(dp, now[c.RELIEF_OPEN], width) if now[c.RELIEF_OPEN] != 0.0 else 0.0

    # Case drain: fed by both ports, drained through its check valve into the accumulator, losing past the
    # shaft's seal. Its volume is small and its valve wide, so its pressure is the one that balances.
    from_a, from_b = now[c.CASE_LEAKAGE_1], now[c.CASE_LEAKAGE_2]
    shaft = now[c.SHAFT_LEAKAGE] + now[c.SHAFT_SPEED] * abs(turning)
    out_of_case = from_a + from_b + shaft + _LEAST_CASE
    closed = (from_a * a + from_b * b) / out_of_case
    excess = opening(closed - pa - par.case_cracking, par.check_width)
    case = closed - excess * par.case_gain / (out_of_case + par.case_gain)
    leak_a = rho * from_a * (a - case)
    leak_b = rho * from_b * (b - case)
    dripping = rho * shaft * max(case, 0.0)

    # Refeeding through the check valves (eq. 3.18), whose poppets take their time and let oil back meanwhile.
    lift_1, lift_2 = y[s.VALVE_1], y[s.VALVE_2]
    dy[s.VALVE_1] = lift_rate(a, b, pa, lift_1, now[c.CRACKING_1], now[c.STICKING_1], par)
    dy[s.VALVE_2] = lift_rate(b, a, pa, lift_2, now[c.CRACKING_2], now[c.STICKING_2], par)
    refeed_a, refeed_b = 0.0, 0.0
    if lift_1 > _SHUT:
        refeed_a = poppet(pa - a, par.refeed_gain * now[c.REFEED_1] * lift_1, _KNEE)
    if lift_2 > _SHUT:
        refeed_b = poppet(pa - b, par.refeed_gain * now[c.REFEED_2] * lift_2, _KNEE)
    if now[c.OPEN_1] != 0.0:
        refeed_a += orifice(pa - a, now[c.OPEN_1], width)
    if now[c.OPEN_2] != 0.0:
        refeed_b += orifice(pa - b, now[c.OPEN_2], width)
    heat = refeed_a * (pa - a) + refeed_b * (pa - b)
    refeed_a *= rho_store
    refeed_b *= rho_store
    charge = 0.0
    if now[c.CHARGE] != 0.0:
        charge = rho_store * now[c.CHARGE]
        charge *= min(max((par.charging_pressure - pa) / _CHARGE_BAND, 0.0), 1.0)

    across = pumped - rho * (cross + relief + stuck)
    to_a = across - leak_a + refeed_a + linked_1
    to_b = -across - leak_b + refeed_b + linked_2

    # At the cylinder: its seal, by-pass and throttle, leaks to the outside, external accumulators.
    past = now[c.SEAL_LEAKAGE] * (p1 - p2)
    if now[c.BYPASS] != 0.0:
        past += orifice(p1 - p2, now[c.BYPASS], width)
    past_mass = past * 0.5 * (rho_1 + rho_2)
    out_1 = outside_flow(p1, now[c.OUTSIDE_1], now[c.OUTSIDE_ORIFICE_1], now[c.OUTSIDE_OPENING_1], width)
    out_2 = outside_flow(p2, now[c.OUTSIDE_2], now[c.OUTSIDE_ORIFICE_2], now[c.OUTSIDE_OPENING_2], width)
    heat += out_1 * p1 + out_2 * p2
    out_1 *= rho_1
    out_2 *= rho_2
    to_1 = -past_mass - out_1
    to_2 = past_mass - out_2
    dy[s.EXTERNAL_1] = 0.0
    dy[s.EXTERNAL_2] = 0.0
    if par.external_flow > 0.0:
        grown = math.exp(par.expansion * warm)
        for i in range(2):
            held = y[s.EXTERNAL_1 + i] * grown
            # Isothermal (eq. 3.19).
            gas = par.external_pressure * par.external_volume / (par.external_volume - held) - par.ambient
            flow = orifice((p1 if i == 0 else p2) - gas, par.external_flow, width)
            if flow < 0.0:
                flow *= min(max(held / _EMPTY, 0.0), 1.0)
            dy[s.EXTERNAL_1 + i] = flow
            if i == 0:
                to_1 -= flow
            else:
                to_2 -= flow

    push_1, push_2 = par.area_1 * v, par.area_2 * v
    dy[s.FREE_1] = air_rate(p1, free_1, now[c.AIR_1] + now[c.INGRESS], par)
    dy[s.FREE_2] = air_rate(p2, free_2, now[c.AIR_2] + now[c.INGRESS], par)
    come_1, come_2 = gas_1 * dy[s.FREE_1], gas_2 * dy[s.FREE_2]
    give_1, give_2 = 1.0 / soft_1, 1.0 / soft_2
    give_a, give_b = give_1, give_2
    v1, v2 = par.volume_1 + par.area_1 * x, par.volume_2 - par.area_2 * x
    if par.blocked > 0.0:
        v1, v2 = par.cylinder_volume_1 + par.area_1 * x, par.cylinder_volume_2 - par.area_2 * x
        give_a, give_b = 1.0 / soft_a, 1.0 / soft_b
    else:
        to_1 += to_a
        to_2 += to_b
    inside = v1 * rho_1 + v2 * rho_2
    dy[s.P1] = ((to_1 - rho_1 * push_1) / (rho_1 * v1) + come_1) * give_1
    dy[s.P2] = ((to_2 + rho_2 * push_2) / (rho_2 * v2) + come_2) * give_2
    dy[s.LINE_1], dy[s.LINE_2] = dy[s.P1], dy[s.P2]
    if par.blocked > 0.0:
        inside = inside + par.line_volume_1 * rho_a + par.line_volume_2 * rho_b
        dy[s.LINE_1] = (to_a / (rho_a * par.line_volume_1) + gas_a * dy[s.FREE_1]) * give_a
        dy[s.LINE_2] = (to_b / (rho_b * par.line_volume_2) + gas_b * dy[s.FREE_2]) * give_b
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
    found[s.STORED_OIL] = y[s.STORE] * now[c.STORE_SPECIFIC]
    heat += (cross + relief + stuck) * (line_a - line_b) + past * (p1 - p2) + 2.0 * loss * pump
    heat += (leak_a * (line_a - pa) + leak_b * (line_b - pa)) / rho
    # The torque pulses and swings as the flow does: a pump that gave more than it takes would make energy.
    return lever * dp, heat, swell_1 * give_1, swell_2 * give_2, swell_a * give_a, swell_b * give_b
