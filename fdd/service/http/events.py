"""Server-sent events: what the bus tells, numbered, to a bounded number of listeners."""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections import deque
from collections.abc import AsyncIterator
from typing import Any

import orjson
from starlette.exceptions import HTTPException

from fdd.bounds import MOST_LISTENERS
from fdd.service.http.doors import Bus

KEPT = 2000
"""Events that a listener may be behind, or catch up with after a lost connection."""
HEARTBEAT_S = 10.0
LONGEST_S = 3600.0
"""Then a listener connects anew, and who it is is asked again."""


class Hub:
    """One listener on the bus for all of the service's.

    There are no queues: each listener has a place in one row of the last events. One that falls out of it,
    or that comes back after a restart, is told ``reset`` and reads everything anew.

    Examples
    --------
    >>> Hub(bus).start(stop)  # doctest: +SKIP
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._run = secrets.token_hex(4)
        self._row: deque[bytes] = deque(maxlen=KEPT)
        self._next = 0
        self._listeners: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}
        self._lock = threading.Lock()
        self._stopped = False

    def start(self, stop: threading.Event) -> threading.Thread:
        """Listen in a thread of its own until `stop`."""
        subscription = self._bus.subscribe()

        def listen() -> None:
            while not stop.is_set():
                event = subscription.get(0.5)
                if event is not None:
                    self.tell(event)
            subscription.close()
            self._stopped = True
            self._wake()

        thread = threading.Thread(target=listen, name="http events", daemon=True)
        thread.start()
        return thread

    def tell(self, event: Any) -> None:
        """Pass one event of the bus on (any thread)."""
        body = {"kind": event.kind, "axis": event.axis, "time": event.time, "data": event.data}
        # JSON holds no line break, so that nothing in a name or note can begin a field of the stream.
        data = orjson.dumps(body, default=str, option=orjson.OPT_SERIALIZE_NUMPY)
        with self._lock:
            self._row.append(f"id: {self._run}-{self._next}\ndata: ".encode() + data + b"\n\n")
            self._next += 1
        self._wake()

    def _wake(self) -> None:
        for news, loop in list(self._listeners.items()):
            if not loop.is_closed():
                loop.call_soon_threadsafe(news.set)

    def stream(self, last: str | None) -> AsyncIterator[bytes]:
        """What a listener is sent, from the event after `last` on.

        Raises
        ------
        HTTPException : 503, there are too many listeners.
        """
        if len(self._listeners) >= MOST_LISTENERS:
            raise HTTPException(503, "too many listeners; close a page", {"retry-after": "30"})
        return self._events(self._place(last))

    def _place(self, last: str | None) -> int | None:
        """Number of the next event for a listener; None where it must begin anew."""
        if last is None:
            return self._next
        run, _, number = last.partition("-")
        known = run == self._run and number.isascii() and number.isdigit() and len(number) < 16
        return int(number) + 1 if known and int(number) < self._next else None

    async def _events(self, place: int | None) -> AsyncIterator[bytes]:
        loop, news = asyncio.get_running_loop(), asyncio.Event()
        until = loop.time() + LONGEST_S
        self._listeners[news] = loop
        try:
            yield b"retry: 2000\n: connected\n\n"
            while not self._stopped and loop.time() < until:
                news.clear()
                with self._lock:
                    first, end = self._next - len(self._row), self._next
                    lost = place is None or place < first
                    told = [] if lost else [self._row[k - first] for k in range(place or 0, end)]
                if lost:
                    yield f'id: {self._run}-{end - 1}\nevent: reset\ndata: {{"kind": "reset"}}\n\n'.encode()
                elif told:
                    yield b"".join(told)
                place = end
                if not lost and not told:
                    try:
                        await asyncio.wait_for(news.wait(), HEARTBEAT_S)
                    except TimeoutError:
                        yield b": still here\n\n"
        finally:
            self._listeners.pop(news, None)
