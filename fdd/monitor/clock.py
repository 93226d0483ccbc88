"""Time as the monitor sees it, injected so that a test need not wait."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """A monotonic clock that can wait."""

    def now(self) -> float:
        """Seconds since some instant."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait, or less where the monitor is told to stop."""
        ...


class WallClock:
    """The machine's monotonic clock; waiting ends at once when `stop` is set."""

    def __init__(self, stop: threading.Event) -> None:
        self._stop = stop

    def now(self) -> float:
        """Seconds since some instant."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait for `seconds`, or until the monitor is told to stop."""
        if seconds > 0.0:
            self._stop.wait(seconds)
