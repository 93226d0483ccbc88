"""Statistics of a frame's rows: one compiled pass over all channels; gaps and long runs are listed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.compiled import njit
from fdd.sensors.constancy import FEWEST_ROWS, is_held, rows_needed, shows_noise
from fdd.sensors.limits import CHAMBERS, INDEX, IS_LIVE, IS_MEASURED, Limits
from fdd.sensors.memory import Memory
from fdd.sensors.noise import spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FRAME_S = 0.5
LONG_GAP_S = 0.25
"""s: gaps of one channel from this length on are reported: eight times the longest burst that a healthy
recorder loses."""
LOST_SHARE, LOST_WINDOW_S = 0.05, 10.0
"""Shorter gaps are reported when they make up this share of the last ten seconds."""
SPARSE_SHARE = 0.8
"""A channel with fewer values than this is a slow one that stands between faster ones."""
ONE, TWO, DIFFERENCE = (INDEX[n] for n in (*CHAMBERS, "pressure_difference"))


@dataclass(frozen=True)
class Scan:
    """What the rows of a frame show, (12,) each but the lists.

    Attributes
    ----------
    seen : values in the frame and the tail before it. measured : whether the frame has values to be judged.
    least, most : of the frame. noise : of a row, with the tail, see `spread`.
    repeated : share of values that are those of the row before. longest : rows of the longest run.
    whole : whether the frame is one run.
    bursts : whether short gaps make up too much of the last ten seconds.
    gaps : (g, 3) channel, since, until (s; NaN while it lasts), of those from `LONG_GAP_S` on.
    runs : (r, 5) channel, value, since, until, rows, of those that are too long.
    """

    seen: Array
    least: Array
    most: Array
    noise: Array
    repeated: Array
    longest: Array
    measured: Mask
    whole: Mask
    bursts: Mask
    gaps: Array
    runs: Array

    @classmethod
    def of(
        cls, time: Array, values: Array, first: int, kind: int, end: float, limits: Limits, memory: Memory
    ) -> Scan:
        """Rows ``first:`` of `values` (12, n), which are the frame's, held against limits and the frames
        before.

        Parameters
        ----------
        kind : `STILL` or `MOVING`. end : s, of the frame. memory : its counts, gaps and runs go on.
        """
        figures, flags, gaps, runs = _scan(time, values, first, kind, end, limits, memory)
        shown: tuple[Any, ...] = (*figures, *flags, gaps, runs)
        return cls(*shown)


@njit(nogil=True)
def _scan(
    time: Array, values: Array, first: int, kind: int, end: float, limits: Limits, memory: Memory
) -> tuple[Array, Mask, Array, Array]:
    """Figures (6, 12), flags (3, 12) and lists of a `Scan`: few arrays, as each takes time to hand over."""
    channels, n = values.shape
    _derived(values[:, first:], memory)
    figures, flags = np.zeros((6, channels)), np.zeros((3, channels), np.bool_)
    seen, least, most, noise, repeated, longest = figures
    measured, whole, bursts = flags
    # Half a second has room for one long gap that ends, and two more.
    gaps, runs = np.empty((channels * 4, 3)), np.empty((channels * (n // FEWEST_ROWS + 2), 5))
    gap_count = run_count = 0
    known, at = np.empty(n), np.empty(n)
    for k in range(channels):
        count = before = 0
        low, high = np.inf, -np.inf
        for i in range(n):
            value = values[k, i]
            before = count if i == first else before
            if not np.isnan(value):
                known[count], at[count] = value, time[i]
                count += 1
                if i >= first:
                    low, high = min(low, value), max(high, value)
        seen[k], least[k], most[k] = count, low, high
        memory.rows[k] += n - first
        memory.present[k] += count - before
        if memory.present[k] == 0.0 or (k == DIFFERENCE and memory.derived[0] == 1.0):
            continue
        gap_count, bursts[k] = _gaps(
            k, time[first:], values[k, first:], count - before, end, memory, gaps, gap_count
        )
        if count == before or not IS_MEASURED[k]:
            continue
        measured[k], noise[k] = True, spread(known[:count])
        run_count, longest[k], repeats = _runs(
            k, kind, at[before:count], known[before:count], end, limits, memory, runs, run_count
        )
        repeated[k] = repeats / max(count - before - 1, 1)
        whole[k] = longest[k] >= count - before
    return figures, flags, gaps[:gap_count], runs[:run_count]


@njit(nogil=True, inline="always")
def _derived(values: Array, memory: Memory) -> None:
    """Whether Δp carries nothing of its own, so that it fails with the chambers' pressures."""
    worst = -1.0
    if memory.derived[0] != 0.0:
        for i in range(values.shape[1]):
            off = abs(values[DIFFERENCE, i] - (values[ONE, i] - values[TWO, i]))
            if off > worst:
                worst = off
    if worst >= 0.0:
        memory.derived[0] = 1.0 if worst < 1e-3 else 0.0


