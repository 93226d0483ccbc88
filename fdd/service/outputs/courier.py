"""Carries what must arrive from the store's outbox to one target: in order, and at least once."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Any

from fdd.service.outputs.doors import Parcel, Store

MOST_PARCELS = 200
"""Rows looked at in one go."""
MOST_ATTEMPTS = 200
"""About a day: the wait doubles up to `LONGEST_WAIT_S` and stays there."""
LONGEST_WAIT_S = 600.0
LONGEST_ASKED_S = 86400.0
"""Of what a target may ask for by Retry-After."""


class Undelivered(Exception):
    """A parcel did not arrive.

    Parameters
    ----------
    problem : one line. wait_s : s that the target asks for, before which it is not tried again.
    final : it never will arrive. down : the target takes nothing now, so that the other parcels wait as well.

    Examples
    --------
    >>> Undelivered("503 Service Unavailable", wait_s=30.0, down=True).wait_s
    30.0
    """

    def __init__(self, problem: str, *, wait_s: float = 0.0, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.wait_s, self.final, self.down = min(wait_s, LONGEST_ASKED_S), final, down


class Courier:
    """One target's deliveries.

    Of one alarm, the parcels arrive in the order in which they were sent; one that is put off holds back the
    later ones of its alarm, and all others only where the target itself is down.

    Parameters
    ----------
    target : name in the outbox. deliver : sends one parcel, or raises `Undelivered`.
    wall : Unix seconds now. chance : draws from 0 to 1, for the jitter.

    Attributes
    ----------
    delivered, failed, given_up : parcels and attempts so far. pending : parcels that wait, at most
        `MOST_PARCELS`. last_error : "" while all is well.

    Examples
    --------
    >>> Courier("jsonl", store, print).once()  # doctest: +SKIP
    """

    def __init__(
        self,
        target: str,
        store: Store,
        deliver: Callable[[Parcel], None],
        wall: Callable[[], float] = time.time,
        chance: Callable[[], float] = random.random,
    ) -> None:
        self.target, self._store, self._deliver = target, store, deliver
        self._wall, self._chance = wall, chance
        self._down_until = 0.0
        self.delivered = self.failed = self.given_up = self.pending = 0
        self.last_error = ""

    def status(self) -> dict[str, Any]:
        """Counts and the last error, as `Outputs.status` gives them."""
        names = ("delivered", "failed", "given_up", "pending", "last_error")
        return {name: getattr(self, name) for name in names}

    def once(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Deliver what is due."""
        now = self._wall()
        # A clock that was set back must not hold the parcels for longer than any wait lasts.
        if now < self._down_until <= now + LONGEST_ASKED_S:
            return
        parcels = self._store.outbox(MOST_PARCELS, self.target)
        self.pending = len(parcels)
        held: set[str] = set()
        for parcel in parcels:
            about = topic_of(parcel)
            if stopped():
                return
            if about in held:
                continue
            if now < parcel.next_wall <= now + LONGEST_ASKED_S:
                held.add(about)
                continue
            error = self._tried(parcel)
            if error is None:
                self._store.delivered(parcel.id)
                self.delivered += 1
                self.pending -= 1
                continue
            if self._put_off(parcel, error):
                held.add(about)
            if error.down:
                return
        if not held:
            self.last_error = ""

    def _tried(self, parcel: Parcel) -> Undelivered | None:
        try:
            self._deliver(parcel)
        except Undelivered as error:
            return error
        except Exception as error:  # one that no target can take must not stop all others for ever
            return Undelivered(f"{type(error).__name__}: {error}")
        return None

    def _put_off(self, parcel: Parcel, error: Undelivered) -> bool:
        """Put off, or give up; which of them."""
        self.failed += 1
        self.last_error = str(error)
        attempts = parcel.attempts + 1
        if error.final or attempts >= MOST_ATTEMPTS:
            note = f"{parcel.kind} {parcel.id} never arrived at {self.target} ({attempts} attempts: {error})"
            self._store.give_up(parcel.id, note)
            self.given_up += 1
            return False
        wait = min(LONGEST_WAIT_S, 2.0 ** min(attempts, 30)) * (0.5 + 0.5 * self._chance())
        until = self._wall() + max(wait, error.wait_s)
        self._store.put_off(parcel.id, until)
        if error.down:
            self._down_until = until
        return True


def topic_of(parcel: Parcel) -> str:
    """What a parcel is about: its alarm; else nothing but itself.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> topic_of(SimpleNamespace(kind="alarm", id=7, body={"alarm": {"id": 3}}))
    'alarm 3'
    """
    return f"alarm {parcel.body['alarm']['id']}" if parcel.kind == "alarm" else f"parcel {parcel.id}"
