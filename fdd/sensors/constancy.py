"""Channels that stop changing: how many equal rows are too many.

Noise of σ leaves a row at its predecessor's value with the chance ``p = q/(σ·√(4π))`` (q: one count), so n
equal rows have the chance ``p^n``; `LOG_ODDS` asks for 1.4e-11, which eight channels at 1 kHz meet once in
2,500 h. What the channel's own good hops showed counts as well: a log that repeats or rounds its values has a
larger p. Without noise a value may stand for ever, and only its neighbours can tell (`standing_position`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.limits import INDEX, STEADY_NOISE, Limits
from fdd.sensors.memory import Memory

Array = NDArray[np.float64]

LOG_ODDS = 25.0
FEWEST_ROWS = 8
LEARNT_HOPS = 4
"""Hops of a class after which what they showed is believed."""
FROM_START_S = 1.0
"""A channel that never changed has shown no noise at all: the profile may be wrong, so it gets this time, in
which the pump has to turn."""
RAIL_S = 0.2
EXCITED_HOPS, NOISELESS_HOPS = 2, 8
"""Hops with a turning pump, for a channel that should have noise, and for one that need not."""
LEAST_NOISE = 1e-5
"""Share of the range: no analogue sensor has less noise."""
LIVE = (
    "pressure_1",
    "pressure_2",
    "pressure_difference",
    "pressure_accumulator",
    "motor_current",
    "load_force",
)
"""Analogue channels, which noise keeps moving. Counts of an encoder and a slow thermocouple may stand."""
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


@dataclass(frozen=True)
class Run:
    """Rows of one value: since when (s), until when (None: it lasts), how many rows."""

    value: float
    since: float
    until: float | None
    rows: int


def runs_of(time: Array, values: Array, k: int, memory: Memory) -> tuple[list[Run], int]:
    """Runs of equal values in a hop, the first joined with what came before; and the longest.

    Only runs of `FEWEST_ROWS` and more are listed. `memory` then holds the last one.
    """
    edges = np.flatnonzero(values[1:] != values[:-1]) + 1
    starts = np.concatenate(([0], edges))
    lengths = np.diff(np.concatenate((starts, [values.size])))
    joined = values[0] == memory.run_value[k]
    carried, since = (int(memory.run_rows[k]), float(memory.run_since[k])) if joined else (0, float(time[0]))
    lengths[0] += carried
    found = []
    for i in np.flatnonzero(lengths >= FEWEST_ROWS):
        begun = since if i == 0 else float(time[starts[i]])
        until = float(time[starts[i + 1]]) if i + 1 < starts.size else None
        found.append(Run(float(values[starts[i]]), begun, until, int(lengths[i])))
    if edges.size or (not joined and np.isfinite(memory.run_value[k])):
        memory.changed[k] = 1.0
    if edges.size:
        memory.last_value[k] = values[edges[-1] - 1]
    elif not joined:
        memory.last_value[k] = memory.run_value[k]
    memory.run_value[k] = values[-1]
    memory.run_since[k] = since if starts.size == 1 else time[starts[-1]]
    memory.run_rows[k] = lengths[-1]
    return found, int(lengths.max())


def rows_needed(k: int, kind: int, memory: Memory, limits: Limits) -> float:
    """Equal rows from which on the channel is stuck; inf where that cannot be said."""
    chance = limits.repeat[k]
    if chance >= 1.0 and not shows_noise(k, memory, limits):
        return np.inf
    if memory.hops[kind, k] >= LEARNT_HOPS:
        own = memory.repeat[kind, k]
        chance = max(own, chance) if chance < 1.0 else own
    if chance >= 0.9995:
        return np.inf
    return float(max(FEWEST_ROWS, LOG_ODDS / -np.log(max(chance, 1e-3))))


def shows_noise(k: int, memory: Memory, limits: Limits) -> bool:
    """Whether a channel without noise in its profile had some in every good hop, at rest too."""
    count = max(float(limits.resolution[k]), LEAST_NOISE * float(limits.high[k]))
    return bool(
        memory.hops[:, k].sum() >= LEARNT_HOPS and memory.quietest[:, k].min() >= STEADY_NOISE * count
    )


def learn_repeats(k: int, kind: int, repeated: float, longest: int, rows: int, memory: Memory) -> None:
    """Take a good hop's share of repeated rows, and its longest run, as what the channel may do."""
    # The longest run that N rows have by chance is about ln N / ln(1/p).
    by_run = float(rows) ** (-1.0 / max(longest, 1)) if rows > 1 else 0.0
    memory.repeat[kind, k] = max(memory.repeat[kind, k], repeated, by_run)


