"""Keeps the last minute of each axis, and around an alarm writes it as an annotated MCAP."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa

from fdd.errors import InputError
from fdd.files import require_writable, written
from fdd.samples import Samples
from fdd.service.outputs.doors import Bus, Event, Subscription
from fdd.service.outputs.recording import SPOOLED, begins, finish, keep_within, name_of, wall_offset
from fdd.service.outputs.spool import Piece, Spool

LATE_S = 10.0
"""Kept beyond the time before an alarm: the pipeline looks every 5 s, the alarm takes a moment to come."""
LONGEST_S = 600.0
"""Of a file that alarms extend again and again."""
MOST_WAITING = 2000
"""Blocks that wait for the recorder; then the oldest are lost and counted."""
MOST_RING_BYTES = 16 << 20
"""Of an axis: a minute of all channels at 3 kHz."""
MOST_STATUSES = 1000
PIECE_S = 1.0
"""Blocks are gathered to this much before they are packed."""


class RecordingSettings(Protocol):
    """Of the configuration, `outputs: recording`."""

    @property
    def folder(self) -> Path: ...
    @property
    def before(self) -> float: ...
    @property
    def after(self) -> float: ...
    @property
    def most_bytes(self) -> int: ...


@dataclass
class _Axis:
    """One axis's ring, and its spool while a recording runs."""

    offset: float = 0.0
    """s to add to the stream's stamps for Unix seconds."""
    ring: deque[Piece] = field(default_factory=deque)
    fresh: list[Samples] = field(default_factory=list)
    statuses: deque[dict[str, Any]] = field(default_factory=lambda: deque(maxlen=MOST_STATUSES))
    spool: Spool | None = None
    start: float = 0.0
    until: float = 0.0
    heard: float = 0.0
    """Monotonic s of the last block."""


