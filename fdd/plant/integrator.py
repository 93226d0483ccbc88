"""The compiled loop: controller every millisecond, fixed steps in between.

Each step is one of the classical fourth-order Runge-Kutta method. While the piston slides so fast that
the bristle's equation is too quick for it, the bristle moves instead by that equation's exact solution for
the stage's velocity. Everything else in the plant is slower than 4000 1/s. At 0.1 ms the position
is within 0.05 µm of steps a tenth as long, over seconds of stick and slip (`tests/plant`).

Numba keys its cache on each function's own file: after a change to `equations` or `conditions` alone, raise
`EQUATIONS` here too, or the loop keeps the old ones (the comparison with the reference solver in the tests
then fails).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fdd.plant.conditions import SETPOINT
from fdd.plant.equations import DECAY, FINDINGS, SPEED, STATES, V, X, Z, right_hand_side
from fdd.plant.parameters import Parameters

Array = NDArray[np.float64]

EQUATIONS = 2
"""Counts the changes of the equations; a new number makes Numba compile this file anew."""

_STIFF = 0.5
"""Bristle decay over one step from which its exact solution is taken."""

POSITION, SPEED_COMMAND, SHUTTLE = 0, 1, 2
"""Modes of the controller: position loop, open speed command, constant speed between two positions."""


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
    delay: int
    """Delay of the drive, in steps."""


@njit(cache=True, error_model="numpy")
def bristle(z: float, v: float, decay: float, h: float) -> float:
    """Exact solution of dz/dt = v - decay·z after h, for constant v."""
    a = decay * h
    if a < 1e-6:
        return z + h * (v - decay * z)
    e = math.exp(-a)
    return z * e + v / decay * (1.0 - e)


@njit(cache=True, error_model="numpy")
def step(y: Array, command: float, now: Array, par: Parameters, h: float, work: Array, found: Array) -> None:
    """One step of h seconds, in place; `work` (3, STATES) and `found` (FINDINGS,) are scratch."""
    stage, dy, total = work[0], work[1], work[2]
    right_hand_side(y, command, now, par, dy, found)
    v, decay = y[V], found[DECAY]
    mean_v, mean_decay = v, decay
    stiff = decay * h > _STIFF
    for i in range(STATES):
        total[i] = dy[i]
    for part in range(3):
        length = h if part == 2 else 0.5 * h
        weight = 1.0 if part == 2 else 2.0
        for i in range(STATES):
            stage[i] = y[i] + length * dy[i]
        stiff = stiff or decay * h > _STIFF
        if stiff:
            stage[Z] = bristle(y[Z], v, decay, length)
        right_hand_side(stage, command, now, par, dy, found)
        v, decay = stage[V], found[DECAY]
        mean_v += weight * v
        mean_decay += weight * decay
        for i in range(STATES):
            total[i] += weight * dy[i]
    z = bristle(y[Z], mean_v / 6.0, mean_decay / 6.0, h)
    for i in range(STATES):
        y[i] += h / 6.0 * total[i]
    if stiff:
        y[Z] = z


@njit(cache=True, error_model="numpy")
def run(
    y: Array,
    conditions: Array,
    par: Parameters,
    control: Controller,
    lateness: NDArray[np.int64],
    substeps: int,
) -> tuple[Array, Array, Array]:
    """Run the plant for as many milliseconds as there are conditions.

    Parameters
    ----------
    y : (STATES,) initial state; holds the last one afterwards.
    conditions : (n, COLUMNS) one row per millisecond.
    par, control : constants.
    lateness : (n,) steps by which each sample is taken late, 0 to `substeps` - 1.
    substeps : steps per millisecond.

    Returns
    -------
    states (n, STATES), findings (n, FINDINGS) and commands (n,) at the sampling times.
    """
    n = conditions.shape[0]
    states = np.empty((n, STATES))
    findings = np.empty((n, FINDINGS))
    commands = np.zeros(n)
    work = np.empty((3, STATES))
    dy = np.empty(STATES)
    found = np.empty(FINDINGS)
    h = 1e-3 / substeps
    direction = 1.0
    rest = control.dwell
    for k in range(n):
        now = conditions[k]
        seen = control.encoder_gain * y[X] + control.encoder_zero
        if control.encoder_resolution > 0.0:
            seen = control.encoder_resolution * np.rint(seen / control.encoder_resolution)
        wanted = now[SETPOINT]
        if control.mode == POSITION:
            wanted = control.gain * (wanted - seen)
        elif control.mode == SHUTTLE:
            if rest > 0:
                rest -= 1
                wanted = 0.0
            elif (direction > 0.0 and seen >= control.high) or (direction < 0.0 and seen <= control.low):
                direction = -direction
                rest = control.dwell
                wanted = 0.0
            else:
                wanted *= direction
        if control.mode != POSITION and (
            (seen > control.limit and wanted > 0.0) or (seen < -control.limit and wanted < 0.0)
        ):
            wanted = 0.0
        commands[k] = min(max(wanted, -control.max_speed), control.max_speed)
        for i in range(substeps):
            since = k * substeps + i - control.delay
            command = commands[since // substeps] if since >= 0 else 0.0
            if i == lateness[k]:
                right_hand_side(y, command, now, par, dy, found)
                states[k] = y
                findings[k] = found
            step(y, command, now, par, h, work, found)
        if not math.isfinite(y[X] + y[SPEED]):
            states[k:] = np.nan
            findings[k:] = np.nan
            break
    return states, findings, commands
