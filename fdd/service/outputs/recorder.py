"""Keeps the last minute of each axis, and around an alarm writes it as an annotated MCAP."""

from __future__ import annotations

import json
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.files import require_writable, written
from fdd.logs.mcap_writing import write_annotated
from fdd.samples import Samples
from fdd.service.config import Recording
from fdd.service.queues import Bus, Event
from fdd.service.status import FRESH_S
from fdd.unit import Unit

OURS = re.compile(r".+_\d{8}T\d{6}Z_\w+\.mcap")
"""Only files with such a name are ever removed."""
LATE_S = 10.0
"""Kept beyond the time before an alarm: the pipeline looks every 5 s, the alarm takes a moment to come."""
LONGEST_S = 600.0
"""Of a file that alarms extend again and again."""
MOST_WAITING = 4000
"""Events that wait for the recorder; then the oldest are lost and counted."""
MOST_BYTES = 32 << 20
"""Of an axis's samples in memory: six minutes of ten channels at 1 kHz. A recording ends there."""
MOST_STATUSES = 1000
BEGINS = ("RAISED", "RERAISED")
"""Transitions of an alarm that are recorded."""


@dataclass
class _Axis:
    """One axis's latest samples and statuses; while a recording runs (at `path`), all since its `start`.

    `offset` makes Unix seconds of the stream's stamps, `wall` is that of the recording; `heard`: monotonic s
    of the last block; `size`: bytes of the samples; `start`, `until`: s of the stream's clock.
    """

    unit: Unit = field(init=False)
    offset: float = 0.0
    heard: float = 0.0
    size: int = 0
    ring: deque[Samples] = field(default_factory=deque)
    statuses: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_STATUSES))
    path: Path | None = None
    start: float = math.inf
    until: float = math.inf
    wall: float = 0.0
    alarms: list[dict[str, Any]] = field(default_factory=list)


class Recorder:
    """Records axes around their alarms, in a thread of its own, into a folder that it makes.

    Raises InputError: the folder cannot be written.
    """

    def __init__(self, config: Recording, bus: Bus) -> None:
        self._config = config
        require_writable(config.folder, folder=True)
        with written(config.folder):
            config.folder.mkdir(parents=True, exist_ok=True)
        self._axes: dict[str, _Axis] = {}
        self._events = bus.subscribe(["samples", "status", "alarm"], MOST_WAITING)
        self.files, self.last_error = 0, ""

    def status(self) -> dict[str, Any]:
        """Files written, recordings that run, blocks lost, the last error."""
        running = sum(a.path is not None for a in list(self._axes.values()))
        lost = self._events.lost
        return {"files": self.files, "running": running, "lost_blocks": lost, "last_error": self.last_error}

    def run(self, stop: threading.Event) -> None:
        """Record until `stop`, then write what runs."""
        while not stop.wait(0.2):
            try:
                self.work()
            except Exception as error:  # one axis's trouble must not end the recording of all others
                self.last_error = f"{type(error).__name__}: {error}"
        self.work()
        for name, axis in self._axes.items():
            self._end(name, axis)
        self._events.close()

    def work(self) -> None:
        """Take what has come, and end what is due."""
        while event := self._events.get():
            if event.kind == "samples":
                self._take(event.axis, event.data["samples"])
                self._axes[event.axis].unit = event.data["unit"]
            elif (axis := self._axes.get(event.axis)) is None:
                continue
            elif event.kind == "alarm":
                self._alarmed(axis, event)
            else:
                axis.statuses.append({**event.data, "time": event.time})
        now = time.monotonic()
        for name, axis in self._axes.items():
            silent = now - axis.heard > self._config.after
            if silent or axis.ring[-1].time[-1] >= axis.until or axis.size > MOST_BYTES:
                self._end(name, axis)

    def _take(self, name: str, samples: Samples) -> None:
        axis = self._axes.setdefault(name, _Axis())
        if axis.ring and samples.time[0] <= axis.ring[-1].time[-1]:
            # The clock was set back: what was before is another stream.
            self._end(name, axis)
            axis = self._axes[name] = _Axis()
        axis.heard = time.monotonic()
        last = float(samples.time[-1])
        lag = time.time() - last
        # Stamps that are Unix seconds already need no offset, however late they come.
        axis.offset = 0.0 if abs(lag) < FRESH_S else lag
        axis.ring.append(samples)
        axis.size += _bytes(samples)
        oldest = min(last - self._config.before - LATE_S, axis.start)
        most_bytes = MOST_BYTES if axis.path is None else math.inf
        while len(axis.ring) > 1 and (axis.ring[0].time[-1] < oldest or axis.size > most_bytes):
            axis.size -= _bytes(axis.ring.popleft())
        while axis.statuses and axis.statuses[0]["time"] < oldest:
            axis.statuses.popleft()

    def _alarmed(self, axis: _Axis, event: Event) -> None:
        if event.data["action"] in BEGINS:
            if axis.path is None:
                name = name_of(event.axis, event.time + axis.offset, event.data["alarm"]["id"])
                axis.path, axis.wall = self._config.folder / name, axis.offset
                axis.start = event.time - self._config.before
            axis.until = min(event.time + self._config.after, axis.start + LONGEST_S)
        if axis.path is not None:
            axis.alarms.append({**event.data, "time": event.time})

    def _end(self, name: str, axis: _Axis) -> None:
        """Write the recording that runs; its time begins at 0 with its first sample."""
        path, alarms, first = axis.path, axis.alarms, axis.start
        axis.path, axis.alarms, axis.start, axis.until = None, [], math.inf, math.inf
        if path is None:
            return
        samples = Samples.concatenate(list(axis.ring))
        samples = samples.rows(int(samples.time.searchsorted(first)), len(samples))
        if not len(samples):
            return
        start = float(samples.time[0])
        wall = max(0.0, start + axis.wall)
        faults = _faults(alarms, start, wall)
        answer = {"schema": "fdd.recording/1", "axis": name, "faults": faults, "alarms": alarms}
        statuses = [s for s in axis.statuses if s["time"] >= start]
        try:
            write_annotated(
                path, Samples(samples.time - start, samples.columns), _trajectories(statuses, start),
                json.dumps(answer), axis=plain(name), unit_yaml=axis.unit.to_yaml(),
                start_ns=round(wall * 1e9),
            )  # fmt: skip
            keep_within(self._config.folder, self._config.most_bytes, newest=path)
        except (InputError, OSError) as error:
            self.last_error = str(error)
        else:
            self.files, self.last_error = self.files + 1, ""