def is_stuck(run: Run, k: int, kind: int, now: float, memory: Memory, limits: Limits) -> bool:
    """Whether a run of a live channel is too long."""
    length = (now if run.until is None else run.until) - run.since
    if not memory.changed[k]:
        hops = EXCITED_HOPS if limits.repeat[k] < 1.0 else NOISELESS_HOPS
        return bool(length >= FROM_START_S and memory.excited[k] >= hops)
    return run.rows >= rows_needed(k, kind, memory, limits)


def standing_position(
    time: Array, swept: Array, pressure: Array, in_motion: bool, memory: Memory, limits: Limits
) -> bool:
    """Whether the pump displaced far more than a standing piston lets it, since the position changed.

    Parameters
    ----------
    swept : (n,) m³, the pump's angle times its displacement. pressure : (n,) Pa, Δp.
    in_motion : what `stopped_in_motion` says.
    memory : its `volume` goes on, from 0 when the position changes.

    Notes
    -----
    Allowed are three times the healthy leakage, what the oil takes at `Limits.softness` and, unless the
    position stopped in mid-motion (`stopped_in_motion`), a valve that is stuck open. Rows near the relief
    setting do not count.
    """
    k = INDEX["position"]
    if swept.size < 2:
        return False
    after = time[1:] > memory.run_since[k]
    if memory.run_since[k] >= time[0]:
        memory.volume[:] = 0.0
    memory.volume[4] = max(memory.volume[4], float(in_motion))
    level = np.abs(np.nan_to_num(pressure[1:], nan=limits.relief))
    counts = after & (level < RELIEF_SHARE * limits.relief)
    total = memory.volume[0] + np.cumsum(np.where(counts, np.diff(swept), 0.0))
    orifice = BYPASS_SHARE * limits.displacement * limits.pump_speed * np.sqrt(level / BYPASS_PRESSURE)
    flow = LEAK_MARGIN * limits.leakage * level + (0.0 if memory.volume[4] else orifice)
    leaked = float((flow * np.diff(time))[counts].sum())
    memory.volume[0] = total[-1]
    memory.volume[1] = min(memory.volume[1], float(total.min()))
    memory.volume[2] = max(memory.volume[2], float(total.max()))
    memory.volume[3] += leaked
    low, high = float(np.nanmin(pressure, initial=0.0)), float(np.nanmax(pressure, initial=0.0))
    elastic = limits.softness * limits.area * (high - low)
    least = limits.area * max(LEAST_TRAVEL * limits.stroke, 20.0 * limits.resolution[k])
    return bool(memory.volume[2] - memory.volume[1] > memory.volume[3] + elastic + least)


def stopped_in_motion(time: Array, position: Array, moved: Array, since: float, count: float) -> bool:
    """Whether position and pump moved together until `since`, and the pump then went on alone.

    Parameters
    ----------
    moved : (n,) m, the pump's volume over the area. count : m, resolution of the position.
    """
    a, b, c = np.searchsorted(time, [since - FROZEN_S, since, since + FROZEN_S]).tolist()
    if time[0] > since - FROZEN_S or c >= time.size or b - a < 2:
        return False
    travel, before, after = position[b] - position[a], moved[b] - moved[a], moved[c] - moved[b]
    together = abs(travel) > max(0.5 * abs(before), 4.0 * count) and travel * before > 0.0
    return bool(together and after * before > 0.0 and abs(after) > 0.5 * abs(before))
