"""Channels that stop changing: how many equal rows are too many.

Noise of σ leaves a row at its predecessor's value with the chance ``p = q/(σ·√(4π))`` (q: one count), so n
equal rows have the chance ``p^n``; `LOG_ODDS` asks for 1.4e-11, which eight channels at 1 kHz meet once in
2,500 h. What the channel's own good frames showed counts as well: a log that repeats or rounds its values has
a larger p. Without noise a value may stand for ever, and only its neighbours can tell (`standing_position`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.compiled import njit
from fdd.sensors.limits import INDEX, STEADY_NOISE, Limits
from fdd.sensors.memory import Memory
from fdd.sensors.noise import place

Array = NDArray[np.float64]

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
POSITION = INDEX["position"]


@njit(nogil=True, inline="always")
def rows_needed(k: int, kind: int, memory: Memory, limits: Limits) -> float:
    """Equal rows from which on the channel is stuck; inf where that cannot be said."""
    chance = limits.repeat[k]
    if chance >= 1.0 and not shows_noise(k, memory, limits):
        return np.inf
    if memory.frames[kind, k] >= LEARNT_FRAMES:
        own = memory.repeat[kind, k]
        chance = max(own, chance) if chance < 1.0 else own
    if chance >= 0.9995:
        return np.inf
    return max(float(FEWEST_ROWS), LOG_ODDS / -np.log(max(chance, 1e-3)))


@njit(nogil=True, inline="always")
def shows_noise(k: int, memory: Memory, limits: Limits) -> bool:
    """Whether a channel without noise in its profile had some in every good frame, at rest too."""
    count = max(limits.resolution[k], LEAST_NOISE * limits.high[k])
    quietest = min(memory.quietest[0, k], memory.quietest[1, k])
    return bool(
        memory.frames[0, k] + memory.frames[1, k] >= LEARNT_FRAMES and quietest >= STEADY_NOISE * count
    )


@njit(nogil=True, inline="always")
def is_held(
    k: int, value: float, length: float, rows: float, live: bool, need: float, memory: Memory, limits: Limits
) -> bool:
    """Whether a run of `rows` equal values over `length` s is too long, for an end of the range or at all."""
    reach = limits.resolution[k]
    outside = value >= limits.rail[k] - reach or not limits.low[k] <= value <= limits.high[k]
    if (outside and length >= RAIL_S) or not live:
        return outside and length >= RAIL_S
    if memory.changed[k] == 0.0:
        frames = EXCITED_FRAMES if limits.repeat[k] < 1.0 else NOISELESS_FRAMES
        return length >= FROM_START_S and memory.excited[k] >= frames
    return rows >= need


@njit(nogil=True)
def standing_position(
    time: Array, position: Array, swept: Array, pressure: Array, begin: int, memory: Memory, limits: Limits
) -> bool:
    """Whether the pump displaced far more than a standing piston lets it, since the position changed.

    Parameters
    ----------
    position : (n,) m. swept : (n,) m³, the pump's angle times its displacement. pressure : (n,) Pa, Δp.
    begin : row from which on they are new. memory : its `volume` goes on, from 0 when the position changes;
        what it was then stands in `stood`.

    Notes
    -----
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
    """Whether position and pump moved together until `since`, and the pump then went on alone.

    Parameters
    ----------
    moved : (n,) m, the pump's volume over the area. count : m, resolution of the position.
    """
    a, b, c = (place(time, since - FROZEN_S), place(time, since), place(time, since + FROZEN_S))
    if time[0] > since - FROZEN_S or c >= time.size or b - a < 2:
        return False
    travel, before, after = position[b] - position[a], moved[b] - moved[a], moved[c] - moved[b]
    together = abs(travel) > max(0.5 * abs(before), 4.0 * count) and travel * before > 0.0
    return bool(together and after * before > 0.0 and abs(after) > 0.5 * abs(before))
