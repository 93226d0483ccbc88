"""The plant's right-hand side: seals, servomotor, gas and rod of one axis, or of two on one rod, compiled.

Each axis has its own hydraulics, drive and seal friction; piston position and velocity are shared, since the
cylinders are joined at the shaft (section 4.5), and connect valves may join the lines (section 4.6.6).
`fdd.plant.state` says where everything stands.
"""

from __future__ import annotations

import math

from fdd.plant import Array, Constants
from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.compiled import njit
from fdd.plant.details import DAHL, ELASTOPLASTIC, SMOOTH
from fdd.plant.hydraulics import hydraulic_rates, orifice, past_band
from fdd.plant.oil import oil_at

_WORN_LENGTH = 0.25
"""Of the half stroke: how far from mid-stroke a seal's running-in track is felt (1/e of its change)."""
_STILL = 1e-4
"""m/s below which |v| is rounded off: a hundredth of the slowest steady motion in the thesis. The corner
would cost the integrator its order at each reversal."""


@njit(error_model="numpy", inline="always")
def friction_rates(y: Array, x: float, v: float, now: Array, par: Constants, dy: Array) -> float:
    """Friction force of the cylinder (N, against extension); fills the rates of bristle and memory.

    LuGre with a curve for each direction (eqs 5.8 to 5.12, Table 5.2), and two things beyond. The bristle
    holds without sliding until the break-away share of its steady deflection, after Dupont, Hayward,
    Armstrong and Altpeter (doi:10.1109/TAC.2002.1000274); share 0 is LuGre's own eq. 5.9. And the
    lubricant's film, and with it the falling curve, follows the sliding with a lag, while the seal resists
    what is quicker. Without the first the seal would break away ever more easily the faster it is started
    (in the thesis it does not, figure 5.8), without the second the falling curve would drive the hydraulic
    resonance to its limit at any speed.

    Thick oil raises the film's part of the level and thins the falling curve, see
    `fdd.plant.integrator.thin`. Other seals, other laws: `fdd.plant.details.Details.friction_law`.
    """
    z, memory = y[s.Z], y[s.MEMORY]
    law = par.friction_law
    seen = memory if law == ELASTOPLASTIC else v
    film = math.sqrt(seen * seen + _STILL * _STILL) - _STILL
    size = v * v / math.sqrt(v * v + _STILL * _STILL)
    if v >= 0.0:
        coulomb, static = par.coulomb_forward, par.static_forward
        stribeck, exponent, viscous = par.stribeck_forward, par.exponent_forward, par.viscous_forward
        scale, level, beyond = now[c.FRICTION_FORWARD], now[c.COULOMB_FORWARD], now[c.STRIBECK_FORWARD]
    else:
        coulomb, static = par.coulomb_reverse, par.static_reverse
        stribeck, exponent, viscous = par.stribeck_reverse, par.exponent_reverse, par.viscous_reverse
        scale, level, beyond = now[c.FRICTION_REVERSE], now[c.COULOMB_REVERSE], now[c.STRIBECK_REVERSE]
    if now[c.MIDDLE] != 0.0:
        away = x / (_WORN_LENGTH * par.half_stroke)
        scale *= 1.0 + now[c.MIDDLE] * math.exp(-away * away)
    level *= coulomb
    if par.seal_area != 0.0:
        level += 0.5 * par.seal_area * (max(y[s.P1], 0.0) + max(y[s.P2], 0.0))
    falling = 0.0
    if law != DAHL:
        falling = beyond * math.exp(-((film / (stribeck * now[c.STRIBECK_SPEED])) ** exponent))
    steady = scale * (level + (static - coulomb) * falling)
    if law == SMOOTH:
        dy[s.Z] = 0.0
        dy[s.MEMORY] = 0.0
        return steady * math.tanh(v / par.smooth_width) + now[c.VISCOUS] * viscous * v
    share = par.bristle_stiffness * z / max(steady, 1e-3)
    slip = size * share
    if par.breakaway > 0.0 and law == ELASTOPLASTIC:
        past = (abs(share) - par.breakaway) / (1.0 - par.breakaway)
        if past <= 0.0 or share * v < 0.0:
            slip = 0.0
        elif past < 1.0:
            slip *= past * past * (3.0 - 2.0 * past)
    dz = v - slip
    dy[s.Z] = dz
    dy[s.MEMORY] = (slip - memory) * par.friction_rate
    resisting = par.seal_damping * (v - memory)
    if law != ELASTOPLASTIC:
        dy[s.MEMORY] = 0.0
        resisting = 0.0
    fade = par.bristle_fade * par.bristle_fade
    bristle = par.bristle_stiffness * z + par.bristle_damping * fade / (fade + v * v) * dz
    return bristle + resisting + now[c.VISCOUS] * viscous * v


