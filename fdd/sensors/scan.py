"""Statistics of a frame's rows, one compiled pass over all channels: gaps, and runs of one value.

Noise of σ leaves a row at its predecessor's value with the chance ``p = q/(σ·√(4π))`` (q: one count), so n
equal rows have the chance ``p^n``; `LOG_ODDS` asks for 1.4e-11, which eight channels at 1 kHz meet once in
2,500 h. What the channel's own good frames showed counts as well: a log that repeats or rounds its values has
a larger p. Without noise a value may stand for ever, and only its neighbours can tell (`standing_position`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.finding import Memory, njit
from fdd.sensors.limits import DIFFERENCE, IS_LIVE, IS_MEASURED, ONE, POSITION, STEADY_NOISE, TWO, Limits

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GAUSS_75, GAUSS_90 = 1.1503, 1.6449
"""Quantiles of the absolute value of a standard normal variable at 75 and 90 %."""
LEAST_VALUES = 8
FRAME_S = 0.5
LONG_GAP_S = 0.25
"""s: gaps of one channel from this length on are reported: eight times the longest burst that a healthy
recorder loses."""
LOST_SHARE, LOST_WINDOW_S = 0.05, 10.0
"""Shorter gaps are reported when they make up this share of the last ten seconds."""
SPARSE_SHARE = 0.8
"""A channel with fewer values than this is a slow one that stands between faster ones."""
LOG_ODDS = 25.0
FEWEST_ROWS = 8
LEARNT_FRAMES = 4
"""Fewest good frames of a class (still or moving) from which its statistics are used."""
FROM_START_S = 1.0
"""A channel that never changed has shown no noise at all: the profile may be wrong, so it gets this time, in
which the pump has to turn."""
RAIL_S = 0.2
EXCITED_FRAMES, NOISELESS_FRAMES = 2, 8
"""Frames with a turning pump, for a channel that should have noise, and for one that need not."""
LEAST_NOISE = 1e-5
"""Share of the range: no analogue sensor has less noise."""
LEAK_MARGIN = 3.0
"""Times the healthy leakage that may let the pump turn while the piston stands: a gross leak."""
BYPASS_SHARE, BYPASS_PRESSURE = 0.57, 1e6
"""Share of the pump's largest flow that goes over a valve stuck fully open at this Δp (Pa), as an orifice:
what the catalogue's relief valve passes at severity 1. With it a piston may rest on its friction as the pump
turns, but it comes to rest because the pump slows down."""
FROZEN_S = 0.03
"""Before and after the position stopped: did both move before, and does the pump go on as it did?"""
LEAST_TRAVEL = 0.05
"""Share of the stroke that the pump has to have displaced, as the position stood."""
RELIEF_SHARE = 0.6
"""Share of the relief setting from which flow may go over the valve."""


class Scan(NamedTuple):
    """What the rows of a frame show, (12,) each but the lists."""

    seen: Array  # values in the frame and the tail before it
    least: Array  # of the frame
    most: Array  # of the frame
    noise: Array  # of a row, with the tail, see `spread`
    repeated: Array  # share of values that are those of the row before
    longest: Array  # rows of the longest run
    measured: Mask  # whether the frame has values to be judged
    whole: Mask  # whether the frame is one run
    bursts: Mask  # whether short gaps make up too much of the last ten seconds
    gaps: Array  # (g, 3) channel, since, until (s; NaN while it lasts), of those from `LONG_GAP_S` on
    runs: Array  # (r, 5) channel, value, since, until, rows, of those that are too long


@njit(nogil=True)
def scan(
    time: Array, values: Array, first: int, kind: int, end: float, limits: Limits, memory: Memory
) -> Scan:
    """Rows ``first:`` of `values` (12, n), the frame's until `end` (s), held against limits and the frames
    before; its `kind` is `STILL` or `MOVING`; counts, gaps and runs of `memory` go on."""
    channels, n = values.shape
    # Does Δp carry anything of its own? If not, it fails with the chambers' pressures.
    worst = -1.0
    if memory.derived[0] != 0.0:
        for i in range(first, n):
            off = abs(values[DIFFERENCE, i] - (values[ONE, i] - values[TWO, i]))
            if off > worst:
                worst = off
    if worst >= 0.0:
        memory.derived[0] = 1.0 if worst < 1e-3 else 0.0
    seen, least, most, noise, repeated, longest = np.zeros((6, channels))
    measured, whole, bursts = np.zeros((3, channels), np.bool_)
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
    return Scan(
        seen, least, most, noise, repeated, longest, measured, whole, bursts, gaps[:gap_count],
        runs[:run_count],
    )  # fmt: skip


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
    live = IS_LIVE[k] or _shows_noise(k, memory, limits)
    need = rows_needed(k, kind, memory, limits)
    reach = limits.resolution[k]
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
            # Too long for an end of the range, or at all?
            outside = value >= limits.rail[k] - reach or not limits.low[k] <= value <= limits.high[k]
            held = outside and length >= RAIL_S
            if live and not held:
                frames = EXCITED_FRAMES if limits.repeat[k] < 1.0 else NOISELESS_FRAMES
                unchanged = length >= FROM_START_S and memory.excited[k] >= frames
                held = unchanged if memory.changed[k] == 0.0 else rows >= need
            if rows >= FEWEST_ROWS and held:
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


@njit(nogil=True, inline="always")
def rows_needed(k: int, kind: int, memory: Memory, limits: Limits) -> float:
    """Equal rows from which on the channel is stuck; inf where that cannot be said."""
    chance = limits.repeat[k]
    if chance >= 1.0 and not _shows_noise(k, memory, limits):
        return np.inf
    if memory.frames[kind, k] >= LEARNT_FRAMES:
        own = memory.repeat[kind, k]
        chance = max(own, chance) if chance < 1.0 else own
    if chance >= 0.9995:
        return np.inf
    return max(float(FEWEST_ROWS), LOG_ODDS / -np.log(max(chance, 1e-3)))


@njit(nogil=True, inline="always")
def _shows_noise(k: int, memory: Memory, limits: Limits) -> bool:
    """Whether a channel without noise in its profile had some in every good frame, at rest too."""
    count = max(limits.resolution[k], LEAST_NOISE * limits.high[k])
    quietest = min(memory.quietest[0, k], memory.quietest[1, k])
    learnt = memory.frames[0, k] + memory.frames[1, k] >= LEARNT_FRAMES
    return bool(learnt and quietest >= STEADY_NOISE * count)


@njit(nogil=True)
def standing_position(
    time: Array, position: Array, swept: Array, pressure: Array, begin: int, memory: Memory, limits: Limits
) -> bool:
    """Whether the pump displaced far more than a standing piston lets it, since the position changed.

    Of `position` (n,) m, `swept` (n,) m³ and `pressure` (n,) Pa, Δp, the rows from `begin` on are new. The
    memory's `volume` goes on, from 0 when the position changes; what it was then stands in `stood`.

    Allowed are three times the healthy leakage, what the oil takes at `Limits.softness` and, unless the
    position stopped in mid-motion (`_stopped_in_motion`), a valve that is stuck open. Rows near the relief
    setting do not count.
    """
    if swept.size < begin + 2:
        return False
    volume, stood, since = memory.volume, memory.stood, memory.run_since[POSITION]
    if since >= time[begin]:
        for i in range(begin + 1, swept.size):
            if position[i] != position[i - 1]:
                if stood[3] < time[begin]:  # it stood before these rows as well
                    stood[0], stood[1], stood[2] = stood[3], time[i], volume[0] + swept[i] - swept[begin]
                break
        volume[:] = 0.0
    stood[3] = since
    if _stopped_in_motion(time, position, swept / limits.area, since, limits.resolution[POSITION]):
        volume[4] = 1.0
    bypass = 0.0 if volume[4] else BYPASS_SHARE * limits.displacement * limits.pump_speed
    for i in range(begin + 1, swept.size):
        level = limits.relief if np.isnan(pressure[i]) else abs(pressure[i])
        if time[i] > since and level < RELIEF_SHARE * limits.relief:
            flow = LEAK_MARGIN * limits.leakage * level + bypass * np.sqrt(level / BYPASS_PRESSURE)
            volume[0] += swept[i] - swept[i - 1]
            volume[3] += flow * (time[i] - time[i - 1])
        volume[1], volume[2] = min(volume[1], volume[0]), max(volume[2], volume[0])
    low = high = 0.0
    for level in pressure[begin:]:
        low, high = level if level < low else low, level if level > high else high
    elastic = limits.softness * limits.area * (high - low)
    least = limits.area * max(LEAST_TRAVEL * limits.stroke, 20.0 * limits.resolution[POSITION])
    return bool(volume[2] - volume[1] > volume[3] + elastic + least)


@njit(nogil=True)
def _stopped_in_motion(time: Array, position: Array, moved: Array, since: float, count: float) -> bool:
    """Whether position and pump moved together until `since`, and the pump then went on alone. `moved` (n,) m
    is the pump's volume over the area, `count` (m) the resolution of the position."""
    a, b, c = (place(time, since - FROZEN_S), place(time, since), place(time, since + FROZEN_S))
    if time[0] > since - FROZEN_S or c >= time.size or b - a < 2:
        return False
    travel, before, after = position[b] - position[a], moved[b] - moved[a], moved[c] - moved[b]
    together = abs(travel) > max(0.5 * abs(before), 4.0 * count) and travel * before > 0.0
    return bool(together and after * before > 0.0 and abs(after) > 0.5 * abs(before))


