"""The same log as another recorder, cut, rate or mounting would have it: none of which may matter."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.diagnosis.baseline import add_baseline
from fdd.logs import ChannelMap, read_log
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit

TURNED = ("command", "pump_angle", "pump_speed", "position", "pressure_difference", "motor_current",
          "position_setpoint", "load_force")  # fmt: skip
SWAPPED = {"pressure_1": "pressure_2", "pressure_2": "pressure_1"}


def sampled(log: Samples, time: NDArray[np.float64]) -> Samples:
    """A log whose recorder took its samples at other times: speeds are means since the sample before."""
    out = {}
    for channel in log.channels:
        there = np.isfinite(log[channel])
        known, values = log.time[there], log[channel][there]
        if channel == "pump_speed":
            turned = np.concatenate(([0.0], np.cumsum(values[1:] * np.diff(known))))
            steps = np.diff(np.interp(time, known, turned)) / np.diff(time)
            out[channel] = np.concatenate((values[:1], steps))
        else:
            out[channel] = np.interp(time, known, values)
    return Samples(time, out)


def as_read(log: Samples) -> Samples:
    """What `read_log` makes of a log that was kept with its time in ms."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        pd.DataFrame({"t": 1e3 * log.time, **log.columns}).to_parquet(path, index=False)
        sources = {"time": {"column": "t", "unit": "ms"}, **{c: {"column": c} for c in log.channels}}
        read = read_log(path, ChannelMap.model_validate({"channels": sources})).samples
    return Samples(read.time - read.time[0] + log.time[0], read.columns)


def holed(log: Samples) -> Samples:
    """50 ms are missing."""
    start = log.time[0] + 11.0
    keep = (log.time < start) | (log.time >= start + 0.05)
    return Samples(log.time[keep], {c: log[c][keep] for c in log.channels})


def at_rate(log: Samples, rate: float) -> Samples:
    """Recorded at another rate (Hz)."""
    return as_read(sampled(log, np.arange(log.time[0], log.time[-1], 1.0 / rate)))


def changing(log: Samples) -> Samples:
    """The second half was recorded at half the rate."""
    middle, step = 0.5 * (log.time[0] + log.time[-1]), 2.0 * float(np.median(np.diff(log.time)))
    first = log.time[log.time < middle]
    return sampled(log, np.concatenate((first, np.arange(first[-1] + step, log.time[-1], step))))


def slow_pressures(log: Samples) -> Samples:
    """Pressures come at 200 Hz and are held in between."""
    held = (np.arange(len(log)) // 5) * 5
    return as_read(Samples(log.time, {c: log[c][held] if c in PRESSURES else log[c] for c in log.channels}))


DISTURBANCES: dict[str, Callable[[Samples], Samples]] = {
    "50 ms missing": holed,
    "first 5 s left out": lambda log: log.rows(5000, len(log)),
    "200 Hz": lambda log: at_rate(log, 200.0),
    "500 Hz": lambda log: at_rate(log, 500.0),
    "2 kHz": lambda log: at_rate(log, 2000.0),
    "the second half at half the rate": changing,
    "pressures at 200 Hz": slow_pressures,
    "time in ms": as_read,
}


def mirrored(log: Samples) -> Samples:
    """The same actuator looked at from its other end."""
    other = {c: SWAPPED[c] if SWAPPED.get(c) in log.channels else c for c in log.channels}
    return Samples(log.time, {c: -log[c] if c in TURNED else log[other[c]] for c in log.channels})


def mirrored_unit(unit: Unit, healthy: list[Samples]) -> Unit:
    """Its profile."""
    out = unit.model_copy(deep=True)
    f, c = out.friction, out.cylinder
    f.forward, f.reverse = f.reverse, f.forward
    c.area_1, c.area_2, c.volume_1, c.volume_2 = c.area_2, c.area_1, c.volume_2, c.volume_1
    out.sensors = {SWAPPED.get(n, n): s.model_copy(deep=True) for n, s in unit.sensors.items()}
    for name in out.sensors.keys() & set(TURNED):
        out.sensors[name].zero = -out.sensors[name].zero
    return add_baseline(out, [mirrored(log) for log in healthy])