class Recorder:
    """Records axes around their alarms, in a thread of its own.

    Parameters
    ----------
    settings : folder (made where it is missing), s before and after an alarm, most bytes in the folder.
    bus : of alarms and statuses. profile_of : an axis's unit profile (YAML) for the file, or None.

    Raises
    ------
    InputError : the folder cannot be written.

    Examples
    --------
    >>> recorder = Recorder(settings, bus)  # doctest: +SKIP
    >>> recorder.push("A1", samples)  # doctest: +SKIP
    """

    def __init__(
        self,
        settings: RecordingSettings,
        bus: Bus,
        profile_of: Callable[[str], str | None] = lambda axis: None,
    ) -> None:
        self._settings, self._bus, self._profile_of = settings, bus, profile_of
        self._folder = settings.folder
        require_writable(self._folder, folder=True)
        with written(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        self._axes: dict[str, _Axis] = {}
        self._waiting: deque[tuple[str, Samples]] = deque(maxlen=MOST_WAITING)
        self._pushed = self._taken = self.files = 0
        self._lock = threading.Lock()
        self.last_error = ""

    def push(self, axis: str, samples: Samples) -> None:
        """Hand over an axis's next samples, in the order of time (any thread; costs next to nothing)."""
        with self._lock:
            self._waiting.append((axis, samples))
            self._pushed += 1

    def status(self) -> dict[str, Any]:
        """Files written, recordings that run, blocks lost, the last error."""
        running = sum(a.spool is not None for a in list(self._axes.values()))
        lost = self._pushed - self._taken - len(self._waiting)
        return {"files": self.files, "running": running, "lost_blocks": lost, "last_error": self.last_error}

    def run(self, stop: threading.Event) -> None:
        """Record until `stop`, then finish what runs."""
        alarms, statuses = self._bus.subscribe(["alarm"]), self._bus.subscribe(["status"])
        for left in sorted(self._folder.glob(f"*{SPOOLED}")):
            self._finish(left)
        while not stop.wait(0.2):
            try:
                self.work(alarms, statuses)
            except Exception as error:  # one axis's trouble must not end the recording of all others
                self.last_error = f"{type(error).__name__}: {error}"
        self.work(alarms, statuses)
        for axis in self._axes.values():
            self._end(axis)
        alarms.close()
        statuses.close()

    def work(self, alarms: Subscription, statuses: Subscription) -> None:
        """Take what has come, and end what is due."""
        while event := statuses.get(0.0):
            self._note_status(event)
        self._take()
        while event := alarms.get(0.0):
            self._note_alarm(event)
        now = time.monotonic()
        for axis in self._axes.values():
            silent = now - axis.heard > self._settings.after
            if axis.spool and (silent or (axis.ring and axis.ring[-1].time[-1] >= axis.until)):
                self._end(axis)

    def _take(self) -> None:
        with self._lock:
            taken = list(self._waiting)
            self._waiting.clear()
            self._taken += len(taken)
        for name, samples in taken:
            if not len(samples):
                continue
            axis = self._axes.setdefault(name, _Axis())
            axis.heard = time.monotonic()
            if axis.fresh and samples.time[0] <= axis.fresh[-1].time[-1]:
                self._pack(axis)
            axis.fresh.append(samples)
            if samples.time[-1] - axis.fresh[0].time[0] >= PIECE_S:
                self._pack(axis)

    def _pack(self, axis: _Axis) -> None:
        """Put the fresh blocks into the ring and the spool."""
        if not axis.fresh:
            return
        samples = Samples.concatenate(axis.fresh)
        axis.fresh.clear()
        if axis.ring and samples.time[0] <= axis.ring[-1].time[-1]:
            # The clock was set back: what was before is another stream.
            self._end(axis)
            axis.ring.clear()
            axis.statuses.clear()
        last = float(samples.time[-1])
        axis.offset = wall_offset(last)
        piece = Piece.of(samples)
        axis.ring.append(piece)
        size = sum(p.nbytes for p in axis.ring)
        oldest = last - self._settings.before - LATE_S
        while len(axis.ring) > 1 and (axis.ring[0].time[-1] < oldest or size > MOST_RING_BYTES):
            size -= axis.ring.popleft().nbytes
        while axis.statuses and axis.statuses[0]["time"] < oldest:
            axis.statuses.popleft()
        if axis.spool:
            self._add(axis, piece.samples())

    def _note_status(self, event: Event) -> None:
        axis = self._axes.get(event.axis)
        if axis is None:
            return
        status = {name: event.data.get(name) or {} for name in ("estimates", "probabilities")}
        status["time"] = event.time
        axis.statuses.append(status)
        self._tell(axis, "status", status)

    def _note_alarm(self, event: Event) -> None:
        axis = self._axes.get(event.axis)
        if axis is None or not (axis.spool or begins(event.data)):
            return
        self._pack(axis)
        if begins(event.data):
            if axis.spool is None:
                self._begin(event, axis)
            axis.until = min(event.time + self._settings.after, axis.start + LONGEST_S)
        self._tell(axis, "alarm", {**event.data, "time": event.time})

    def _begin(self, event: Event, axis: _Axis) -> None:
        axis.start = event.time - self._settings.before
        about = {"axis": event.axis, "offset": repr(axis.offset), "unit": self._profile_of(event.axis) or ""}
        path = self._folder / name_of(event.axis, event.time + axis.offset, event.data["alarm"]["id"])
        try:
            self._bound()
            axis.spool = Spool(path.with_suffix(SPOOLED), about)
        except (OSError, pa.ArrowInvalid) as error:
            self.last_error = f"{path}: {getattr(error, 'strerror', None) or error}"
            return
        for piece in axis.ring:
            samples = piece.samples()
            first = int(samples.time.searchsorted(axis.start))
            if first < len(samples):
                self._add(axis, samples.rows(first, len(samples)))
        for status in axis.statuses:
            if status["time"] >= axis.start:
                self._tell(axis, "status", status)

    def _add(self, axis: _Axis, samples: Samples) -> None:
        with self._ending(axis):
            if axis.spool:
                axis.spool.add(samples)

    def _tell(self, axis: _Axis, kind: str, what: dict[str, Any]) -> None:
        with self._ending(axis):
            if axis.spool:
                axis.spool.note(kind, what)

    @contextmanager
    def _ending(self, axis: _Axis) -> Iterator[None]:
        """Where the disk is full, the recording ends with what there is."""
        try:
            yield
        except (OSError, pa.ArrowInvalid) as error:
            self._end(axis)
            self.last_error = f"{self._folder}: {getattr(error, 'strerror', None) or error}"

    def _end(self, axis: _Axis) -> None:
        spool, axis.spool = axis.spool, None
        if spool is not None:
            spool.close()
            self._finish(spool.path)

    def _finish(self, spool: Path) -> None:
        try:
            held = finish(spool)
            self.files += held
            self.last_error = "" if held else f"{spool}: held no sample, removed"
        except InputError as error:
            # The spool stays for the next start, unless the folder's bound takes it.
            self.last_error = str(error)
        self._bound(spool.with_suffix(".mcap"))

    def _bound(self, *newest: Path) -> None:
        running = [a.spool.path for a in self._axes.values() if a.spool]
        keep_within(self._folder, self._settings.most_bytes, sparing={*running, *newest})
