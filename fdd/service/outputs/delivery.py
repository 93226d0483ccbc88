"""The delivery worker: carries what must arrive from the store's outbox to one target."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Any

from fdd.service.store import OutboxMessage, Store

MOST_TAKEN = 200
"""Messages looked at in one go."""
MOST_ATTEMPTS = 20
"""Of a message that the target refuses for now, some two hours; while the target is down none is counted."""
LONGEST_WAIT_S = 600.0
LONGEST_ASKED_S = 86400.0
"""Of what a target may ask for by Retry-After."""


class Undelivered(Exception):
    """A message did not arrive.

    Parameters
    ----------
    problem : one line. wait_s : s that the target asks for, before which nothing is tried again.
    final : it never will arrive. down : the target takes nothing now.
    """

    def __init__(self, problem: str, *, wait_s: float = 0.0, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.wait_s, self.final, self.down = min(wait_s, LONGEST_ASKED_S), final, down


class DeliveryWorker:
    """One target's messages, in their order and each at least once: one that fails holds back the next.

    Parameters
    ----------
    target : name in the outbox. deliver : sends one message, or raises `Undelivered`.

    Attributes
    ----------
    delivered, failed, given_up : messages and attempts so far. pending : messages that wait, at most
        `MOST_TAKEN`. last_error : "" while all is well.
    """

    def __init__(self, target: str, store: Store, deliver: Callable[[OutboxMessage], None]) -> None:
        self.target, self._store, self._deliver = target, store, deliver
        self._failures, self._rests_until = 0, 0.0
        self.delivered = self.failed = self.given_up = self.pending = 0
        self.last_error = ""

    def status(self) -> dict[str, Any]:
        """Counts and the last error."""
        names = ("delivered", "failed", "given_up", "pending", "last_error")
        return {name: getattr(self, name) for name in names}

    def once(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Deliver what waits, up to the first message that fails."""
        if time.monotonic() < self._rests_until:
            return
        messages = self._store.outbox(MOST_TAKEN, self.target)
        self.pending = len(messages)
        for message in messages:
            if stopped():
                return
            error = self._tried(message)
            if error is not None and not self._is_given_up(message, error):
                return
            self.pending -= 1
        self.last_error = ""

    def _tried(self, message: OutboxMessage) -> Undelivered | None:
        try:
            self._deliver(message)
        except Undelivered as error:
            return error
        except Exception as error:  # one that no target can take must not stop all others for ever
            return Undelivered(f"{type(error).__name__}: {error}")
        self._store.delivered(message.id)
        self.delivered += 1
        self._failures = 0
        return None

    def _is_given_up(self, message: OutboxMessage, error: Undelivered) -> bool:
        """Give up, or rest before the next attempt; which of them."""
        self.failed += 1
        self.last_error = str(error)
        attempts = message.attempts + 1
        if error.final or (attempts >= MOST_ATTEMPTS and not error.down):
            self._store.give_up(
                message.id,
                f"{message.kind} {message.id} never arrived at {self.target} ({attempts} attempts: {error})",
            )
            self.given_up += 1
            return True
        if not error.down:
            self._store.put_off(message.id)
        self._failures += 1
        wait = min(LONGEST_WAIT_S, 2.0 ** min(self._failures, 30)) * random.uniform(0.5, 1.0)
        self._rests_until = time.monotonic() + max(wait, error.wait_s)
        return False
