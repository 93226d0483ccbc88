"""What a step of the fleet stores at once and tells afterwards, and a store that fails meanwhile."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any
from uuid import uuid4

from fdd.errors import InputError
from fdd.service.alarms import Transition
from fdd.service.axis import AxisWatch
from fdd.service.bus import Event, Kind
from fdd.service.life import profile_key
from fdd.service.store import LeaseLost, Store, Transaction

LOG = logging.getLogger("fdd.service")
BACKOFF_S = (0.1, 5.0)
"""First and longest wait before a store that failed is tried again."""
CHECKPOINT_S, CHECKPOINT_AXIS_S = 1.0, 0.4
"""Least time between two checkpoints of an axis, and for each axis that there is: one takes some 20 ms, which
is 5 % of the processor's time. No block is lost for it: the journal holds what came since."""
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
            send = partial(Transaction.send, kind=kind, body=body, target=target, wall=self.wall)
            self.writes.append(send)
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
