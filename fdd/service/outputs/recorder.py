"""Keeps the last minute of each axis, and around an alarm writes it as an annotated MCAP."""

from __future__ import annotations

import json
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
from fdd.service.bus import Bus, Event
from fdd.service.config import Recording
from fdd.service.recent import FRESH_S

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


@dataclass
class _Running:
    """A recording that runs, from `start` to `until`, s of the stream's clock; with `offset` Unix seconds."""

    path: Path
    start: float
    offset: float
    until: float = 0.0
    alarms: list[dict[str, Any]] = field(default_factory=list)


@dataclass
class _Axis:
    """One axis's latest samples and statuses; while a recording runs, all since its start.

    Attributes
    ----------
    offset : s to add to the stream's stamps for Unix seconds. heard : monotonic s of the last block.
    """

    offset: float = 0.0
    heard: float = 0.0
    size: int = 0
    ring: deque[Samples] = field(default_factory=deque)
    statuses: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_STATUSES))
    running: _Running | None = None


class Recorder:
    """Records axes around their alarms, in a thread of its own.

    Parameters
    ----------
    config : folder (made where it is missing), s before and after an alarm, most bytes in the folder.
    bus : of samples, alarms and statuses. profile_of : an axis's unit profile (YAML) for the file, or None.

    Raises
    ------
    InputError : the folder cannot be written.
    """

    def __init__(self, config: Recording, bus: Bus, profile_of: Callable[[str], str | None]) -> None:
        self._config, self._profile_of = config, profile_of
        require_writable(config.folder, folder=True)
        with written(config.folder):
            config.folder.mkdir(parents=True, exist_ok=True)
        self._axes: dict[str, _Axis] = {}
        self._events = bus.subscribe(["samples", "status", "alarm"], MOST_WAITING)
        self.files, self.last_error = 0, ""

    def status(self) -> dict[str, Any]:
        """Files written, recordings that run, blocks lost, the last error."""
        running = sum(a.running is not None for a in list(self._axes.values()))
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
            elif (axis := self._axes.get(event.axis)) is not None:
                self._note(axis, event)
        now = time.monotonic()
        for name, axis in self._axes.items():
            run = axis.running
            silent = now - axis.heard > self._config.after
            if run and (silent or axis.ring[-1].time[-1] >= run.until or axis.size > MOST_BYTES):
                self._end(name, axis)

    def _take(self, name: str, samples: Samples) -> None:
        axis = self._axes.setdefault(name, _Axis())
        axis.heard = time.monotonic()
        if axis.ring and samples.time[0] <= axis.ring[-1].time[-1]:
            # The clock was set back: what was before is another stream.
            self._end(name, axis)
            axis.ring.clear()
            axis.statuses.clear()
            axis.size = 0
        axis.offset = wall_offset(float(samples.time[-1]))
        axis.ring.append(samples)
        axis.size += _bytes(samples)
        self._trim(axis)

    def _trim(self, axis: _Axis) -> None:
        oldest = float(axis.ring[-1].time[-1]) - self._config.before - LATE_S
        if axis.running:
            oldest = min(oldest, axis.running.start)
        full = not axis.running and axis.size > MOST_BYTES
        while len(axis.ring) > 1 and (axis.ring[0].time[-1] < oldest or full):
            axis.size -= _bytes(axis.ring.popleft())
            full = not axis.running and axis.size > MOST_BYTES
        while axis.statuses and axis.statuses[0]["time"] < oldest:
            axis.statuses.popleft()

    def _note(self, axis: _Axis, event: Event) -> None:
        if event.kind == "status":
            status = {name: event.data.get(name) or {} for name in ("estimates", "probabilities")}
            axis.statuses.append(status | {"time": event.time})
            return
        if begins(event.data):
            if axis.running is None:
                name = name_of(event.axis, event.time + axis.offset, event.data["alarm"]["id"])
                start = event.time - self._config.before
                axis.running = _Running(self._config.folder / name, start, axis.offset)
            axis.running.until = min(event.time + self._config.after, axis.running.start + LONGEST_S)
        if axis.running:
            axis.running.alarms.append({**event.data, "time": event.time})

    def _end(self, name: str, axis: _Axis) -> None:
        """Write the recording that runs."""
        run, axis.running = axis.running, None
        if run is None:
            return
        samples = Samples.concatenate(list(axis.ring))
        samples = samples.rows(int(samples.time.searchsorted(run.start)), len(samples))
        if not len(samples):
            return
        try:
            statuses = list(axis.statuses)
            write(run.path, name, samples, statuses, run.alarms, run.offset, self._profile_of(name))
            keep_within(self._config.folder, self._config.most_bytes, newest=run.path)
        except (InputError, OSError) as error:
            self.last_error = str(error)
        else:
            self.files += 1
            self.last_error = ""


