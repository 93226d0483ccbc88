"""The compiled loop: controllers every millisecond, the plant in between.

The loop takes a block of milliseconds and remembers in its arguments all that the next block needs, so
that a run gives the same bits however it is cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.plant import conditions as c
from fdd.plant.compiled import njit
from fdd.plant.equations import right_hand_side
from fdd.plant.laws import walther
from fdd.plant.parameters import Constants
from fdd.plant.state import AXIS_STATES, FINDINGS, SHARED, TEMPERATURE, X
from fdd.plant.steps import STAGES, advance

Array = NDArray[np.float64]

PERIOD = 1e-3
"""s, of controller and recording."""
LATE_PARTS = 10
"""Parts of a sample's period in which its lateness is counted."""
LONGEST_STEP = PERIOD

POSITION, SPEED_COMMAND, SHUTTLE = 0, 1, 2
"""Modes of the controller: position loop, open speed command, constant speed between two positions."""
SAME, STILL, OWN = 0, 1, 2
"""What the second axis's drive follows: the first's command, rest, a set-point of its own."""


class Controller(NamedTuple):
    """Constants of the controller, SI; it sees the position encoder, not the position."""

    mode: int
    gain: float
    max_speed: float
    limit: float
    """Position beyond which a speed command outwards is cut to zero (the rig's interlock)."""
    low: float
    high: float
    dwell: int
    """Rest at each end of a shuttle, in milliseconds."""
    encoder_gain: float
    encoder_zero: float
    encoder_resolution: float
    rate_gain: float
    """Feedback of the filtered, differentiated encoder ((rad/s)/(m/s))."""
    b1: float
    b2: float
    a1: float
    a2: float
    """Chatter filter of eq. 7.5: y = b1·u₋₁ + b2·u₋₂ - a1·y₋₁ - a2·y₋₂."""
    follows: int
    delay_1: float
    delay_2: float
    """Delays of the drives (s)."""
    max_speed_2: float


MEMORIES = 9
(_DIRECTION, _REST, _LENGTH, _U1, _U2, _Y1, _Y2, _SEEN, _STEPS) = range(MEMORIES)
STEPS = _STEPS
"""Where the memory counts the integrator's steps."""


def new_memory(control: Controller, seen: float) -> tuple[Array, Array]:
    """What the loop remembers before its first block: controller (MEMORIES,) and past commands (2, depth).

    Parameters
    ----------
    control : whose delays set how far back commands are kept.
    seen : position (m) that the encoder shows at rest.
    """
    memory = np.zeros(MEMORIES)
    memory[_DIRECTION], memory[_REST], memory[_LENGTH], memory[_SEEN] = 1.0, control.dwell, 2e-4, seen
    depth = int(max(control.delay_1, control.delay_2) / PERIOD) + 2
    return memory, np.zeros((2, depth))


@njit(error_model="numpy")
def thin(now: Array, axis: int, temperature: float, viscosity: Array) -> None:
    """Bring a row to the present viscosity, in place: thin oil leaks more and drags less."""
    ratio = walther(temperature, viscosity[axis, 0], viscosity[axis, 1]) / viscosity[axis, 2]
    ratio *= now[axis, c.VISCOSITY]
    thinner = 1.0 / ratio
    now[axis, c.CROSS_LEAKAGE] *= thinner
    now[axis, c.SPEED_LEAKAGE] *= thinner
    now[axis, c.SEAL_LEAKAGE] *= thinner
    now[axis, c.CASE_LEAKAGE] *= thinner
    now[axis, c.SHAFT_LEAKAGE] *= thinner
    now[axis, c.OUTSIDE_1] *= thinner
    now[axis, c.OUTSIDE_2] *= thinner
    now[axis, c.VISCOUS] *= ratio


