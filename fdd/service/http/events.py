"""Server-sent events: what the bus tells, to a bounded number of listeners."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator

import orjson
from starlette.exceptions import HTTPException
from starlette.responses import Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from fdd.bounds import MOST_LISTENERS
from fdd.service.bus import Bus, Subscription

KEPT = 1000
"""Events that a listener may be behind; one that is farther behind is told to read everything anew."""
LOOK_S, HEARTBEAT_S = 0.2, 10.0
LONGEST_S = 3600.0
"""Then a listener connects anew, and who it is is asked again."""
RESET = b'event: reset\ndata: {"kind": "reset"}\n\n'


class Hub:
    """Answers listeners, until `stop` is set.

    One that falls behind, or that comes back after its connection was lost, is told ``reset``.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus, self.stop = bus, threading.Event()
        self._listeners: set[Subscription] = set()

    def answer(self, again: bool) -> Response:
        """What a listener is sent, from an event loop.

        Parameters
        ----------
        again : it listened before, and may have missed something.

        Raises HTTPException: 503, there are too many listeners.
        """
        if len(self._listeners) >= MOST_LISTENERS:
            raise HTTPException(503, "too many listeners; close a page", {"retry-after": "30"})
        # Counted from here on: of many that ask at once none has begun to read.
        heard = self._bus.subscribe(most=KEPT)
        self._listeners.add(heard)
        listeners = self._listeners

        class Stream(StreamingResponse):
            async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
                try:
                    await super().__call__(scope, receive, send)
                finally:  # whether the events were begun or not
                    listeners.discard(heard)
                    heard.close()

        headers = {"x-accel-buffering": "no"}
        return Stream(self._told(heard, again), media_type="text/event-stream", headers=headers)

    async def _told(self, heard: Subscription, again: bool) -> AsyncIterator[bytes]:
        begun = spoke = time.monotonic()
        lost = number = 0
        yield b"retry: 2000\n: connected\n\n" + RESET * again
        while spoke < begun + LONGEST_S and not self.stop.is_set():
            if heard.lost > lost:
                lost = heard.lost
                yield RESET
            elif (event := heard.get()) is not None:
                number += 1
                # JSON holds no line break, so that nothing in a name or note can begin a field of the stream.
                data = orjson.dumps(event, default=str, option=orjson.OPT_SERIALIZE_NUMPY)
                yield f"id: {number}\ndata: ".encode() + data + b"\n\n"
            elif time.monotonic() - spoke > HEARTBEAT_S:
                yield b": still here\n\n"
            else:
                await asyncio.sleep(LOOK_S)
                continue
            spoke = time.monotonic()
