"""Steps of rows, and of cells of 20 ms, beyond what their neighbours show: one pass over all channels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.compiled import njit
from fdd.sensors.explained import ANGLE, POSITION, moved_oil, widest
from fdd.sensors.limits import CHAMBERS, INDEX, Limits
from fdd.sensors.memory import CELL_HISTORY, Memory
from fdd.sensors.noise import GAUSS_90, place, smallest

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CELL_S = 0.02
BESIDE_CELLS = 3
"""Cells on either side that a cell's step is compared with."""
COUNTS = 6.0
"""Allowance in counts: rounding gives an excess of up to 2, hysteresis and unevenness of a plain scale as
much each."""
CELL_REACH = 12.0
"""Standard deviations of a cell's mean: as `jumps.NOISE_REACH`, less since the history counts as well."""
LEARNT_CELLS = 25
PUMP_DOUBT = 0.5
"""Share of the pump's own change that the piston need not follow: leakage, unequal areas, an open valve."""
STRIDES = (1, 2)
LOADED = tuple(INDEX[n] for n in (*CHAMBERS, "pressure_difference"))


class Cells(NamedTuple):
    """Of the judged channels, NaN and 0 of the others.

    Attributes
    ----------
    peaks : (2, 12) largest excess of a row for either of `STRIDES`.
    means, over : (12, cells) mean of each cell, and how far its step exceeds those of its neighbours.
    limit : (12, cells) what `over` may be; inf for a channel in which nothing is beyond its noise.
    """

    peaks: Array
    means: Array
    over: Array
    limit: Array


@njit(nogil=True)
def cells_of(
    time: Array, values: Array, swept: Array, judged: Mask, noise: Array, origin: float, cells: int,
    limits: Limits, memory: Memory,
) -> Cells:  # fmt: skip
    """Look at `values` (12, n) of the judged channels in `cells` cells from `origin` (s) on.

    Parameters
    ----------
    swept : (n,) m³ that the pump displaced, (0,) where that is not known. noise : (12,) of a row.
    memory : what its cells showed before goes on.
    """
    channels, fresh = values.shape[0], cells - 2 * BESIDE_CELLS
    edges = np.empty(cells + 1, np.int64)
    for c in range(edges.size):
        edges[c] = place(time, origin + CELL_S * (c - 1e-6))
    peaks, means = np.zeros((len(STRIDES), channels)), np.full((channels, cells), np.nan)
    over, limit = np.zeros((channels, cells)), np.full((channels, cells), np.inf)
    per_cell = max(CELL_S * (time.size - 1) / (time[-1] - time[0]), 1.0)
    pumped, moved = np.empty(0), np.empty(0)
    for s in range(len(STRIDES)):
        peaks[s] = _peaks(time, values, judged, STRIDES[s])
    for k in range(channels):
        if judged[k]:
            means[k] = cell_means(values[k], edges)
            over[k] = cell_excess(means[k])
    if judged[POSITION]:
        pumped = cell_means(swept / limits.area, edges)
        # It has to show in the position alone and against the pump: an angle that jumps is no slip.
        relative = cell_excess(means[POSITION] - pumped)
        for c in range(cells):
            if abs(relative[c]) < abs(over[POSITION, c]):
                over[POSITION, c] = relative[c]
    for k in range(channels):
        if not judged[k]:
            continue
        past, usual = int(memory.cell_count[k]), 0.0
        if past:
            usual = smallest(memory.cells[k, CELL_HISTORY - past :].copy(), int(0.9 * (past - 1))) / GAUSS_90
        floor = COUNTS * limits.resolution[k] + CELL_REACH * max(
            usual, max(noise[k], limits.noise[k]) / np.sqrt(per_cell)
        )
        beyond = False
        memory.cells[k, :-fresh] = memory.cells[k, fresh:].copy()
        for c in range(fresh):
            size = abs(over[k, BESIDE_CELLS + c])
            memory.cells[k, CELL_HISTORY - fresh + c] = min(size, floor)
            beyond = beyond or size > floor
        memory.cell_count[k] = min(past + fresh, CELL_HISTORY)
        if past < LEARNT_CELLS or not beyond:
            continue
        # What physics explains.
        if k == ANGLE:
            limit[k] = floor + limits.pump_speed * 2.0 * CELL_S
        elif k == POSITION:
            limit[k] = floor + PUMP_DOUBT * cell_range(pumped)
            taken = 0
            for j in LOADED:
                if judged[j] and taken < 2:
                    limit[k] += limits.softness * cell_range(means[j])
                    taken += 1
        else:
            if not moved.size:
                oil = moved_oil(values[POSITION], swept, limits)
                for i in range(1, oil.size):
                    oil[i] += oil[i - 1]
                moved = cell_range(cell_means(oil, edges))
            limit[k] = floor + limits.stiffness * moved
    return Cells(peaks, means, over, limit)


@njit(nogil=True)
def _peaks(time: Array, values: Array, judged: Mask, stride: int) -> Array:
    """Largest size of `jumps.excess` in each judged channel, (12,); 0 in the others."""
    n, peaks = time.size, np.zeros(judged.size)
    if n < 4 * stride:
        return peaks
    steps = np.maximum(time[stride:] - time[:-stride], 0.5 * stride * (time[-1] - time[0]) / (n - 1))
    rate = np.empty(steps.size)
    for k in range(judged.size):
        if not judged[k]:
            continue
        for i in range(rate.size):
            rate[i] = (values[k, i + stride] - values[k, i]) / steps[i]
        peak = 0.0
        for i in range(n - 3 * stride):
            earlier, middle, later = rate[i], rate[i + stride], rate[i + 2 * stride]
            # Neither is true of a NaN.
            if middle > earlier and middle > later:
                peak = max(peak, (middle - max(earlier, later)) * steps[i + stride])
            elif middle < earlier and middle < later:
                peak = max(peak, (min(earlier, later) - middle) * steps[i + stride])
        peaks[k] = peak
    return peaks


@njit(nogil=True)
def cell_means(values: Array, edges: NDArray[np.int64]) -> Array:
    """Mean of the rows between `edges`, (cells,); NaN where rows or values lack."""
    out = np.full(edges.size - 1, np.nan)
    if edges[-1] > edges[0]:
        # Summed about the first row: the angle of a long log is large, a slip small.
        base = values[edges[0]]
        for c in range(out.size):
            total = 0.0
            for i in range(edges[c], edges[c + 1]):
                total += values[i] - base
            if edges[c + 1] > edges[c]:
                out[c] = total / (edges[c + 1] - edges[c]) + base
    return out


@njit(nogil=True)
def cell_excess(means: Array) -> Array:
    """Step over two cells around each cell, beyond what the two steps before and after show, like `means`."""
    out = np.zeros(means.size)
    for c in range(BESIDE_CELLS, means.size - BESIDE_CELLS):
        earlier, middle = means[c - 1] - means[c - 3], means[c + 1] - means[c - 1]
        later = means[c + 3] - means[c + 1]
        if not np.isnan(earlier + middle + later):
            out[c] = middle - min(max(middle, min(earlier, later)), max(earlier, later))
    return out


@njit(nogil=True)
def cell_range(means: Array) -> Array:
    """Highest less lowest of each cell and three on either side, (cells,); NaN where one of them is."""
    return widest(means, BESIDE_CELLS) + widest(-means, BESIDE_CELLS)
