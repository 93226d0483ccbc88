"""Rows that cannot be true, found as they come: nothing is held back, and only earlier rows are asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.compiled import njit
from fdd.sensors.limits import INDEX, SIGMA, Limits
from fdd.sensors.memory import Memory

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BACK_S = 0.05
"""A value that does not come back within this time has jumped for good."""
SPEED = INDEX["pump_speed"]


def row_bounds(limits: Limits) -> Array:
    """Least and largest value of a row, largest change in a second, and an allowance on that, (4, 12).

    The change is inf where none is known.
    """
    reach = SIGMA * limits.noise + limits.resolution
    rate = np.full(reach.size, np.inf)
    rate[INDEX["position"]], rate[INDEX["pump_angle"]] = limits.piston_speed, 1.3 * limits.pump_speed
    bounds = np.stack([limits.low - reach, limits.high + reach, rate, 4.0 * reach])
    # A speed that is a difference of counts over the nominal period doubles where a row comes a period late.
    bounds[:2, SPEED] *= 2.0
    return bounds


@njit(nogil=True)
def impossible_rows(
    time: Array, values: Array, frame_begin: float, bounds: Array, dead: Array, memory: Memory
) -> Mask:
    """Impossible values among `values` (12, n), taken at `time` (n,) s; rows have to come in their order.

    Parameters
    ----------
    frame_begin : s, first row of the frame that the rows belong to. bounds : see `row_bounds`.
    dead : (12,) what a broken loop reads. memory : where the last good values are kept.
    """
    out = np.zeros(values.shape, np.bool_)
    slack = np.empty(time.size)
    older, old = memory.stamps
    for i in range(time.size):
        # A late stamp takes time from the next step: allow for the two steps together.
        step, before = time[i] - old, old - older
        slack[i] = (0.0 if np.isnan(step) else step) + (0.0 if np.isnan(before) else before)
        older, old = old, time[i]
    memory.stamps[0], memory.stamps[1] = older, old
    for k in range(values.shape[0]):
        loose = memory.held_until[k] > frame_begin
        previous, low, high = memory.previous[k], bounds[0, k], bounds[1, k]
        for i in range(time.size):
            value = values[k, i]
            out[k, i] = value < low or value > high or (loose and (value == previous or value == dead[k]))
            previous = value
        memory.previous[k] = previous
        if bounds[2, k] < np.inf:
            _too_fast(time, slack, values[k], out[k], k, bounds[2, k], bounds[3, k], memory)
    return out


@njit(nogil=True)
def _too_fast(
    time: Array, slack: Array, values: Array, out: Mask, k: int, rate: float, floor: float, memory: Memory
) -> None:
    """Mark rows farther from the last good one than the rate allows, until they come back or stay."""
    good, at, doubtful = memory.good_value[k], memory.good_time[k], memory.doubtful_since[k]
    for i in range(time.size):
        if np.isnan(values[i]) or out[i]:
            continue
        far = abs(values[i] - good) > rate * (time[i] - at + slack[i]) + floor
        if far and not time[i] - doubtful >= BACK_S:
            out[i] = True
            doubtful = time[i] if np.isnan(doubtful) else doubtful
        else:
            good, at, doubtful = values[i], time[i], np.nan
    memory.good_value[k], memory.good_time[k], memory.doubtful_since[k] = good, at, doubtful
