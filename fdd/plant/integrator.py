"""The compiled loop: controllers every millisecond, the plant in between.

The loop takes a block of milliseconds and remembers in its arguments all that the next block needs, so
that a run gives the same bits however it is cut.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.plant import PERIOD, Array, Constants
from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.compiled import njit
from fdd.plant.equations import right_hand_side
from fdd.plant.oil import oil_at, settled_air, walther
from fdd.plant.steps import STAGES, advance

LATE_PARTS = 10
"""Parts of a sample's period in which its lateness is counted."""

POSITION, SPEED_COMMAND, SHUTTLE = 0, 1, 2
"""Modes of the controller: position loop, open speed command, constant speed between two positions."""
SAME, STILL, OWN = 0, 1, 2
"""What the second axis's drive follows: the first's command, rest, a set-point of its own."""

OWN_MEMORIES = 9
(_DIRECTION, _REST, _LENGTH, _U1, _U2, _Y1, _Y2, _SEEN, STEPS) = range(OWN_MEMORIES)
(_HEAT, _AIR_1, _AIR_2, _VAPOUR, _THINNED, _RATIO) = range(6)
_EACH = 6
MEMORIES = OWN_MEMORIES + 2 * _EACH
"""The controller's, with the integrator's steps at `STEPS`, then each axis's: the winding's heat over what
it bears for good, its chambers' air, its oil's vapour pressure over sound oil's, and temperature (°C) and
viscosity over the reference's, as they were last worked out."""
_SAME_WARMTH = 1e-5
"""K that change the viscosity by less than a millionth: it is not worked out anew for them."""
_LOADED, _HEATED = 0.5, 2.0
"""Pressure difference over the relief setting, and warming (K) since the start, at which a fault that comes
with load or heat is whole."""
_THINNED_LEAKS = (
    c.CROSS_LEAKAGE, c.CROSS_OPENING, c.SPEED_LEAKAGE, c.SEAL_LEAKAGE, c.CASE_LEAKAGE_1, c.CASE_LEAKAGE_2,
    c.SHAFT_LEAKAGE, c.SHAFT_SPEED, c.OUTSIDE_1, c.OUTSIDE_2, c.OUTSIDE_OPENING_1, c.OUTSIDE_OPENING_2,
)  # fmt: skip
"""Leaks through gaps, which go with one over the viscosity."""
_DERATING = 0.1
"""Heat beyond which the drive takes its current back to the continuous one, all of it over this much more."""


def new_memory(control: Constants, seen: float, air: Array) -> tuple[Array, Array]:
    """What the loop remembers before its first block: (MEMORIES,), and past commands (2, depth).

    `seen` is the position (m) that the encoder shows at rest; `air` (axes, 3) that of each chamber, by
    volume, and the vapour pressure over sound oil's.
    """
    memory = np.zeros(MEMORIES)
    memory[_DIRECTION], memory[_REST], memory[_LENGTH], memory[_SEEN] = 1.0, control.dwell, 2e-4, seen
    for axis, each in enumerate(air):
        own = OWN_MEMORIES + axis * _EACH
        memory[own + _AIR_1], memory[own + _AIR_2], memory[own + _VAPOUR] = each
        memory[own + _THINNED] = np.inf
    depth = int(max(control.delay_1, control.delay_2) / PERIOD) + 2
    return memory, np.zeros((2, depth))


@njit(error_model="numpy")
def thin(
    now: Array, axis: int, temperature: float, viscosity: Array, memory: Array, at: int, par: Constants
) -> None:
    """Bring a row to the present temperature, in place: thin oil leaks more and drags less.

    A seal's film carries load with the root of viscosity times speed, and forms at a speed inversely as high.
    """
    if abs(temperature - memory[at + _THINNED]) > _SAME_WARMTH:
        memory[at + _THINNED] = temperature
        present = walther(temperature, viscosity[axis, 0], viscosity[axis, 1])
        memory[at + _RATIO] = present / viscosity[axis, 2]
    ratio = memory[at + _RATIO] * now[axis, c.VISCOSITY]
    thinner = 1.0 / ratio
    for column in _THINNED_LEAKS:
        now[axis, column] *= thinner
    now[axis, c.TRANSITION] *= ratio * ratio
    # Of a millisecond: within it the accumulator's oil swells by nothing that counts.
    density = par.store_density * math.exp(-par.expansion * (temperature - par.reference_temperature))
    now[axis, c.STORE_DENSITY], now[axis, c.STORE_SPECIFIC] = density, 1.0 / density
    now[axis, c.VISCOUS] *= ratio
    now[axis, c.DRAG] *= ratio
    film = 1.0 + par.film_share * (math.sqrt(ratio) - 1.0)
    now[axis, c.COULOMB_FORWARD] *= film
    now[axis, c.COULOMB_REVERSE] *= film
    now[axis, c.STRIBECK_SPEED] *= thinner


