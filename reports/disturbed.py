"""Whether answers depend on what must not matter: a hole in a log, its rate, which end is forward.

That a log may be pushed in blocks, and that one early row matters nothing, `pytest tests/diagnosis` checks.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fdd.campaign.dataset import Dataset
from fdd.campaign.spreads import identified_unit
from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.model import Model
from fdd.logs import ChannelMap, read_log
from fdd.samples import PRESSURES, Samples
from fdd.unit import Unit
from reports.datasets import diagnosed, printed

Disturbance = Callable[[Samples, np.random.Generator], Samples | None]
"""A disturbed log; None where it cannot be disturbed so."""

HOLE_S, HEAD_S = 0.05, 5.0
NEAR_S = 1.0
"""s within which two onsets are the same: two frames."""
TURNED = ("command", "pump_angle", "pump_speed", "position", "pressure_difference", "motor_current",
          "position_setpoint", "load_force")  # fmt: skip
EXCHANGED = {"pressure_1": "pressure_2", "pressure_2": "pressure_1"}


def _kept(log: Samples, keep: NDArray[np.bool_]) -> Samples:
    return Samples(log.time[keep], {c: log[c][keep] for c in log.channels})


def holed(log: Samples, rng: np.random.Generator) -> Samples:
    """A log without 50 ms somewhere."""
    start = rng.uniform(log.time[0], log.time[-1] - HOLE_S)
    return _kept(log, (log.time < start) | (log.time >= start + HOLE_S))


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


def at_rate(rate: float) -> Disturbance:
    """A log that was recorded at another rate (Hz), of no more than twice its own."""

    def resampled(log: Samples, rng: np.random.Generator) -> Samples | None:
        own = 1.0 / float(np.median(np.diff(log.time)))
        same = abs(rate - own) < 1.0 or rate > 2.1 * own
        return None if same else as_read(sampled(log, np.arange(log.time[0], log.time[-1], 1.0 / rate)))

    return resampled


def changing(log: Samples, rng: np.random.Generator) -> Samples:
    """A log whose second half was recorded at half the rate."""
    middle, step = 0.5 * (log.time[0] + log.time[-1]), 2.0 * float(np.median(np.diff(log.time)))
    first = log.time[log.time < middle]
    return sampled(log, np.concatenate((first, np.arange(first[-1] + step, log.time[-1], step))))


def slow_pressures(log: Samples, rng: np.random.Generator) -> Samples | None:
    """A log whose pressures come at 200 Hz, held in between, as the reader takes it."""
    every = round(0.005 / float(np.median(np.diff(log.time))))
    if every < 2:
        return None
    held = (np.arange(len(log)) // every) * every
    return as_read(Samples(log.time, {c: log[c][held] if c in PRESSURES else log[c] for c in log.channels}))


def as_read(log: Samples) -> Samples:
    """What `read_log` makes of a log that was kept with its time in ms."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        pd.DataFrame({"t": 1e3 * log.time, **log.columns}).to_parquet(path, index=False)
        sources = {"time": {"column": "t", "unit": "ms"}, **{c: {"column": c} for c in log.channels}}
        read = read_log(path, ChannelMap.model_validate({"channels": sources})).samples
    return Samples(read.time - read.time[0] + log.time[0], read.columns)


def mirrored(log: Samples, rng: np.random.Generator | None = None) -> Samples:
    """The same actuator looked at from its other end."""
    other = {c: EXCHANGED[c] if EXCHANGED.get(c) in log.channels else c for c in log.channels}
    return Samples(log.time, {c: -log[c] if c in TURNED else log[other[c]] for c in log.channels})


def mirrored_unit(unit: Unit, healthy: list[Samples]) -> Unit:
    """Its profile."""
    out = unit.model_copy(deep=True)
    f, c = out.friction, out.cylinder
    f.forward, f.reverse = f.reverse, f.forward
    c.area_1, c.area_2, c.volume_1, c.volume_2 = c.area_2, c.area_1, c.volume_2, c.volume_1
    out.sensors = {EXCHANGED.get(n, n): s.model_copy(deep=True) for n, s in unit.sensors.items()}
    for name in out.sensors.keys() & set(TURNED):
        out.sensors[name].zero = -out.sensors[name].zero
    return add_baseline(out, [mirrored(log) for log in healthy])


DISTURBANCES: dict[str, Disturbance] = {
    "50 ms missing": holed,
    "first 5 s left out": lambda log, rng: _kept(log, log.time >= log.time[0] + HEAD_S),
    "200 Hz": at_rate(200.0),
    "500 Hz": at_rate(500.0),
    "2 kHz": at_rate(2000.0),
    "the second half at half the rate": changing,
    "pressures at 200 Hz, held in between": slow_pressures,
    "the other end forward": mirrored,
}


class Comparison(NamedTuple):
    """Whether one log's verdicts, leading faults (or one of their groups) and onsets are the same."""

    unit: str
    disturbance: str
    verdict: bool
    fault: bool
    onset: bool


def disturbed(data: Dataset, unit: str, model: Model) -> list[Comparison]:
    """Diagnose the unit's first faulty and first healthy log under every disturbance."""
    profile, logs, out = identified_unit(data, unit), data.logs_of(unit), []
    turned = mirrored_unit(profile, data.baseline(unit))
    for entry in filter(None, (next((e for e in logs if e.healthy is h), None) for h in (False, True))):
        log = data.samples(entry)
        plain = diagnosed(profile, log, model)
        for name, change in DISTURBANCES.items():
            other = change(log, np.random.default_rng(zlib.crc32(f"{entry.file} {name}".encode())))
            if other is not None:
                found = diagnosed(turned if change is mirrored else profile, other, model)
                out.append(Comparison(unit, name, *_same(plain, found)))
    return out


def _same(one: Diagnosis, other: Diagnosis) -> tuple[bool, bool, bool]:
    verdict = one.verdict == other.verdict
    if not (one.faults and other.faults):
        both = not one.faults and not other.faults
        return verdict, both, both
    a, b = one.faults[0], other.faults[0]
    fault = a.fault in b.ambiguity or b.fault in a.ambiguity
    return verdict, fault, abs(a.onset_s - b.onset_s) <= NEAR_S


def disturbed_table(compared: list[Comparison]) -> str:
    """The section of a report (Markdown)."""
    return printed("disturbed", found=pd.DataFrame(compared), names=DISTURBANCES)