def _bytes(samples: Samples) -> int:
    return 8 * len(samples) * (1 + len(samples.channels))


def name_of(axis: str, wall: float, alarm: object) -> str:
    """A recording's name.

    Examples
    --------
    >>> name_of("hall/A1", 0.0, 7)
    'hall_A1_19700101T000000Z_7.mcap'
    """
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


def begins(transition: Mapping[str, Any]) -> bool:
    """Whether an alarm's transition is one that is recorded: it is raised, or raised again."""
    return transition["action"] in ("RAISED", "RERAISED")


def wall_offset(last: float) -> float:
    """s to add to a stream's stamps, of which `last` has just come, for Unix seconds."""
    lag = time.time() - last
    # Stamps that are Unix seconds already need no offset, however late they come.
    return 0.0 if abs(lag) < FRESH_S else lag


def write(
    path: Path,
    axis: str,
    samples: Samples,
    statuses: list[dict[str, Any]],
    alarms: list[dict[str, Any]],
    offset: float,
    unit_yaml: str | None,
) -> None:
    """Write a recording; its time begins at 0 with its first sample, its log times are Unix time.

    Parameters
    ----------
    statuses, alarms : what happened beside the samples, each with its ``time``.
    offset : s to add to the stream's stamps for Unix seconds.

    Raises
    ------
    InputError : it cannot be written.
    """
    start = float(samples.time[0])
    wall = max(0.0, start + offset)
    faults = _faults(alarms, start, wall)
    answer = {"schema": "fdd.recording/1", "axis": axis, "faults": faults, "alarms": alarms}
    write_annotated(
        path, Samples(samples.time - start, samples.columns), trajectories(statuses, start),
        json.dumps(answer), axis=plain(axis), unit_yaml=unit_yaml, start_ns=round(wall * 1e9),
    )  # fmt: skip


def _faults(alarms: list[dict[str, Any]], start: float, wall: float) -> list[dict[str, Any]]:
    """The alarms' findings, as a diagnosis lists them, in the file's time."""
    found = []
    for alarm in alarms:
        finding = alarm["alarm"]["body"]
        if begins(alarm):
            # MCAP has no times before 1970.
            times = {name: max(finding[name] - start, -wall) for name in ("onset_s", "detected_s")}
            if finding.get("onset_interval"):
                times["onset_interval"] = [t - start for t in finding["onset_interval"]]
            found.append({**finding, **times})
    return found


def trajectories(statuses: list[dict[str, Any]], start: float) -> dict[str, Any]:
    """Estimates and probabilities over the statuses' times, as `write_annotated` takes them."""
    rows = sorted((s for s in statuses if s["time"] >= start), key=lambda s: s["time"])
    times = np.array([row["time"] - start for row in rows])

    def column(group: str, name: str, key: str | None) -> NDArray[np.float64]:
        cells = [row.get(group, {}).get(name) for row in rows]
        values = [cell.get(key) if key and cell is not None else cell for cell in cells]
        return np.array([np.nan if v is None else v for v in values], dtype=np.float64)

    quantities, families = (
        list(dict.fromkeys(name for row in rows for name in row.get(group, {})))
        for group in ("estimates", "probabilities")
    )
    return {
        "time": times,
        "estimates": {"ekf": {name: column("estimates", name, "value") for name in quantities}},
        "stds": {"ekf": {name: column("estimates", name, "std") for name in quantities}},
        "window_time": times,
        "probabilities": {name: column("probabilities", name, None) for name in families},
    }


def keep_within(folder: Path, most_bytes: int, newest: Path) -> None:
    """Remove the oldest recordings, but never the newest, until the folder holds at most so many bytes."""
    files = []
    for path in folder.iterdir():
        with suppress(OSError):
            if OURS.fullmatch(path.name):
                about = path.stat()
                files.append((about.st_mtime_ns, about.st_size, path))
    size = sum(bytes_ for _, bytes_, _ in files)
    for _, bytes_, path in sorted(files):
        if size <= most_bytes:
            return
        if path != newest:
            with suppress(OSError):
                path.unlink()
                size -= bytes_
