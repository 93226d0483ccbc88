"""What a log holds: each signal's rate, range, gaps and shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.logs.formats.signals import LogFile
from fdd.logs.names import grows, is_time_name, time_unit, unit_in_name
from fdd.measures import measure
from fdd.samples import Column

_BARS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True)
class SignalView:
    """One signal.

    Attributes
    ----------
    name, unit : as the file has them; unit "" where neither it nor the name says one.
    rows : of the signal. missing : of these, without a value.
    rate : Hz, NaN where the file does not tell its time.
    longest_gap : s, NaN likewise.
    low, middle, high : least, median and greatest value.
    values : (n,) numbers; empty where it holds none.
    problem : why it cannot be read, or "".
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