@njit(error_model="numpy")
def _command(x: float, row: Array, control: Controller, memory: Array) -> float:
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
    y: Array,
    memory: Array,
    past: Array,
    conditions: Array,
    viscosity: Array,
    first: Constants,
    second: Constants,
    control: Controller,
    late: NDArray[np.int64],
    per_allowed: Array,
    longest: float,
) -> tuple[Array, Array, Array]:
    """Run the plant for as many milliseconds as there are conditions.

    Parameters
    ----------
    y : state, one axis or two; holds the last one afterwards.
    memory, past : from `new_memory`; hold what the next block needs afterwards.
    conditions : (n, axes, COLUMNS) one row per millisecond, at the reference viscosity.
    viscosity : (axes, 3) Walther's intercept and slope, and the reference viscosity (cSt).
    first, second : constants of the axes; for one axis the second is not used.
    control : constants of the controller.
    late : (m,) parts of its period by which each sample is taken late, 0 to `LATE_PARTS` - 1; m is n, or a
        multiple where more than one sample is taken each millisecond.
    per_allowed : one over the error allowed for each state over a step, see `fdd.plant.steps.tolerances`.
    longest : longest step (s).

    Returns
    -------
    states (m, states), findings (m, axes·FINDINGS) at the sampling times and commands (n, 2); NaN from
    where the state has left all bounds.
    """
    n, axes, depth = conditions.shape[0], conditions.shape[1], past.shape[1]
    each = late.size // n if n > 0 else 1
    period = PERIOD / each
    states = np.empty((late.size, y.size))
    findings = np.empty((late.size, axes * FINDINGS))
    commands = np.zeros((depth + n, 2))  # with those of the past in front
    for a in range(2):
        for j in range(depth):
            commands[j, a] = past[a, j]
    k = np.empty((STAGES, y.size))
    stage = np.empty(y.size)
    found = np.empty(axes * FINDINGS)
    now = np.empty((axes, c.COLUMNS))
    whole_1, whole_2 = int(control.delay_1 / PERIOD + 1e-9), int(control.delay_2 / PERIOD + 1e-9)
    part_1 = max(control.delay_1 - whole_1 * PERIOD, 0.0)
    part_2 = max(control.delay_2 - whole_2 * PERIOD, 0.0) if axes > 1 else 0.0
    part_1 = part_1 if part_1 > 1e-9 else 0.0
    part_2 = part_2 if part_2 > 1e-9 else 0.0
    for t in range(n):
        for a in range(axes):
            for j in range(c.COLUMNS):
                now[a, j] = conditions[t, a, j]
            thin(now, a, y[SHARED + a * AXIS_STATES + TEMPERATURE], viscosity)
        m = depth + t
        commands[m, 0] = _command(y[X], now[0], control, memory)
        if axes > 1:
            if control.follows == SAME:
                wanted = commands[m, 0]
            elif control.follows == OWN:
                wanted = now[1, c.SETPOINT]
            else:
                wanted = 0.0
            commands[m, 1] = min(max(wanted, -control.max_speed_2), control.max_speed_2)
        taken = t * each
        at, sample = 0.0, late[taken] * (period / LATE_PARTS)
        while at < PERIOD:
            command_1 = commands[m - whole_1 - (1 if at < part_1 else 0), 0]
            command_2 = commands[m - whole_2 - (1 if at < part_2 else 0), 1]
            right_hand_side(y, command_1, command_2, now, first, second, k[0], found)
            if at == sample:
                for i in range(y.size):
                    states[taken, i] = y[i]
                for i in range(found.size):
                    findings[taken, i] = found[i]
                taken += 1
                ahead = taken - t * each
                sample = ahead * period + late[taken] * (period / LATE_PARTS) if ahead < each else 0.0
            # Up to where a command arrives or a sample is taken.
            end = PERIOD
            if at < part_1:
                end = min(end, part_1)
            if at < part_2:
                end = min(end, part_2)
            if at < sample:
                end = min(end, sample)
            length, tried = advance(
                y, end - at, memory[_LENGTH], longest, command_1, command_2, now, first, second,
                per_allowed, k, stage, found,
            )  # fmt: skip
            memory[_STEPS] += tried
            if length < 0.0:
                states[t * each :] = np.nan
                findings[t * each :] = np.nan
                y[:] = np.nan
                return states, findings, commands[depth:]
            memory[_LENGTH] = length
            at = end
    for a in range(2):
        for j in range(depth):
            past[a, j] = commands[n + j, a]
    return states, findings, commands[depth:]
