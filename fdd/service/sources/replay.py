"""Logs replayed as live axes, at any speed."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

from fdd.diagnosis.findings import Quality
from fdd.errors import InputError
from fdd.logs import ChannelMap, read_log
from fdd.logs.stamps import nominal_period
from fdd.monitor.clock import WallClock
from fdd.monitor.sources import Replay
from fdd.samples import Samples
from fdd.service.config_sources import ReplaySource
from fdd.service.sources.source import Source, Window

ON_THEIR_WAY = 4
"""Blocks of one log that may wait for the fleet."""
LARGEST_S = 1.0
"""s of data in a block."""


class Replays(Source):
    """One log for each axis, played in a thread of its own."""

    def __init__(self, config: ReplaySource, channel_map: ChannelMap | None) -> None:
        super().__init__(config)
        self._config, self._map = config, channel_map
        self._running = len(config.logs)

    def check(self) -> None:
        """Refuse a log that cannot be opened."""
        for path in self._config.logs.values():
            try:
                path.open("rb").close()
            except OSError as error:
                raise InputError(
                    f"cannot be read ({error.strerror})", where=path, mend="correct its path"
                ) from None

    def _begin(self, stop: threading.Event) -> None:
        self._set(connected=True)
        for axis, path in self._config.logs.items():
            self._spawn(self._play, axis, path, stop, ended=self._ended)

    def status(self) -> dict[str, Any]:
        """How it stands; `running` tells how many logs are being played."""
        return {**super().status(), "running": self._running}

    def _ended(self) -> None:
        with self._lock:
            self._running -= 1
        self._set(connected=self._running > 0)

    def _play(self, axis: str, path: Path, stop: threading.Event) -> None:
        samples = read_log(path, self._map).samples
        speed = None if self._config.speed == "max" else self._config.speed
        played = Replay(samples, Quality(), speed=speed, clock=WallClock(stop))
        parts = (rows for part in played if len(part) for rows in part.blocks(rows_of(samples)))
        for _ in self._take_all(axis, parts, 0, Window(ON_THEIR_WAY), stop):
            pass


def rows_of(samples: Samples) -> int:
    """Rows of a block of `LARGEST_S`."""
    return max(1, round(LARGEST_S / nominal_period(samples.time))) if len(samples) > 1 else 1