@njit(error_model="numpy")
def blend(row: Array, added: Array, acting: int, share: float) -> None:
    """Let faults that come with load or heat act by their share of the present one, in place."""
    share = min(max(share, 0.0), 1.0)
    for j in range(c.COLUMNS):
        row[j] += share * added[j]
    row[acting] = share


@njit(error_model="numpy")
def exchange_air(y: Array, o: int, row: Array, memory: Array, at: int, par: Constants) -> None:
    """Let air and vapour come where oil leaves, at constant pressure, in place: what a row has more than the
    last one. `o` and `at` are where the axis begins in the state and in the memory."""
    x, warm = y[s.X], y[o + s.TEMPERATURE] - par.reference_temperature
    vapour, memory[at + _VAPOUR] = memory[at + _VAPOUR], row[c.VAPOUR]
    for i in range(2):
        air, before = row[c.AIR_1 + i], memory[at + _AIR_1 + i]
        memory[at + _AIR_1 + i] = air
        free = y[o + s.FREE_1 + i]
        more = settled_air(max(y[o + s.P1 + i], 0.0), (air - before) * par.air_scale, par)
        more = max(more, -free)
        y[o + s.FREE_1 + i] = free + more
        volume = par.cylinder_volume_1 + par.area_1 * x if i == 0 else par.cylinder_volume_2 - par.area_2 * x
        line = par.line_volume_1 if i == 0 else par.line_volume_2
        for pressure, held in ((y[o + s.P1 + i], volume), (y[o + s.LINE_1 + i], line)):
            _, was, _, _ = oil_at(pressure, free, warm, vapour, par)
            _, now, _, _ = oil_at(pressure, free + more, warm, row[c.VAPOUR], par)
            y[o + s.LOST] += held * (math.exp(was) - math.exp(now))


@njit(error_model="numpy")
def protect(now: Array, axis: int, current: float, memory: Array, at: int, par: Constants) -> None:
    """The drive's I²t protection over a millisecond, in place: a hot winding is given less current."""
    heat, bears = memory[at + _HEAT], par.continuous_current
    heat += PERIOD * par.winding_rate * (current * current / (bears * bears) - heat)
    memory[at + _HEAT] = heat
    if heat > 1.0 and par.current_limit > bears:
        share = min((heat - 1.0) / _DERATING, 1.0)
        now[axis, c.CURRENT_LIMIT] *= 1.0 - share * (1.0 - bears / par.current_limit)


@njit(error_model="numpy")
def take_row(
    y: Array, axis: int, t: int, conditions: Array, by_load: Array, by_heat: Array, viscosity: Array,
    memory: Array, par: Constants, now: Array,
) -> None:  # fmt: skip
    """Fill an axis's row of `now` with what acts in millisecond t: arguments as of `run`."""
    o, at, row = s.SHARED + axis * s.AXIS_STATES, OWN_MEMORIES + axis * _EACH, conditions[t, axis]
    if by_load.size > 0:
        load = abs(y[o + s.P1] - y[o + s.P2]) / (_LOADED * par.relief_pressure)
        blend(row, by_load[t, axis], c.BY_LOAD, load)
    if by_heat.size > 0:
        blend(row, by_heat[t, axis], c.BY_HEAT, (y[o + s.TEMPERATURE] - par.surroundings) / _HEATED)
    now[axis] = row
    held = memory[at + _AIR_1], memory[at + _AIR_2], memory[at + _VAPOUR]
    if (row[c.AIR_1], row[c.AIR_2], row[c.VAPOUR]) != held:
        exchange_air(y, o, row, memory, at, par)
    protect(now, axis, y[o + s.CURRENT], memory, at, par)
    thin(now, axis, y[o + s.TEMPERATURE], viscosity, memory, at, par)


@njit(error_model="numpy")
def _command(x: float, row: Array, control: Constants, memory: Array) -> float:
    """Speed that the controller demands (rad/s); advances its memory by a millisecond."""
    seen = control.encoder_gain * x + control.encoder_zero + row[c.ENCODER_OFFSET]
    if control.encoder_resolution > 0.0:
        seen = control.encoder_resolution * np.rint(seen / control.encoder_resolution)
    wanted = row[c.SETPOINT]
    if control.mode == POSITION:
        wanted = control.gain * (wanted - seen)
    elif control.mode == SHUTTLE:
        direction = memory[_DIRECTION]
        if memory[_REST] > 0.0:
            memory[_REST] -= 1.0
            wanted = 0.0
        elif (direction > 0.0 and seen >= control.high) or (direction < 0.0 and seen <= control.low):
            memory[_DIRECTION] = -direction
            memory[_REST] = control.dwell
            wanted = 0.0
        else:
            wanted *= direction
    if control.rate_gain != 0.0:
        rate = control.b1 * memory[_U1] + control.b2 * memory[_U2]
        rate -= control.a1 * memory[_Y1] + control.a2 * memory[_Y2]
        memory[_U2], memory[_U1] = memory[_U1], (seen - memory[_SEEN]) / PERIOD
        memory[_Y2], memory[_Y1] = memory[_Y1], rate
        memory[_SEEN] = seen
        wanted -= control.rate_gain * rate
    if control.mode != POSITION and (
        (seen > control.limit and wanted > 0.0) or (seen < -control.limit and wanted < 0.0)
    ):
        wanted = 0.0
    return min(max(wanted, -control.max_speed), control.max_speed)