@njit(error_model="numpy", inline="always")
def drive_rates(
    y: Array, command: float, hydraulic_torque: float, now: Array, par: Constants, dy: Array
) -> tuple[float, float]:
    """Servomotor (eqs 3.20 to 3.29): its torque and the friction's (N·m); fills the rates of angle, speed,
    integrator and current.

    The velocity loop is the PI controller with feed-forward whose closed loop has the poles and the zero of
    eq. 6.11; behind it the drive's current loop is a lag of its own, for which the PI's gains make room (a
    third pole far to the left). Voltage and current are limited, the winding has resistance and inductance.

    A gear pump's torque loss is a constant, a share of its load and a viscous part (McCandlish and Dorey,
    doi:10.1243/PIME_PROC_1984_198_062_02).
    """
    speed, integrator, current = y[s.SPEED], y[s.DRIVE], y[s.CURRENT]
    command = past_band(command, par.command_dead_band)  # of its input (Table 6.1)
    # Accelerations that the loop asks for; it knows the healthy motor's constants and viscous friction.
    wanted = integrator - par.loop_gain * speed + par.loop_feed * command
    demand = (par.inertia * wanted + par.rotary_viscous * speed) / par.torque_constant
    limit = par.current_limit * now[c.CURRENT_LIMIT]
    allowed = min(max(demand, -limit), limit)
    # Current loop: its integral part, quicker than all else here, has made up for resistance and back EMF
    # whatever they have become, or a degraded motor would take more than the limit. Within its voltage.
    share = now[c.TORQUE]
    opposing = par.winding_resistance * now[c.RESISTANCE] * current + par.back_emf * share * speed
    voltage = opposing + par.winding_inductance * par.current_rate * (allowed - current)
    voltage = min(max(voltage, -par.voltage_limit), par.voltage_limit)
    dy[s.CURRENT] = (voltage - opposing) / par.winding_inductance
    if now[c.PHASE] != 0.0:
        # Two phases of three: the torque swings with twice the electrical angle.
        share *= 1.0 - 0.5 * now[c.PHASE] * (1.0 + math.cos(2.0 * par.pole_pairs * y[s.ANGLE]))
    # Magnets and slots pull without current; shorted turns brake.
    torque = par.torque_constant * share * current - now[c.BRAKING] * speed
    if par.cogging_torque != 0.0:
        torque -= par.cogging_torque * math.sin(2.0 * par.pole_pairs * y[s.ANGLE])
    # Dry friction of shaft and gears, which the load presses together, and the oil that they shear.
    dry = par.rotary_coulomb + par.pump_friction * abs(hydraulic_torque)
    turning = (par.rotary_viscous + par.pump_drag * now[c.DRAG]) * speed
    turning += dry * speed / math.sqrt(1.0 + speed * speed)
    dy[s.ANGLE] = speed
    dy[s.SPEED] = (torque - hydraulic_torque - turning) / par.inertia
    # What the limit takes away does not wind the integrator up.
    dy[s.DRIVE] = (
        par.loop_integral * (command - speed)
        + par.loop_gain * par.torque_constant * (allowed - demand) / par.inertia
    )
    if now[c.CURRENT_LIMIT] <= 0.0:
        # Without power the drive's outputs are off: no current, and the loop is held at rest.
        dy[s.CURRENT] = -par.current_rate * current
        dy[s.DRIVE] = -par.loop_gain * integrator
    return torque, turning


