"""Between fleet and store: what a step stores and then tells, and stored blocks that are worked later."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any
from uuid import uuid4

from fdd.errors import InputError
from fdd.service.alarms import Transition
from fdd.service.axis import AxisWatch, Look
from fdd.service.blocks import Decoder
from fdd.service.queues import Event, Kind, named
from fdd.service.store import LeaseLost, Store, Transaction, profile_key, worked_key

LOG = logging.getLogger("fdd.service")
BACKOFF_S = (0.1, 5.0)
"""First and longest wait before a store that failed is tried again."""
CHECKPOINT_S, CHECKPOINT_AXIS_S = 1.0, 0.4
"""Least time between two checkpoints of an axis, and for each axis that there is: one takes some 20 ms, which
is 5 % of the processor's time. No block is lost for it: the journal holds what came since."""
TURN_S = 1.0
LEAST_SPARE, CALM_SPARE, ENOUGH_SPARE = 0.02, 0.08, 0.2
"""Shares of the fleet's time without work: below the first for two turns some axes are put off, and while any
are also below the second; above the third one catches up. Between them nobody goes to and fro."""
PUT_OFF = 0.2
"""Share of the followed axes that is put off in a turn."""
PORTION = 32
"""Blocks that are worked between two steps of the fleet: some hundredths of a second."""
Targets = Mapping[tuple[Kind, bool], Sequence[str]]
"""Kind of event, and whether people are told, to the targets of its outbox."""