def _bytes(samples: Samples) -> int:
    return 8 * len(samples) * (1 + len(samples.channels))


def name_of(axis: str, wall: float, alarm: object) -> str:
    """A recording's name, as in ``hall_A1_19700101T000000Z_7.mcap``."""
    stamp = datetime.fromtimestamp(max(wall, 0.0), UTC).strftime("%Y%m%dT%H%M%SZ")
    return f"{plain(axis)}_{stamp}_{re.sub('[^A-Za-z0-9]', '', str(alarm))[:40]}.mcap"


def plain(axis: str) -> str:
    """An axis's name as it can stand in a topic and a file's name.

    Examples
    --------
    >>> plain("../A 1")
    '_._A_1'
    """
    return re.sub(r"[^A-Za-z0-9_.\-]|^\.", "_", axis)[:64]


def _faults(alarms: list[dict[str, Any]], start: float, wall: float) -> list[dict[str, Any]]:
    """The alarms' findings, as a diagnosis lists them, in the file's time."""
    found = []
    for finding in (alarm["alarm"]["body"] for alarm in alarms if alarm["action"] in BEGINS):
        # MCAP has no times before 1970.
        times = {name: max(finding[name] - start, -wall) for name in ("onset_s", "detected_s")}
        if finding.get("onset_interval"):
            times["onset_interval"] = [t - start for t in finding["onset_interval"]]
        found.append({**finding, **times})
    return found


def _trajectories(statuses: list[dict[str, Any]], start: float) -> dict[str, Any]:
    """Estimates and probabilities over the statuses' times, as `write_annotated` takes them."""
    rows = sorted(statuses, key=lambda s: s["time"])
    times = np.array([row["time"] - start for row in rows])

    def columns(group: str, cell: Callable[[Any], float | None]) -> dict[str, NDArray[np.float64]]:
        found: list[Mapping[str, Any]] = [row.get(group) or {} for row in rows]
        names = dict.fromkeys(name for row in found for name in row)
        return {n: np.array([cell(r[n]) if n in r else None for r in found], np.float64) for n in names}

    return {
        "time": times, "window_time": times,
        "estimates": {"ekf": columns("estimates", lambda e: e["value"])},
        "stds": {"ekf": columns("estimates", lambda e: e["std"])},
        "probabilities": columns("probabilities", lambda p: p),
    }  # fmt: skip


def keep_within(folder: Path, most_bytes: int, newest: Path) -> None:
    """Remove the oldest recordings, but never the newest, until the folder holds at most so many bytes."""
    files = []
    for path in folder.iterdir():
        with suppress(OSError):
            if OURS.fullmatch(path.name):
                files.append((path.stat().st_mtime_ns, path.stat().st_size, path))
    over = sum(size for _, size, _ in files) - most_bytes
    for _, size, path in sorted(files):
        if over > 0 and path != newest:
            with suppress(OSError):
                path.unlink()
                over -= size