@njit(error_model="numpy", inline="always")
def axis_rates(
    y: Array, x: float, v: float, command: float, pa: float, linked_1: float, linked_2: float, now: Array,
    par: Constants, dy: Array, found: Array,
) -> float:  # fmt: skip
    """Force of one axis on the rod (N); fills its rates and findings."""
    resisting, heat, rise_1, rise_2, rise_a, rise_b = hydraulic_rates(
        y, x, v, pa, linked_1, linked_2, now, par, dy, found
    )
    torque, turning = drive_rates(y, command, resisting, now, par, dy)
    friction = friction_rates(y, x, v, now, par, dy)
    heat += abs(friction * v) + abs(turning * y[s.SPEED])
    cooling = par.cooling * (y[s.TEMPERATURE] - par.surroundings)
    warming = now[c.WARMING] + (heat - cooling) / par.heat_capacity
    dy[s.TEMPERATURE] = warming
    # Oil swells in every volume.
    dy[s.P1] += rise_1 * warming
    dy[s.P2] += rise_2 * warming
    dy[s.LINE_1] += rise_a * warming
    dy[s.LINE_2] += rise_b * warming
    found[s.FRICTION_FORCE] = friction
    found[s.MOTOR_TORQUE] = torque
    found[s.LOSSES] = heat
    return par.area_1 * y[s.P1] - par.area_2 * y[s.P2] - friction


@njit(error_model="numpy", inline="always")
def load_spring(x: float, par: Constants) -> float:
    """Force of the load's spring (N): through a hinge's play, and of a press only where it touches."""
    reach = past_band(x - par.spring_centre, par.spring_play)
    if par.one_sided > 0.0:
        reach = max(reach, 0.0)
    return par.spring * reach


@njit(error_model="numpy", inline="always")
def end_stop(x: float, v: float, par: Constants) -> float:
    """Force of stops and cushions, positive against extension (N).

    A cushion throttles the oil that the piston pushes out of the cylinder's end and lets it back freely.
    """
    force = 0.0
    if x * v > 0.0:
        depth = (abs(x) - par.half_stroke) / par.cushion_length + 1.0
        if depth > 0.0:
            force = par.cushion_damping * min(depth, 1.0) * v * abs(v)
    if x > par.half_stroke:
        force += max(par.stop_stiffness * (x - par.half_stroke) * (1.0 + par.stop_damping * v), 0.0)
    elif x < -par.half_stroke:
        force += min(par.stop_stiffness * (x + par.half_stroke) * (1.0 - par.stop_damping * v), 0.0)
    return force


@njit(error_model="numpy", inline="always")
def store_pressure(oil: float, heat: float, par: Constants) -> float:
    """Gauge pressure (Pa) of the accumulator and the inner circuit around it.

    Gas on its separator (eq. 3.19) while that floats. At its stop on the oil's side the accumulator is empty:
    the pressure falls with what little gas the inner circuit's own oil holds. At the other one the inner
    circuit's oil alone gives.

    Of the `oil` held (m³; negative is what the inner circuit lacks) and the gas's absolute temperature over
    that at rest.
    """
    if oil < 0.0:
        left = par.gallery_gas / (par.gallery_gas - oil)
        return par.gas_pressure * par.gas_volume / par.shell_volume * heat * left - par.ambient
    held = min(oil, par.full)
    gas = par.gas_pressure * par.gas_volume * heat / (par.shell_volume - held)
    return gas - par.ambient + (oil - held) * par.full_stiffness


@njit(error_model="numpy", inline="always")
def gas_rate(y: Array, pa: float, now: Array, par: Constants, dy: Array) -> None:
    """Fill the rate (1/s) of the accumulator gas's temperature over that at rest, once all that goes into its
    oil is known.

    An ideal diatomic gas that gives its heat to the shell with one time constant (Pourmovahed and Otis,
    doi:10.1115/1.2894128): quick changes are adiabatic, slow ones isothermal. The shell takes a share of the
    oil's warming. `pa` (Pa, gauge) is the gas's pressure.
    """
    specific = now[c.STORE_SPECIFIC]
    warm = y[s.TEMPERATURE] - par.surroundings
    work = 0.0
    if 0.0 < y[s.STORE] * specific < par.full:
        work = (pa + par.ambient) * (dy[s.STORE] * specific) * par.gas_work
    dy[s.GAS] = work - (y[s.GAS] - 1.0 - par.gas_warming * warm) * par.gas_rate