@dataclass
class Batch:
    """What is stored in one transaction, and told once it is: blocks, further writes, events, answers."""

    targets: Targets
    wall: float
    """Unix seconds."""
    journal: list[tuple[str, bytes]] = field(default_factory=list)
    put_off: set[str] = field(default_factory=set)
    """Axes of the journal whose blocks are worked later."""
    writes: list[Callable[[Transaction], object]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    answers: list[tuple[Future[Any], Any]] = field(default_factory=list)

    def moved(self, transitions: Iterable[Transition]) -> None:
        """Store what happened to alarms, and tell it."""
        for t in transitions:
            self.writes.append(partial(Transaction.transition, transition=t))
            self.told("alarm", t.alarm.axis, t.time, asdict(t), t.notify)

    def told(self, kind: Kind, axis: str, when: float, body: dict[str, Any], notify: bool = True) -> None:
        """What must arrive goes through the outbox, and is told at once to whom listens."""
        for target in self.targets.get((kind, notify), ()):
            self.writes.append(partial(Transaction.send, kind=kind, body=body, target=target, wall=self.wall))
        self.events.append(Event(kind, axis, when, body))


class Writer:
    """Write batches, and axes' states with them, to a store that may fail: `trouble` says why, `errors` how
    often. `last_row`: by axis, id of the journal's last row whose block is in its state."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self.trouble: str | None = None
        self.errors = 0
        self.last_row: dict[str, int] = {}
        self._profiles = set[str]()

    def failed(self, error: InputError) -> None:
        """Note a failure; the log has the first one."""
        self.errors += 1
        if self.trouble is None:
            LOG.error("%s", error)
        self.trouble = str(error)

    def write(self, batch: Batch, stop: threading.Event | None) -> bool:
        """Write all at once; while the store fails, again and again. False where `stop` was set meanwhile."""
        journal = batch.journal
        if not journal and not batch.writes:
            return True
        wait, token = BACKOFF_S[0], uuid4().hex
        while True:
            try:
                with self._store.transaction() as t:
                    # A server that is lost while it commits may have done so.
                    fresh = t.once(token)
                    if journal:  # all of an axis's blocks up to the last one of all are in its state
                        last = t.accept_all(journal if fresh else ())
                        self.last_row |= dict.fromkeys({name for name, _ in journal} - batch.put_off, last)
                    for write in batch.writes if fresh else ():
                        write(t)
            except LeaseLost:
                raise
            except InputError as error:
                self.failed(error)
                if stop is not None and stop.wait(wait):
                    return False
                wait = min(2.0 * wait, BACKOFF_S[1])
            else:
                self.trouble = None
                return True

    def due(self, axes: Iterable[AxisWatch], put_off: Container[str], now: float) -> list[AxisWatch]:
        """Axes whose turn it is at a monotonic time (s) to be kept, as many as their share of it allows."""
        axes = list(axes)
        every = max(CHECKPOINT_S, CHECKPOINT_AXIS_S * len(axes))
        due = [w for w in axes if now - w.kept >= every and self.may_keep(w) and not w.waits]
        turns = sorted((w for w in due if w.name not in put_off), key=lambda w: w.kept)
        return turns[: 1 + len(axes) // 50]

    def may_keep(self, watch: AxisWatch) -> bool:
        """Whether an axis has a state that says more than the journal does."""
        return watch.name in self.last_row and not watch.is_new

    def keep(self, watch: AxisWatch, batch: Batch) -> None:
        """Write an axis's state with a batch, its rollups and, once, its profile."""
        wall, parts = batch.wall, watch.rollups
        watch.rollups = []
        held, known_of = watch.checkpoint(wall), watch.about()
        profile = None if watch.profile_sha256 in self._profiles else watch.unit.to_yaml()
        self._profiles.add(watch.profile_sha256)

        def write(t: Transaction) -> None:
            # The row's number is known only now that the blocks are in the journal.
            t.checkpoint(replace(held, sequence=self.last_row[watch.name]))
            t.rollup(*parts)
            if profile is not None:
                t.meta(profile_key(watch.profile_sha256), profile)
            t.axis(watch.name, watch.last_wall or wall, last_time=held.time, **known_of)

        batch.writes.append(write)


class Backlog:
    """The store's journal for a fleet, and which axes are put off: their blocks are stored and worked later.

    Beyond `most_bytes` of blocks that are stored and not worked, axes catch up without spare time, which
    makes all senders wait. `clock`: Unix seconds. `newest`: of axes put off the stamp of the newest block, s
    of the sender's clock. `spare`: share of the last turn.
    """

    def __init__(self, store: Store, writer: Writer, clock: Callable[[], float], most_bytes: int) -> None:
        self._store, self._writer, self._clock, self._most_bytes = store, writer, clock, most_bytes
        self._decoder = Decoder()
        self.newest: dict[str, float] = {}
        self._bytes: dict[str, int] = {}
        self.spare, self._short = 1.0, 0
        # When the last turn began (s), what was spare until then, and what waited.
        self._before: tuple[float, float, float] | None = None

    def is_due(self, now: float) -> bool:
        """Whether a turn is over at a monotonic time, s."""
        return self._before is None or now - self._before[0] >= TURN_S

    def turn(self, now: float, spare_s: float, waiting_s: float, followed: Sequence[str]) -> list[str]:
        """Axes that are to be put off now: the last ones of those followed, never the only one, and none
        while what waits grows less.

        `now`: monotonic s. `spare_s`: s without work so far. `waiting_s`: of data of the axis that lags most.
        """
        began, spare, waited = self._before or (now - TURN_S, spare_s - TURN_S, waiting_s)
        self._before = now, spare_s, waiting_s
        self.spare = (spare_s - spare) / (now - began)
        self._short = self._short + 1 if self.spare < (CALM_SPARE if self.newest else LEAST_SPARE) else 0
        if self._short < 2 or waiting_s < waited or len(followed) < 2:
            return []
        return [*followed[-max(1, round(PUT_OFF * len(followed))) :]]

    def stored(self, axis: str, stamp: float, size: int) -> None:
        """A block of an axis put off was stored: its newest stamp (s; NaN where it has none), bytes."""
        if axis not in self.newest or math.isfinite(stamp):
            self.newest[axis] = stamp
        self._bytes[axis] = self._bytes.get(axis, 0) + size

    def put_off(self, axes: Sequence[str]) -> Callable[[Transaction], object]:
        """From now on only store what comes of these axes; what notes in the store how far each is worked."""
        for axis in axes:
            self.stored(axis, math.nan, 0)

        def write(t: Transaction) -> None:
            # A row's number is known only now that this step's blocks are in the journal.
            for axis in axes:
                t.meta(worked_key(axis), str(self._writer.last_row.get(axis, 0)))

        return write

    def follow_again(self, axis: str) -> None:
        """An axis has caught up, or is forgotten."""
        self.newest.pop(axis, None)
        self._bytes.pop(axis, None)

    def next(self, *, idle: bool) -> str | None:
        """The axis that catches up now, if any: the one put off last, as it is behind least."""
        may = idle or self.spare > ENOUGH_SPARE or self.is_full
        return next(reversed(self.newest), None) if may else None

    @property
    def is_full(self) -> bool:
        """Whether more is stored than may be."""
        return sum(self._bytes.values()) > self._most_bytes

    def _rows(self, axis: str, most: float = math.inf) -> Iterator[tuple[int, bytes]]:
        """Blocks of an axis (row, payload) that are not in its state, at most so many."""
        last = self._writer.last_row.get(axis, 0)
        while most > 0 and (rows := self._store.journal(axis, last, int(min(most, PORTION)))):
            yield from rows
            last, most = rows[-1][0], most - len(rows)

    def replayed(self, watch: AxisWatch) -> Iterator[list[Look]]:
        """Work again what an axis had worked before a restart; what came while it was put off is left."""
        worked = self._store.meta(worked_key(watch.name))
        for number, payload in self._rows(watch.name):
            if worked is not None and number > int(worked):
                self.stored(watch.name, math.nan, self._store.journal_bytes(watch.name))
                return
            self._writer.last_row[watch.name] = number
            yield self.work(watch, payload)
        if worked is not None:
            with self._store.transaction() as t:
                t.forget(worked_key(watch.name))

    def work(self, watch: AxisWatch, payload: bytes) -> list[Look]:
        """Work a block of an axis; b"" is the end of its waiting."""
        wall = self._clock() - self.behind_s(watch)
        if not payload:
            return watch.settle(wall, flush=True)
        return watch.push(self._decoder.decode(payload, axis=watch.name, received=wall))

    def behind_s(self, watch: AxisWatch) -> float:
        """s of data that are stored and not worked yet, of an axis that is put off."""
        clock = watch.order.clock
        behind = self.newest.get(watch.name, math.nan) + clock.offset - clock.last_time
        return max(behind, 0.0) if math.isfinite(behind) else 0.0

    def portion(self, watch: AxisWatch) -> tuple[list[bytes], Callable[[Transaction], object]]:
        """The next blocks of an axis that is put off, and what notes them; without more it is followed again.

        Raises StoreTrouble: they cannot be read now.
        """
        axis, rows = watch.name, list(self._rows(watch.name, PORTION))
        payloads = [payload for _, payload in rows]
        if rows:
            self._writer.last_row[axis] = rows[-1][0]
        if len(rows) < PORTION:
            self.follow_again(axis)
            return payloads, lambda t: t.forget(worked_key(axis))
        self._bytes[axis] = max(0, self._bytes[axis] - sum(map(len, payloads)))
        return payloads, lambda t: t.meta(worked_key(axis), str(rows[-1][0]))

    def problems(self, followed: int, off: Sequence[AxisWatch]) -> list[str]:
        """What is behind, of the axes that are put off, in a line."""
        if not off:
            return []
        behind, names = max(map(self.behind_s, off)), named([watch.name for watch in off])
        told = f"overloaded: {followed} of {followed + len(off)} axes are followed, the others are stored"
        return [f"{told} and worked later, {behind:.0f} s behind: {names}"]
