"""Signals of several rates: each as its file holds it, with rate, range, gaps and shape; and all on one time
base, where a slow one has a value when it is measured, and none between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.logs.formats import LogFile
from fdd.logs.formats.trees import grows, is_time_name, time_unit, unit_in_name
from fdd.logs.quality import sample_numbers
from fdd.measures import measure
from fdd.samples import Column

LEAST_CHANGES = 50
"""So many changes of value tell whether a channel changes at a rhythm of its own."""
RHYTHM_SHARE = 0.98
"""Of the steps between measurements; the rest are lost rows."""
MEETING = 0.8
"""Share of the slowest channel's rows in which the others are measured too, where they keep step."""
ROUNDING = 1e-9
"""Of a channel's range: a bend below it is the rounding of an interpolation."""
_SLOWER = 0.75
"""A series of fewer than this times the rows' rate is a slow one; of more than its inverse, a fast one."""
_BARS = "▁▂▃▄▅▆▇█"


def aligned(at: Column, stamps: Column, values: Column) -> Column:
    """A series, (m,) stamps (s) and values, at the rows of another time base, `at`, (n,) s, increasing.

    Each measurement of a slower series goes to the row nearest to it, moved there along the line to its
    neighbour; the rows between have NaN. A faster series is averaged over the rows' periods.

    Examples
    --------
    >>> aligned(np.arange(5.0), np.array([0.0, 2.0, 4.1]), np.array([0.0, 2.0, 4.1])).tolist()
    [0.0, nan, 2.0, nan, 4.0]
    >>> aligned(np.arange(3.0), np.arange(-0.25, 2.5, 0.5), np.arange(6.0)).tolist()
    [0.5, 2.5, 4.5]
    """
    if stamps.size == at.size and np.array_equal(stamps, at):
        return values
    there = np.isfinite(values) & np.isfinite(stamps)
    stamps, values = stamps[there], values[there]
    if (np.diff(stamps) <= 0.0).any():
        stamps, first = np.unique(stamps, return_index=True)
        values = values[first]
    out = np.full(at.size, np.nan)
    if stamps.size == 0 or at.size < 2:
        return out
    period = float(np.median(np.diff(at)))
    own = float(np.median(np.diff(stamps))) if stamps.size > 1 else np.inf
    middle = np.concatenate(([at[0] - 0.5 * period], 0.5 * (at[1:] + at[:-1]), [at[-1] + 0.5 * period]))
    row = np.searchsorted(middle, stamps, side="right") - 1
    # Over a hole in the rows there is nobody to give a measurement to.
    near = (row >= 0) & (row < at.size)
    near[near] = np.abs(at[row[near]] - stamps[near]) <= 0.75 * period
    if own < _SLOWER * period:
        count = np.bincount(row[near], minlength=at.size)
        total = np.bincount(row[near], weights=values[near], minlength=at.size)
        return np.asarray(np.divide(total, count, out=out, where=count > 0))
    # A measurement that stands alone stays as it is: its neighbours are too far to tell a slope.
    row, gaps = row[near], np.diff(stamps)
    before, after = np.concatenate(([np.inf], gaps)), np.concatenate((gaps, [np.inf]))
    gap = np.where(at[row] < stamps[near], before[near], after[near])
    out[row] = np.where(gap < 1.5 * own, np.interp(at[row], stamps, values), values[near])
    return out