@njit(error_model="numpy")
def run(
    y: Array, memory: Array, past: Array, conditions: Array, by_load: Array, by_heat: Array, viscosity: Array,
    first: Constants, second: Constants, control: Constants, late: NDArray[np.int64], per_allowed: Array,
    longest: float,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Run the plant for as many milliseconds as there are conditions. Gives states (m, states) and findings
    (m, axes·FINDINGS) at the sampling times, and commands (n, 2); NaN from where the state has left all
    bounds.

    Parameters
    ----------
    y, memory, past : state, and from `new_memory`; hold what the next block begins with afterwards.
    conditions : (n, axes, COLUMNS) one row per millisecond, at the reference viscosity; holds afterwards what
        acted, faults that come with load or heat included.
    by_load, by_heat : (n, axes, COLUMNS) what such faults add at their full; no rows where there are none.
    viscosity : (axes, 3) Walther's intercept and slope, and the reference viscosity (cSt).
    first, second, control : constants of the axes (a single one's are both) and of the controller.
    late : (m,) parts of its period by which each sample is taken late, 0 to `LATE_PARTS` - 1; m is n, or a
        multiple where more than one sample is taken each millisecond.
    per_allowed, longest : one over the error allowed for each state over a step, and the longest step (s).
    """
    n, axes, depth = conditions.shape[0], conditions.shape[1], past.shape[1]
    each = late.size // n if n > 0 else 1
    period = PERIOD / each
    states = np.empty((late.size, y.size))
    findings = np.empty((late.size, axes * s.FINDINGS))
    commands = np.zeros((depth + n, 2))  # with those of the past in front
    commands[:depth] = past.T
    k, stage = np.empty((STAGES, y.size)), np.empty(y.size)
    found, now = np.empty(axes * s.FINDINGS), np.empty((axes, c.COLUMNS))
    whole_1, whole_2 = int(control.delay_1 / PERIOD + 1e-9), int(control.delay_2 / PERIOD + 1e-9)
    part_1, part_2 = control.delay_1 - whole_1 * PERIOD, control.delay_2 - whole_2 * PERIOD
    part_1 = part_1 if part_1 > 1e-9 else 0.0
    part_2 = part_2 if part_2 > 1e-9 and axes > 1 else 0.0
    for t in range(n):
        take_row(y, 0, t, conditions, by_load, by_heat, viscosity, memory, first, now)
        if axes > 1:
            take_row(y, 1, t, conditions, by_load, by_heat, viscosity, memory, second, now)
        m = depth + t
        commands[m, 0] = _command(y[s.X], now[0], control, memory)
        if axes > 1:
            wanted = commands[m, 0] if control.follows == SAME else 0.0
            if control.follows == OWN:
                wanted = now[1, c.SETPOINT]
            commands[m, 1] = min(max(wanted, -control.max_speed_2), control.max_speed_2)
        taken = t * each
        at, sample = 0.0, late[taken] * (period / LATE_PARTS)
        while at < PERIOD:
            command_1 = commands[m - whole_1 - (1 if at < part_1 else 0), 0]
            command_2 = commands[m - whole_2 - (1 if at < part_2 else 0), 1]
            right_hand_side(y, command_1, command_2, now, first, second, k[0], found)
            if at == sample:
                states[taken], findings[taken] = y, found
                taken += 1
                ahead = taken - t * each
                sample = ahead * period + late[taken] * (period / LATE_PARTS) if ahead < each else 0.0
            # Up to where a command arrives or a sample is taken.
            end = PERIOD
            for due in (part_1, part_2, sample):
                if at < due < end:
                    end = due
            length, tried = advance(
                y, end - at, memory[_LENGTH], longest, command_1, command_2, now, first, second,
                per_allowed, k, stage, found,
            )  # fmt: skip
            memory[STEPS] += tried
            if length < 0.0:
                states[t * each :] = np.nan
                findings[t * each :] = np.nan
                y[:] = np.nan
                return states, findings, commands[depth:]
            memory[_LENGTH] = length
            at = end
    past[:] = commands[n:].T
    return states, findings, commands[depth:]
