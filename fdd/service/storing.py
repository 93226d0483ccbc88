"""What a step of the fleet stores at once and tells afterwards, and a store that fails meanwhile."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TooLate
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any
from uuid import uuid4

from fdd.errors import InputError
from fdd.service.alarms import Transition
from fdd.service.bus import Event, Kind
from fdd.service.store import LeaseLost, Store, StoreTrouble, Transaction

LOG = logging.getLogger("fdd.service")
BACKOFF_S = (0.1, 5.0)
"""First and longest wait before a store that failed is tried again."""
ACT_S = 10.0
"""Seconds that somebody waits for what he did to be stored."""
Targets = Mapping[tuple[Kind, bool], Sequence[str]]
"""Kind of event, and whether people are told, to the targets of its outbox."""


@dataclass
class Batch:
    """What is stored in one transaction, and told once it is: blocks, further writes, events, answers.

    Attributes
    ----------
    wall : Unix seconds. put_off : axes of the journal whose blocks are worked later.
    """

    targets: Targets
    wall: float
    journal: list[tuple[str, bytes]] = field(default_factory=list)
    put_off: set[str] = field(default_factory=set)
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
    """Write batches to a store that may fail.

    Attributes
    ----------
    trouble : why the store cannot be used; None while it can. errors : how often it could not.
    last_row : by axis, id of the journal's last row whose block is in its state.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self.trouble: str | None = None
        self.errors = 0
        self.last_row: dict[str, int] = {}

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


class Asked:
    """What other threads let the fleet's thread do, answered once it is stored."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[tuple[Callable[[Batch], Any], Future[Any]]] = queue.Queue()

    def answer(self, batch: Batch) -> None:
        """Do all that was asked, in the fleet's thread."""
        while not self._waiting.empty():
            work, future = self._waiting.get()
            if future.set_running_or_notify_cancel():  # else nobody waits for it any more
                try:
                    batch.answers.append((future, work(batch)))
                except (InputError, KeyError) as error:
                    future.set_exception(error)

    def ask(self, work: Callable[[Batch], Any]) -> Any:
        """Let the fleet's thread do something, and wait until it is stored.

        Raises StoreTrouble: it was not stored in time.
        """
        future: Future[Any] = Future()
        self._waiting.put((work, future))
        try:
            return future.result(ACT_S)
        except TooLate:
            future.cancel()
            problem = f"not stored within {ACT_S:g} s: the store is away, or the service is busy"
            raise StoreTrouble(problem, mend="try again") from None