# Its arrays are borrowed: without counting references to them (_nrt) it takes a quarter less time.
@njit(error_model="numpy", _nrt=False)
def right_hand_side(
    y: Array, command_1: float, command_2: float, now: Array, first: Constants, second: Constants, dy: Array,
    found: Array,
) -> None:  # fmt: skip
    """Time derivative `dy` of the state `y` (STATES,), of two axes (STATES + AXIS_STATES,).

    Commands are the speeds (rad/s) demanded of the drives, after their delay; `now` (axes, COLUMNS) are the
    conditions of this millisecond, at the present viscosity; of the axes' constants load, stops and mass are
    the first's. Fills `found` (axes·FINDINGS,) with forces, flows, pressures.
    """
    x, v = y[s.X], y[s.V]
    row = now[0]
    linked_1, linked_2 = 0.0, 0.0
    o = s.SHARED + s.AXIS_STATES
    dual = y.size > s.STATES
    if dual and (row[c.CONNECT_1] != 0.0 or row[c.CONNECT_2] != 0.0):
        # From the second axis's lines into the first's, at the mean of their densities.
        a, b = y[s.SHARED + s.LINE_1], y[s.SHARED + s.LINE_2]
        a_2, b_2 = y[o + s.LINE_1], y[o + s.LINE_2]
        warm = y[s.SHARED + s.TEMPERATURE] - first.reference_temperature
        _, log_a, _, _ = oil_at(0.5 * (a + a_2), 0.0, warm, 1.0, first)
        _, log_b, _, _ = oil_at(0.5 * (b + b_2), 0.0, warm, 1.0, first)
        linked_1 = math.exp(log_a) * orifice(a_2 - a, row[c.CONNECT_1], first.orifice_transition)
        linked_2 = math.exp(log_b) * orifice(b_2 - b, row[c.CONNECT_2], first.orifice_transition)
    own, rates = y[s.SHARED : o], dy[s.SHARED : o]
    pa = store_pressure(own[s.STORE] * row[c.STORE_SPECIFIC], own[s.GAS], first)
    force = axis_rates(own, x, v, command_1, pa, linked_1, linked_2, row, first, rates, found[: s.FINDINGS])
    if dual:
        own_2, rates_2 = y[o:], dy[o:]
        if second.shares <= 0.0:
            pa = store_pressure(own_2[s.STORE] * now[1, c.STORE_SPECIFIC], own_2[s.GAS], second)
        force += axis_rates(
            own_2, x, v, command_2, pa, -linked_1, -linked_2, now[1], second, rates_2, found[s.FINDINGS :]
        )
        if second.shares > 0.0:
            # One accumulator serves both inner circuits (section 4.3).
            rates[s.STORE] += rates_2[s.STORE]
            rates_2[s.STORE] = 0.0
        gas_rate(own_2, pa, now[1], second, rates_2)
    gas_rate(own, found[s.ACCUMULATOR], row, first, rates)

    drop = y[s.DROP]
    load = row[c.FORCE] + load_spring(x, first) + first.partner_area * drop
    dy[s.DROP] = 0.0
    if first.partner_area > 0.0:
        width = first.orifice_transition
        through = drop / math.sqrt(first.throttle * math.sqrt(drop * drop + width * width))
        dy[s.DROP] = (first.partner_area * v - through) / first.partner_compliance
    stop = end_stop(x, v, first)
    dy[s.X] = v
    dy[s.V] = (force - load - stop) / first.mass
    found[s.LOAD_FORCE] = load
    found[s.STOP_FORCE] = stop
    if dual:
        found[s.FINDINGS + s.LOAD_FORCE] = load
        found[s.FINDINGS + s.STOP_FORCE] = stop
