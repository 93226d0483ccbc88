"""What happens, told within the process: publishers never wait, slow subscribers lose the oldest."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["finding", "alarm", "status", "axis", "samples"]
TOLD: tuple[Kind, ...] = ("finding", "alarm", "status", "axis")
"""All that is told to the outside as it is; `samples` are an axis's next ones, with its unit."""
MOST_EVENTS = 1000
"""That wait for a subscriber."""


@dataclass(frozen=True)
class Event:
    """Something happened at `time` (s of the stream's clock); data is JSON-able but for that of `samples`,
    and nobody changes it."""

    kind: Kind
    axis: str
    time: float
    data: dict[str, Any]


class Subscription:
    """One subscriber's queue; `Bus.subscribe` makes it. `lost` events were dropped, not taken in time."""

    def __init__(self, bus: Bus, kinds: Collection[Kind], most: int) -> None:
        self._bus, self._kinds = bus, kinds
        self._events: deque[Event] = deque(maxlen=most)
        self._news, self.lost = threading.Condition(), 0

    def get(self, timeout: float = 0.0) -> Event | None:
        """The oldest event, or None when none came within `timeout` s."""
        with self._news:
            self._news.wait_for(lambda: self._events, timeout)
            return self._events.popleft() if self._events else None

    def close(self) -> None:
        """Hear no more."""
        self._bus._subscriptions.discard(self)


class Bus:
    """Publish and subscribe, from any thread."""

    def __init__(self) -> None:
        self._subscriptions: set[Subscription] = set()

    def subscribe(self, kinds: Collection[Kind] = TOLD, most: int = MOST_EVENTS) -> Subscription:
        """A queue of what is published from now on of some kinds."""
        subscription = Subscription(self, kinds, most)
        self._subscriptions.add(subscription)
        return subscription

    def publish(self, event: Event) -> None:
        """Tell all subscribers; never waits for one."""
        for one in self._subscriptions.copy():
            if event.kind in one._kinds:
                with one._news:
                    one.lost += len(one._events) == one._events.maxlen
                    one._events.append(event)
                    one._news.notify()
