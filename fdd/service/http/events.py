"""Server-sent events: what the bus tells, to a bounded number of listeners."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable

import orjson
from starlette.exceptions import HTTPException
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from fdd.bounds import MOST_LISTENERS
from fdd.service.bus import Bus, Event

KEPT = 1000
"""Events that a listener may be behind; one that is farther behind is told to read everything anew."""
HEARTBEAT_S = 10.0
LONGEST_S = 3600.0
"""Then a listener connects anew, and who it is is asked again."""
RESET = b'event: reset\ndata: {"kind": "reset"}\n\n'


class Hub:
    """One subscription to the bus for all listeners, each of which has a queue of its own.

    A listener that falls behind, or that comes back after its connection was lost, is told ``reset``.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._listeners: dict[asyncio.Queue[bytes | None], asyncio.AbstractEventLoop] = {}
        self._number = 0

    def start(self, stop: threading.Event) -> threading.Thread:
        """Listen in a thread of its own until `stop`."""
        subscription = self._bus.subscribe()

        def listen() -> None:
            while not stop.is_set():
                if (event := subscription.get(0.5)) is not None:
                    self.tell(event)
            subscription.close()
            self._offer(None)

        thread = threading.Thread(target=listen, name="http events", daemon=True)
        thread.start()
        return thread

    def tell(self, event: Event) -> None:
        """Pass one event of the bus on (any thread)."""
        self._number += 1
        # JSON holds no line break, so that nothing in a name or note can begin a field of the stream.
        data = orjson.dumps(event, default=str, option=orjson.OPT_SERIALIZE_NUMPY)
        self._offer(f"id: {self._number}\ndata: ".encode() + data + b"\n\n")

    def _offer(self, told: bytes | None) -> None:
        for queue, loop in list(self._listeners.items()):
            if not loop.is_closed():
                loop.call_soon_threadsafe(_put, queue, told)

    def answer(self, again: bool) -> Response:
        """What a listener is sent, from an event loop.

        Parameters
        ----------
        again : it listened before, and may have missed something.

        Raises
        ------
        HTTPException : 503, there are too many listeners.
        """
        if len(self._listeners) >= MOST_LISTENERS:
            raise HTTPException(503, "too many listeners; close a page", {"retry-after": "30"})
        queue = asyncio.Queue[bytes | None](KEPT)
        # Counted from here on: of many that ask at once none has begun to read.
        self._listeners[queue] = asyncio.get_running_loop()
        return _Stream(_events(queue, again), lambda: self._listeners.pop(queue, None))


class _Stream(StreamingResponse):
    """Server-sent events; `ended` is called whether they were begun or not."""

    def __init__(self, events: AsyncIterator[bytes], ended: Callable[[], object]) -> None:
        super().__init__(events, media_type="text/event-stream", headers={"x-accel-buffering": "no"})
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send what comes until the listener goes."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._ended()


async def _events(queue: asyncio.Queue[bytes | None], again: bool) -> AsyncIterator[bytes]:
    loop = asyncio.get_running_loop()
    until = loop.time() + LONGEST_S
    yield b"retry: 2000\n: connected\n\n" + RESET * again
    while loop.time() < until:
        try:
            told = await asyncio.wait_for(queue.get(), HEARTBEAT_S)
        except TimeoutError:
            told = b": still here\n\n"
        if told is None:
            return
        yield told


def _put(queue: asyncio.Queue[bytes | None], told: bytes | None) -> None:
    if queue.full():
        while not queue.empty():
            queue.get_nowait()
        queue.put_nowait(RESET)
    queue.put_nowait(told)
