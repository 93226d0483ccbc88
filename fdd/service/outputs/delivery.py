"""What must arrive, from the store's outbox to one receiver, in a thread of its own."""

from __future__ import annotations

import random
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fdd.service.bus import Bus, Kind
from fdd.service.store import OutboxMessage, Store

MOST_TAKEN = 200
"""Messages looked at in one go."""
MOST_ATTEMPTS = 20
"""Of a message that the target refuses for now, some two hours; while the target is down none is counted."""
LONGEST_WAIT_S = 600.0
LONGEST_ASKED_S = 86400.0
"""Of what a target may ask for by Retry-After."""
LOOK_S = 0.5
"""Between two looks into the outbox."""
TROUBLE_S = 5.0
"""Rest after a failure that no one foresaw, such as a store that is locked."""
KINDS: tuple[Kind, ...] = ("alarm", "finding")
"""What goes through the outbox."""


class Undelivered(Exception):
    """A message did not arrive, and (`final`) never will, or the target takes nothing now (`down`) or for
    `wait_s` seconds."""

    def __init__(self, problem: str, *, wait_s: float = 0.0, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.wait_s, self.final, self.down = min(wait_s, LONGEST_ASKED_S), final, down


class Target(ABC):
    """One receiver of messages, in their order and each at least once: one that fails holds back the next.

    `kinds` of messages are sent to it; one that `is_live` takes statuses (`note`), and hears what a
    chattering alarm does. `counts`: messages delivered, attempts failed, messages given up, those that wait
    (at most `MOST_TAKEN`) and live events lost, so far. `last_error`: "" while all is well.
    """

    kinds: Sequence[Kind] = KINDS
    is_live = False

    def __init__(self, name: str, store: Store) -> None:
        self.name, self._store = name, store
        self._failures, self._rests_until = 0, 0.0
        self.counts = dict.fromkeys(("delivered", "failed", "given_up", "pending", "lost"), 0)
        self.last_error = ""

    @abstractmethod
    def deliver(self, message: OutboxMessage) -> None:
        """Send one message. Raises Undelivered: it did not arrive."""

    def note(self, axis: str, state: Mapping[str, Any]) -> None:  # noqa: B027 (most take none)
        """Take an axis's live status."""

    def tick(self) -> None:  # noqa: B027 (most need none)
        """Called now and then."""

    def status(self) -> dict[str, Any]:
        """Counts and the last error."""
        return {**self.counts, "last_error": self.last_error}

    def once(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Deliver what waits, up to the first message that fails."""
        if time.monotonic() < self._rests_until:
            return
        messages = self._store.outbox(MOST_TAKEN, self.name)
        self.counts["pending"] = len(messages)
        for message in messages:
            if stopped():
                return
            try:
                self.deliver(message)
            except Exception as error:  # one that no target can take must not stop all others for ever
                if not self._is_given_up(message, error):
                    return
            else:
                self._store.settle(message.id, done=True)
                self.counts["delivered"] += 1
                self._failures = 0
            self.counts["pending"] -= 1
        self.last_error = ""

    def _is_given_up(self, message: OutboxMessage, error: Exception) -> bool:
        """Give up, or rest before the next attempt; which of them."""
        if not isinstance(error, Undelivered):
            error = Undelivered(f"{type(error).__name__}: {error}")
        self.counts["failed"] += 1
        self.last_error = str(error)
        attempts = message.attempts + 1
        if error.final or (attempts >= MOST_ATTEMPTS and not error.down):
            never = f"{message.kind} {message.id} never arrived at {self.name}"
            self._store.settle(message.id, done=True, why=f"{never} ({attempts} attempts: {error})")
            self.counts["given_up"] += 1
            return True
        if not error.down:
            self._store.settle(message.id, done=False)
        self._failures += 1
        wait = min(LONGEST_WAIT_S, 2.0 ** min(self._failures, 30)) * random.uniform(0.5, 1.0)
        self._rests_until = time.monotonic() + max(wait, error.wait_s)
        return False

    def run(self, bus: Bus, stop: threading.Event) -> None:
        """Deliver what comes, and note live states, until `stop` is set."""
        live: list[Kind] = ["status"] if self.is_live else []
        events = bus.subscribe([*self.kinds, *live])
        looked = -LOOK_S
        while not stop.is_set():
            try:
                event = events.get(LOOK_S)
                if event is not None and event.kind == "status":
                    self.note(event.axis, event.data)
                self.counts["lost"] = events.lost
                told = event is not None and event.kind in self.kinds
                if told or time.monotonic() - looked >= LOOK_S:
                    self.tick()
                    self.once(stop.is_set)
                    looked = time.monotonic()
            except Exception as error:  # the thread must outlive a store in trouble
                self.last_error = f"{type(error).__name__}: {error}"
                stop.wait(TROUBLE_S)
        events.close()
