"""Server-sent events: what the bus tells, to a bounded number of listeners."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator

import orjson
from fastapi import HTTPException
from fastapi.sse import ServerSentEvent

from fdd.bounds import MOST_LISTENERS
from fdd.service.bus import Bus, Subscription

KEPT = 1000
"""Events that a listener may be behind; one that is farther behind is told to read everything anew."""
LOOK_S = 0.2
LONGEST_S = 3600.0
"""Then a listener connects anew, and who it is is asked again."""
RESET = ServerSentEvent(event="reset", data={"kind": "reset"})


class Hub:
    """Tells listeners what happens, until `stop` is set.

    One that falls behind, or that comes back after its connection was lost, is told ``reset``.
    """

    def __init__(self, bus: Bus, stop: threading.Event) -> None:
        self._bus, self._stop, self._listeners = bus, stop, 0

    async def listener(self) -> AsyncIterator[Subscription]:
        """What a listener hears while its request lasts. Raises HTTPException: 503, there are too many."""
        if self._listeners >= MOST_LISTENERS:
            raise HTTPException(503, "too many listeners; close a page", {"retry-after": "30"})
        # Counted from here on: of many that ask at once none has begun to read.
        heard = self._bus.subscribe(most=KEPT)
        self._listeners += 1
        try:
            yield heard
        finally:
            self._listeners -= 1
            heard.close()

    async def told(self, heard: Subscription, again: bool) -> AsyncIterator[ServerSentEvent]:
        """What a listener is sent; `again`: it listened before, and may have missed something."""
        end, lost, number = time.monotonic() + LONGEST_S, 0, 0
        yield ServerSentEvent(comment="connected", retry=2000)
        if again:
            yield RESET
        while time.monotonic() < end and not self._stop.is_set():
            if heard.lost > lost:
                lost = heard.lost
                yield RESET
            elif (event := heard.get()) is not None:
                number += 1
                # JSON holds no line break, so that nothing in a name or note can begin a field of the stream.
                data = orjson.dumps(event, default=str, option=orjson.OPT_SERIALIZE_NUMPY).decode()
                yield ServerSentEvent(raw_data=data, id=str(number))
            else:
                await asyncio.sleep(LOOK_S)
