"""Keeps the last minute of each axis, and around an alarm writes it as an annotated MCAP."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fdd.errors import InputError
from fdd.files import require_writable, written
from fdd.samples import Samples
from fdd.service.bus import Bus, Event
from fdd.service.config import Recording
from fdd.service.outputs.recording import begins, keep_within, name_of, wall_offset, write

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
