"""What of a row's jump physics and the recorder explain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.compiled import njit
from fdd.sensors.jumps import excess
from fdd.sensors.limits import INDEX, Limits
from fdd.sensors.noise import smallest

Array = NDArray[np.float64]

ANGLE, POSITION = INDEX["pump_angle"], INDEX["position"]
ONE, TWO, DIFFERENCE = INDEX["pressure_1"], INDEX["pressure_2"], INDEX["pressure_difference"]
BREAKS_LOOSE = 0.75
"""Of a·w², what the mean rate over w can be beyond those before and after, where a piston speeds up and slows
down at a: at the peak, (V w - a w²/4) - (V w - a w²). Less than a quarter where it all happens within w."""
NOISE_RANGE = 4.0
"""Standard deviations from the least to the largest of ten values of Gaussian noise, as a rule at most."""


@njit(nogil=True)
def explained(k: int, time: Array, values: Array, swept: Array, stride: int, limits: Limits) -> Array:
    """What an excess of channel k may be in each row, (n,); inf beside missing rows.

    Parameters
    ----------
    values : (12, n). swept : (n,) m³ that the pump displaced, (0,) where that is not known.
    """
    steps = np.zeros(time.size)
    steps[1:] = time[1:] - time[:-1]
    period = smallest(steps[1:].copy(), (time.size - 1) // 2)
    off = widest(np.abs(steps - period), 2 * stride)
    if k == ANGLE:
        # A row that came a whole period late shows no step and then two; one between two late ones is
        # short before and after, and seems to want three.
        usual = np.minimum(usual_step(time, values[k]), limits.pump_speed * period)
        rows = 2.0 + (off > 0.25 * period)
        out = rows * stride * usual + limits.acceleration * (stride * period) ** 2
    elif k == POSITION:
        out = np.full(time.size, BREAKS_LOOSE * limits.release * (stride * period) ** 2)
        # Late and missing rows are late and missing in the pump's angle too.
        out += 1.5 * widest(np.abs(excess(time, swept / limits.area, stride)), 2 * stride)
        # A light piston swings on its oil when the pump's teeth meet their resonance: Δp swings with it.
        out += (
            BREAKS_LOOSE
            * limits.lightness
            * pressure_swing(values, 3 * stride, limits)
            * (stride * period) ** 2
        )
        # A piston that its load moves while the pump stands: what it goes in the time that a row is late.
        out += np.minimum(off / period, 1.0) * stride * usual_step(time, values[k])
    else:
        out = limits.stiffness * stride * widest(moved_oil(values[POSITION], swept, limits), 3 * stride)
    out[widest(steps, stride) > 3.5 * period] = np.inf
    return out


@njit(nogil=True)
def pressure_swing(values: Array, reach: int, limits: Limits) -> Array:
    """How far Δp goes within `reach` rows on either side, beyond its noise, (n,) Pa; 0 where not known."""
    difference, noise, known = values[DIFFERENCE], limits.noise[DIFFERENCE], False
    for x in difference:  # np.all and np.where would load the compiler where all is compiled already
        known = known or not np.isnan(x)
    if not known:
        difference = values[ONE] - values[TWO]
        noise = np.hypot(limits.noise[ONE], limits.noise[TWO])
    swing = widest(difference, reach) + widest(-difference, reach) - NOISE_RANGE * noise
    for k in range(swing.size):
        if not swing[k] > 0.0:
            swing[k] = 0.0
    return swing


@njit(nogil=True)
def moved_oil(position: Array, swept: Array, limits: Limits) -> Array:
    """Oil that pump and piston move from row to row at most, (n,) m³."""
    flow = np.zeros(position.size)
    for i in range(1, position.size):
        if swept.size:
            flow[i] = abs(swept[i] - swept[i - 1])
        step = position[i] - position[i - 1]
        if not np.isnan(step):
            flow[i] += limits.area * abs(step)
    return flow


@njit(nogil=True)
def widest(values: Array, reach: int) -> Array:
    """Largest of each of (n,) and the `reach` on either side; NaN where one of them is."""
    out = values.copy()
    for i in range(values.size):  # element by element: assigned slices compile for a second
        for k in range(max(i - reach, 0), min(i + reach + 1, values.size)):
            out[i] = np.maximum(out[i], values[k])
    return out


@njit(nogil=True)
def usual_step(time: Array, values: Array) -> Array:
    """Median size of a row's step and two on either side, (n,): two wild rows cannot raise it.

    Between the measurements of a channel that is slower than the rows, its steps are those of a line.
    """
    line, before = values.copy(), -1
    for i in range(values.size):
        if np.isnan(values[i]):
            line[i] = line[max(before, 0)]
            continue
        for j in range(before + 1, i):
            share = (time[j] - time[before]) / (time[i] - time[before]) if before >= 0 else 1.0
            line[j] = values[i] if before < 0 else values[before] + share * (values[i] - values[before])
        before = i
    steps = np.zeros(values.size + 4)
    steps[3:-2] = np.abs(line[1:] - line[:-1])
    steps[-2:] = steps[-3]
    out = np.empty(values.size)
    for i in range(values.size):
        out[i] = smallest(steps[i : i + 5].copy(), 2)
    return out