def own_measurements(time: Column, values: Column, period: float) -> tuple[Column, float] | None:
    """A channel that is held, or interpolated, between measurements of its own, with these alone.

    What is held changes only at a rhythm of two rows or more, throughout the log; what is interpolated bends
    only at such a rhythm. Noise changes and bends at any row, and what moves slowly at no fixed rhythm.

    Of (n,) s and values, `period` s a row, it gives (n,) measurements with NaN between, and their period in
    s; None where the values are all its own.
    """
    there = np.isfinite(values)
    if np.count_nonzero(there) < 2 * LEAST_CHANGES:
        return None
    whole = bool(there.all())
    known = values if whole else values[there]
    steps = np.diff(known)
    changed = np.concatenate(([True], steps != 0.0))
    bent = np.concatenate(([True], np.abs(np.diff(steps)) > ROUNDING * float(np.ptp(known)), [True]))
    own = [rows for rows in (changed, bent) if LEAST_CHANGES <= rows.sum() <= 0.6 * rows.size]
    moved = np.abs(steps[steps != 0.0])
    # Most changes as small as the smallest: an encoder at a steady speed has a rhythm, too.
    if not own or np.count_nonzero(moved < 1.5 * moved.min(initial=np.inf)) > 0.5 * moved.size:
        return None
    del known, steps, changed, bent, moved
    numbers = sample_numbers(time if whole else time[there], period)
    for rows in own:
        measured = numbers[rows]
        rhythm = _rhythm(measured)
        if rhythm is not None:
            # What stands still is measured at the same rhythm, and gives the same value again.
            times = np.maximum(np.rint(np.diff(measured) / rhythm), 1.0).astype(np.int64)
            place = np.arange(times.sum()) - np.repeat(np.cumsum(times) - times, times)
            wanted = np.repeat(measured[:-1], times) + np.rint(place * rhythm).astype(np.int64)
            there[there] = np.isin(numbers, np.append(wanted, measured[-1]))
            return np.where(there, values, np.nan), rhythm * period
    return None


def _rhythm(numbers: NDArray[np.int64]) -> float | None:
    """Rows from one to the next where they come at a rhythm of two or more, else None."""
    steps = np.diff(numbers)
    usual = float(np.median(steps))
    if usual < 2.0:
        return None
    # Twice or three times the rhythm where two measurements happen to be equal; a rate that is no whole
    # number of rows alternates between two steps.
    times = np.maximum(np.rint(steps / usual), 1.0)
    regular = np.abs(steps - times * usual) <= (0.0 if usual < 3 else times)
    single = times == 1.0
    if regular.mean() < RHYTHM_SHARE or single.mean() < 0.5:
        return None
    return float(steps[single].mean())


def on_common_rows(
    time: Column, columns: Mapping[str, Column], needed: Sequence[str]
) -> NDArray[np.intp] | None:
    """Rows of the slowest of some channels, where they are seldom measured in the same rows.

    Else those in which any was measured, where these are few; else None. Two slow channels that take turns
    never meet: the others are read `between` their measurements. `needed`: channels that have to meet;
    `columns`: (n,) each, NaN where not measured.
    """
    if time.size < LEAST_CHANGES:
        return None
    there = {c: np.isfinite(columns[c]) for c in needed if c in columns}
    share = {c: np.count_nonzero(rows) / time.size for c, rows in there.items() if rows.any()}
    if min(share.values(), default=1.0) > _SLOWER:
        return None
    masks = [there[c] for c in share]
    slowest = min(share, key=lambda c: share[c])
    if np.logical_and.reduce(masks).mean() <= MEETING * share[slowest]:
        return np.flatnonzero(there[slowest])
    some = np.logical_or.reduce(masks)
    return np.flatnonzero(some) if some.mean() <= _SLOWER else None


def between(time: Column, values: Column, rows: NDArray[np.intp]) -> Column:
    """A channel at some rows, on the line between its measurements; NaN where these are far apart."""
    known = np.flatnonzero(np.isfinite(values))
    if known.size < 2:
        return values[rows]
    out = np.interp(time[rows], time[known], values[known])
    after = np.clip(np.searchsorted(known, rows), 1, known.size - 1)
    gap = time[known[after]] - time[known[after - 1]]
    far = gap > 2.5 * float(np.median(np.diff(time[known])))
    return np.where(np.isfinite(values[rows]), values[rows], np.where(far, np.nan, out))


