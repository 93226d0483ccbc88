"""Connections and rates that are bounded, so that slow and greedy clients keep nobody out."""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict
from typing import ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

from fdd.bounds import MOST_IDLE_HTTP_CONNECTIONS

REQUEST_S = 10.0
"""For a request's line and headers; also how long a client may leave what is sent to it unread."""
MOST_ADDRESSES = 4096


class BoundedProtocol(H11Protocol):
    """uvicorn's HTTP with what it lacks: bounds for clients that send or read slowly.

    A connection that owes a request's head (its first or its next) has ten seconds for it; a body's time the
    guard counts. When too many owe either, the oldest of the address that has most of them is closed: neither
    a person's request, which comes within milliseconds, nor another machine is hit.
    """

    _deadline: asyncio.TimerHandle | None = None
    _unread: asyncio.TimerHandle | None = None

    _queue: ClassVar[OrderedDict[H11Protocol, str]] = OrderedDict()
    """Those that owe, with their addresses; of all servers of the process, of which there is one."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self._settle()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._end_deadline()
        self._queue.pop(self, None)
        self.resume_writing()
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """A request that is whole is no longer owed."""
        super().handle_events()
        self._settle()

    def on_response_complete(self) -> None:
        """The next one is."""
        super().on_response_complete()
        self._settle()

    def pause_writing(self) -> None:
        """The client does not read: it has ten seconds to go on."""
        super().pause_writing()
        if self._unread is None:
            self._unread = self.loop.call_later(REQUEST_S, self.transport.abort)

    def resume_writing(self) -> None:
        """It went on."""
        super().resume_writing()
        if self._unread is not None:
            self._unread.cancel()
            self._unread = None

    def _settle(self) -> None:
        headed = self.cycle is not None and not self.cycle.response_complete
        if headed or self.transport.is_closing():
            self._end_deadline()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)
        if self.transport.is_closing() or (headed and not self.cycle.more_body):
            self._queue.pop(self, None)
        elif self not in self._queue:
            self._queue[self] = self.client[0] if self.client else ""
            if len(self._queue) > MOST_IDLE_HTTP_CONNECTIONS:
                ((greedy, _),) = Counter(self._queue.values()).most_common(1)
                oldest = next(each for each, address in self._queue.items() if address == greedy)
                del self._queue[oldest]
                oldest.transport.abort()

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class Rates:
    """How often each client may do something: a bucket of `burst` that fills with `rate` a second.

    Examples
    --------
    >>> rates = Rates(rate=1.0, burst=2)
    >>> [rates.take("a", now) for now in (0.0, 0.0, 0.0, 1.0)], rates.take("b", 0.0)
    ([True, True, False, True], True)
    """

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def left(self, client: str, now: float) -> float:
        """What is in a client's bucket."""
        left, then = self._left.get(client, (self._burst, now))
        return min(self._burst, left + (now - then) * self._rate)

    def take(self, client: str, now: float) -> bool:
        """Take one out, where there is one."""
        left = self.left(client, now)
        taken = left >= 1.0
        self._left[client] = (left - taken, now)
        self._left.move_to_end(client)
        while len(self._left) > MOST_ADDRESSES:
            self._left.popitem(last=False)
        return taken