@njit(nogil=True, inline="always")
def _gaps(
    k: int, time: Array, values: Array, there: int, end: float, memory: Memory, gaps: Array, count: int
) -> tuple[int, bool]:
    """Enter long gaps of a channel that was there; whether short ones are too many."""
    memory.absent_s[k] *= np.exp(-FRAME_S / LOST_WINDOW_S)
    since = memory.absent_since[k]
    if there == time.size and np.isnan(since):
        return count, False
    sparse = memory.present[k] < SPARSE_SHARE * memory.rows[k] and np.isnan(memory.failed_since[k])
    for i in range(time.size + 1):
        open_ = i < time.size and np.isnan(values[i])
        if open_ and np.isnan(since):
            since = time[i]
        if np.isnan(since) or open_:
            continue
        # The gap is over, or the frame is.
        until = time[i] if i < time.size else np.nan
        stop = end if i == time.size else until
        if memory.absent_s[k] < 1e-2:
            memory.absent_first[k] = since
        memory.absent_s[k] += max(stop - max(since, end - FRAME_S), 0.0)
        if stop - since >= LONG_GAP_S and not sparse:
            gaps[count, 0], gaps[count, 1], gaps[count, 2] = k, since, until
            count += 1
        memory.absent_since[k] = since if i == time.size else np.nan
        since = np.nan
    return count, memory.absent_s[k] > LOST_SHARE * LOST_WINDOW_S and not sparse


@njit(nogil=True, inline="always")
def _runs(
    k: int, kind: int, time: Array, values: Array, end: float, limits: Limits, memory: Memory, runs: Array,
    count: int,
) -> tuple[int, float, int]:  # fmt: skip
    """Enter runs of equal values that are too long; the longest, and how many values are repeated."""
    # A profile's noise of an encoder was taken in motion: only what moves at rest too has to move always.
    live = IS_LIVE[k] or shows_noise(k, memory, limits)
    need = rows_needed(k, kind, memory, limits)
    value, since, rows = memory.run_value[k], memory.run_since[k], memory.run_rows[k]
    longest, repeats = 0.0, 0
    for i in range(values.size + 1):
        if i < values.size and values[i] == value:
            rows, repeats = rows + 1.0, repeats + (i > 0)
            continue
        if i > 0:  # A run that ended with the frame before was judged there.
            longest = max(longest, rows)
            memory.changed[k] = 1.0 if i < values.size else memory.changed[k]
            length = (time[i] if i < values.size else end) - since
            if rows >= FEWEST_ROWS and is_held(k, value, length, rows, live, need, memory, limits):
                runs[count, 0], runs[count, 1], runs[count, 2] = k, value, since
                runs[count, 3], runs[count, 4] = time[i] if i < values.size else np.nan, rows
                count += 1
        if i < values.size:
            if not np.isnan(value):
                memory.changed[k] = 1.0
            memory.last_value[k] = value
            value, since, rows = values[i] + 0.0, time[i], 1.0  # no negative zero in messages
    memory.run_value[k], memory.run_since[k], memory.run_rows[k] = value, since, rows
    return count, longest, repeats
