"""Steps of controlled error: the embedded Runge-Kutta pair of Dormand and Prince, compiled.

The plant is oscillatory and has corners (reversals, valves), but hardly a stiff part: bristle, current
loop, check valves and gear mesh all live between 200 and 4000 1/s, and the controller acts every
millisecond. A pair of fifth order does most milliseconds in one step and shortens it where the estimate
asks for that.

J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comp. Appl. Math. 6 (1980),
doi:10.1016/0771-050X(80)90013-3.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import RK45

from fdd.plant import Array, Constants
from fdd.plant import state as s
from fdd.plant.compiled import njit
from fdd.plant.equations import right_hand_side

STAGES = 7
_SECOND, _THIRD, _FOURTH, _FIFTH = (tuple(row[:k].tolist()) for k, row in enumerate(RK45.A[2:], 2))
_END, _ERROR = tuple(RK45.B.tolist()), tuple(RK45.E.tolist())
"""Weights of the slopes so far: in the stages after the first two, at the end, and in the step's error."""
_SHORTEST = 1e-7  # s; a step that short is taken whatever its estimate says
_SAFETY, _LEAST_FACTOR, _MOST_FACTOR = 0.9, 0.2, 4.0

_TOLERANCES = {
    s.P1: 0.2, s.P2: 0.2, s.LINE_1: 0.2, s.LINE_2: 0.2, s.Z: 1e-11, s.MEMORY: 1e-7, s.ANGLE: 3e-8,
    s.SPEED: 3e-5, s.DRIVE: 3e-2, s.CURRENT: 3e-5, s.GAP: 1e-9, s.STORE: 1e-13, s.LOST: 1e-13,
    s.EXTERNAL_1: 1e-13, s.EXTERNAL_2: 1e-13, s.TEMPERATURE: 1e-6,
    s.VALVE_1: 1e-6, s.VALVE_2: 1e-6, s.FREE_1: 1e-8, s.FREE_2: 1e-8, s.GAS: 1e-7, s.RELIEF: 2.0,
}  # fmt: skip


def tolerances(axes: int, refine: float = 1.0) -> Array:
    """Error allowed for each state over one step.

    Far below what the sensors resolve: an error of the bristle at a reversal lives on in where the piston
    sticks, and the encoders count that. `refine` 2 asks for steps half as long (fifth order: errors a 32nd).
    """
    axis = np.array([_TOLERANCES[i] for i in range(s.AXIS_STATES)])
    shared = np.array([1e-10, 1e-7, 0.2])
    return np.concatenate([shared, *[axis] * axes]) * refine**-5.0


@njit(error_model="numpy", inline="always")
def _combined(weights: tuple[float, ...], k: Array, i: int) -> float:
    total = weights[0] * k[0, i]
    for j in range(1, len(weights)):
        total += weights[j] * k[j, i]
    return total


@njit(error_model="numpy", _nrt=False)
def step(
    y: Array, h: float, command_1: float, command_2: float, now: Array, first: Constants, second: Constants,
    per_allowed: Array, k: Array, stage: Array, found: Array,
) -> float:  # fmt: skip
    """One step of h seconds from y; returns the largest error over what is allowed.

    `k` (STAGES, n) holds f(y) in its first row and gets that of the end in its last; `stage` (n,) gets the
    state at the end; y stays.
    """
    n = y.size
    for i in range(n):
        stage[i] = y[i] + h * 0.2 * k[0, i]
    right_hand_side(stage, command_1, command_2, now, first, second, k[1], found)
    for i in range(n):
        stage[i] = y[i] + h * _combined(_SECOND, k, i)
    right_hand_side(stage, command_1, command_2, now, first, second, k[2], found)
    for i in range(n):
        stage[i] = y[i] + h * _combined(_THIRD, k, i)
    right_hand_side(stage, command_1, command_2, now, first, second, k[3], found)
    for i in range(n):
        stage[i] = y[i] + h * _combined(_FOURTH, k, i)
    right_hand_side(stage, command_1, command_2, now, first, second, k[4], found)
    for i in range(n):
        stage[i] = y[i] + h * _combined(_FIFTH, k, i)
    right_hand_side(stage, command_1, command_2, now, first, second, k[5], found)
    for i in range(n):
        stage[i] = y[i] + h * _combined(_END, k, i)
    right_hand_side(stage, command_1, command_2, now, first, second, k[6], found)
    worst, total = 0.0, 0.0
    for i in range(n):
        error = h * _combined(_ERROR, k, i)
        share = abs(error) * per_allowed[i]
        worst = share if share > worst else worst
        total += error
    # Comparisons pass a NaN by, a sum does not.
    return worst if math.isfinite(total) else math.inf


@njit(error_model="numpy", _nrt=False)
def advance(
    y: Array, span: float, length: float, longest: float, command_1: float, command_2: float, now: Array,
    first: Constants, second: Constants, per_allowed: Array, k: Array, stage: Array, found: Array,
) -> tuple[float, int]:  # fmt: skip
    """Go on by `span` seconds, in place, from y and f(y) in k[0]; `length` (s) is the step to try first.

    Gives the length to try next (negative where the state has left all bounds) and the number of steps tried.
    """
    left, tried = span, 0
    while left > 1e-12:
        length = min(length, longest)
        h = length
        if h >= 0.999999 * left:
            h = left
        elif 2.0 * h > left:
            h = 0.5 * left  # rather two equal steps than one and a sliver
        worst = step(y, h, command_1, command_2, now, first, second, per_allowed, k, stage, found)
        tried += 1
        if worst <= 1.0 or (h <= _SHORTEST and math.isfinite(worst)):
            for i in range(y.size):
                y[i] = stage[i]
                k[0, i] = k[STAGES - 1, i]
            left -= h
            factor = _MOST_FACTOR if worst < 1e-6 else min(_SAFETY * worst**-0.2, _MOST_FACTOR)
            # A step cut short by the end of the span says little about the length that would do.
            length = max(h * factor, length) if factor >= 1.0 else h * factor
        elif math.isfinite(worst):
            length = h * max(_SAFETY * worst**-0.2, _LEAST_FACTOR)
        elif h > _SHORTEST:
            length = 0.1 * h
        else:
            return -1.0, tried
    return length, tried
