"""Queues between the threads of the service: blocks wait for the fleet, events for whom they are told.

Blocks wait in the inbox of all axes: bounded, fair, and what is dropped is counted. Under overload a sender
that can wait is made to wait: its block is neither taken nor accepted before there is room. Of one that
cannot (UDP) the oldest blocks of the axis that lags most go. Events go over the bus: publishers never wait,
slow subscribers lose the oldest.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from fdd.bounds import MOST_AXES
from fdd.errors import InputError
from fdd.service.blocks import Block

MOST_TAKEN = 256
"""Blocks that are taken at once: some tenths of a second of work."""
_BLOCK_BYTES = 1000
"""What a block takes besides its numbers."""
_TOLD_S = 20.0
"""For which a loss is told as a problem."""
Kind = Literal["finding", "alarm", "status", "axis", "samples"]
TOLD: tuple[Kind, ...] = ("finding", "alarm", "status", "axis")
"""All that is told to the outside as it is; `samples` are an axis's next ones, with its unit."""
MOST_EVENTS = 1000
"""That wait for a subscriber."""


def named(axes: Sequence[str]) -> str:
    """The first three names, and how many there are more."""
    return ", ".join(axes[:3]) + (f" and {len(axes) - 3} more" if len(axes) > 3 else "")


@dataclass
class _Queue:
    blocks: deque[Block] = field(default_factory=deque)
    seconds: float = 0.0
    dropped: int = 0
    dropped_at: float = -1e9


class Inbox:
    """Blocks that sources put in from any thread and the fleet takes out.

    Parameters
    ----------
    most_seconds : s of data that may wait of one axis. Beyond it the axis's oldest block is dropped, unless
        its sender keeps it until it is accepted (`Block.patient`); the newest block always stays.
    most_bytes : of all that waits. Beyond it `put` waits with a patient block, and else drops the oldest one
        of the axis that lags most.
    """

    def __init__(self, most_seconds: float = 10.0, most_bytes: int = 256 << 20) -> None:
        self._most_seconds, self._most_bytes = most_seconds, most_bytes
        self._queues: dict[str, _Queue] = {}
        self._waiting: deque[str] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._closed = False

    def put(self, block: Block) -> None:
        """Add a block. Only one whose sender keeps it may wait for room, until the inbox is closed.

        Raises InputError: it is of one axis more than may wait.
        """
        axis, size = block.axis, block.nbytes + _BLOCK_BYTES
        with self._changed:

            def is_full() -> bool:
                waits = axis in self._queues and bool(self._queues[axis].blocks)
                return not waits and len(self._waiting) >= MOST_AXES

            while block.patient and self._waiting and (self._bytes + size > self._most_bytes or is_full()):
                if self._closed:
                    return  # not accepted: its sender sends it again
                self._changed.wait(0.5)
            if is_full():
                mend = "start another fdd serve for it"
                raise InputError(f"axis {axis}: more than {MOST_AXES} axes", mend=mend)
            queue = self._queues.setdefault(axis, _Queue())
            if not queue.blocks:
                self._waiting.append(axis)
            queue.blocks.append(block)
            queue.seconds += block.seconds
            self._bytes += size
            late = self._most_seconds
            while queue.seconds > late and len(queue.blocks) > 1 and not queue.blocks[0].patient:
                self._drop(axis)
            while self._bytes > self._most_bytes:
                lossy = [q for a in self._waiting if not (q := self._queues[a]).blocks[0].patient]
                if not lossy:
                    break
                self._drop(max(lossy, key=lambda q: q.seconds).blocks[0].axis)
            self._changed.notify_all()

    def close(self) -> None:
        """Let no sender wait any longer."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def forget(self, axis: str) -> None:
        """Drop what an axis has here, that it is counted no more."""
        with self._changed:
            if axis in self._waiting:
                while self._queues[axis].blocks:
                    self._out(axis)
                self._waiting.remove(axis)
            self._queues.pop(axis, None)
            self._changed.notify_all()

    def problems(self) -> list[str]:
        """What is lost or late for want of time, a line each."""
        with self._changed:
            now = time.monotonic()
            lost = sorted(a for a, q in self._queues.items() if now - q.dropped_at < _TOLD_S)
            late = sorted(a for a, q in self._queues.items() if q.seconds > self._most_seconds)
        dropped = "overloaded: the oldest samples are dropped of"
        behind = f"overloaded: senders wait, more than {self._most_seconds:g} s behind are"
        return [f"{text} {named(axes)}" for text, axes in ((dropped, lost), (behind, late)) if axes]

    def take(self, timeout: float) -> list[Block]:
        """Blocks in the order they came, in turn of each axis that has any; [] where none came in time, s."""
        taken = list[Block]()
        with self._changed:
            self._changed.wait_for(lambda: self._waiting, timeout)
            while self._waiting and len(taken) < MOST_TAKEN:
                axis = self._waiting.popleft()
                taken.append(self._out(axis))
                if self._queues[axis].blocks:
                    self._waiting.append(axis)
                elif not self._queues[axis].dropped:
                    del self._queues[axis]
            self._changed.notify_all()
        return taken

    @property
    def waiting_s(self) -> float:
        """s of data that wait of the axis that lags most."""
        with self._changed:
            return max((queue.seconds for queue in self._queues.values()), default=0.0)

    def counters(self, axis: str) -> dict[str, float]:
        """Of an axis: samples dropped, s of data that wait."""
        with self._changed:
            queue = self._queues.get(axis, _Queue())
            return {"dropped_samples": queue.dropped, "lag_s": queue.seconds}

    def _out(self, axis: str) -> Block:
        queue = self._queues[axis]
        block = queue.blocks.popleft()
        # Exactly 0 where nothing waits: differences of sums would drift over years.
        queue.seconds = queue.seconds - block.seconds if queue.blocks else 0.0
        self._bytes -= block.nbytes + _BLOCK_BYTES
        return block

    def _drop(self, axis: str) -> None:
        block = self._out(axis)
        queue = self._queues[axis]
        if not queue.blocks:
            self._waiting.remove(axis)
        queue.dropped += len(block.samples)
        queue.dropped_at = time.monotonic()


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
        self._bus, self._kinds, self._events = bus, kinds, deque[Event](maxlen=most)
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