def own_period(time: Column, values: Column, period: float) -> float | None:
    """The period (s) at which a channel has values, where it is a slow one between rows of `period` s."""
    known = np.isfinite(values)
    if values.size < LEAST_CHANGES or not 2 <= np.count_nonzero(known) <= _SLOWER * values.size:
        return None
    steps = np.diff(sample_numbers(time[known], period))
    usual = float(np.median(steps))
    regular = float((np.abs(steps - usual) <= 1.0).mean())
    return usual * period if usual >= 2.0 and regular >= 0.9 else None


@dataclass(frozen=True)
class SignalView:
    """One signal: its name, rows, how many of these have no value, and least, median and greatest value.

    `unit`: "" where neither file nor name says one. `rate`: Hz, NaN where the file does not tell its time;
    `longest_gap`: s, NaN likewise. `values`: (n,) numbers; empty where it holds none. `problem`: why it
    cannot be read, or "".
    """

    name: str
    unit: str
    rows: int
    missing: int
    rate: float
    longest_gap: float
    low: float
    middle: float
    high: float
    values: Column
    problem: str


def inspect(log: LogFile) -> list[SignalView]:
    """All signals of an opened log, in the order of the file."""
    clocks: dict[str, tuple[float, float]] = {}
    out = []
    try:
        read = log.read(log.signals)  # once: a file of messages is walked as a whole
    except ValueError:
        read = {}  # one by one, to tell which
    for signal in log.signals.values():
        rate, gap, problem = np.nan, np.nan, ""
        try:
            values = read[signal.name] if read else log.read([signal.name])[signal.name]
            if signal.clock not in clocks:
                clocks[signal.clock] = _clock(log, signal.clock)
            rate, gap = clocks[signal.clock]
        except ValueError as error:
            values, problem = np.empty(0), str(error).removeprefix(f"{log.path}: ")
        there = values[np.isfinite(values)]
        spread = np.percentile(there, [0, 50, 100], overwrite_input=True) if there.size else (np.nan,) * 3
        low, middle, high = map(float, spread)
        unit, missing = signal.unit or unit_in_name(signal.name) or "", values.size - there.size
        about = (signal.name, unit, values.size, missing)
        out.append(SignalView(*about, rate, gap, low, middle, high, values, problem))
    return out


def _clock(log: LogFile, clock: str) -> tuple[float, float]:
    """Rate (Hz) and longest gap (s) of the file's stamps, or of a column that is called a time and grows."""
    stamps = log.stamps(clock)
    for signal in log.signals.values() if stamps is None else ():
        if signal.clock == clock and is_time_name(signal.name):
            values = log.read([signal.name])[signal.name]
            if grows(values):
                step = float(np.median(np.diff(values[np.isfinite(values)])))
                stamps = values * measure(time_unit(signal.name, signal.unit, step), "time").factor
                break
    steps = np.diff(stamps[np.isfinite(stamps)]) if stamps is not None else np.empty(0)
    usual = float(np.median(steps)) if steps.size else np.nan
    return 1.0 / usual if usual > 0.0 else np.nan, float(steps.max()) if steps.size else np.nan


def picture(values: Column, columns: int) -> str:
    """A line of bars: the mean of each part between the least and the greatest.

    Examples
    --------
    >>> picture(np.arange(8.0), 8), picture(np.full(4, 3.0), 4)
    ('▁▂▃▄▅▆▇█', '▁▁▁▁')
    """
    if values.size == 0:
        return ""
    parts = [p[np.isfinite(p)] for p in np.array_split(values, min(columns, values.size))]
    means = np.array([p.mean() if p.size else np.nan for p in parts])
    if not np.isfinite(means).any():
        return " " * means.size
    low, spread = np.nanmin(means), np.nanmax(means) - np.nanmin(means)
    level = np.zeros(means.size) if spread == 0.0 else (means - low) / spread
    return "".join(" " if np.isnan(v) else _BARS[min(int(v * 8), 7)] for v in level)