@njit(nogil=True)
def smallest(values: Array, rank: int) -> float:
    """The value of this rank (0: least) among (n,) without NaN, which are put in another order, by Hoare's
    selection: on what a frame has it takes half the time of NumPy's partition."""
    low, high = 0, values.size - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return float(values[rank])


@njit(nogil=True)
def place(values: Array, at: float) -> int:
    """How many of (n,) rising values lie before `at`.

    Numba's own search, differences and sums each bring the compiler's modules along when kept code is loaded.
    """
    low, high = 0, values.size
    while low < high:
        middle = (low + high) // 2
        if values[middle] < at:
            low = middle + 1
        else:
            high = middle
    return low


@njit(nogil=True)
def spread(values: Array) -> float:
    """Standard deviation of the rows' noise in (n,) without NaN; 0 of fewer than 8.

    From second differences, robust to jumps in up to a tenth of the rows. The larger of two quantiles, so
    that it is not 0 where values are rounded and mostly stand still, and covers a frame of which only a part
    is noisy.
    """
    if values.size < LEAST_VALUES:
        return 0.0
    second = np.empty(values.size - 2)
    for i in range(second.size):
        second[i] = abs((values[i + 2] - values[i + 1]) - (values[i + 1] - values[i]))
    at_75, at_90 = int(0.75 * (second.size - 1)), int(0.9 * (second.size - 1))
    high = smallest(second, at_90)
    return max(smallest(second[:at_90], at_75) / GAUSS_75, high / GAUSS_90) / np.sqrt(6.0)
