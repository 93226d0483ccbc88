"""Logs replayed as live axes, at any speed."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

from fdd.diagnosis.findings import Quality
from fdd.logs import ChannelMap, read_log
from fdd.logs.stamps import nominal_period
from fdd.monitor.clock import WallClock
from fdd.monitor.sources import Replay
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.config_sources import ReplaySource
from fdd.service.sources.intake import Intake, Put, Window

ON_THEIR_WAY = 4
"""Blocks of one log that may wait for the fleet."""
LARGEST_S = 1.0
"""s of data in a block."""


class Replays:
    """One log for each axis, played in a thread of its own; see `fdd.monitor.Replay`.

    Parameters
    ----------
    config : logs by axis, speed. intake : takes the blocks. channel_map : of all logs.

    Examples
    --------
    >>> config = ReplaySource(type="replay", logs={"A1": "a.mcap"}, speed="max")
    >>> source = Replays(config, Intake("logs"), None)
    >>> source.start(inbox.put, stop)  # doctest: +SKIP
    """

    def __init__(self, config: ReplaySource, intake: Intake, channel_map: ChannelMap | None) -> None:
        self._config, self._intake, self._map = config, intake, channel_map
        self._running = len(config.logs)
        self._lock = threading.Lock()

    def start(self, put: Put, stop: threading.Event) -> None:
        """Read and play each log in a thread of its own; one that cannot be read becomes the last error."""
        self._intake.put = put
        self._intake.set(connected=True)
        for axis, path in self._config.logs.items():
            self._intake.spawn(self._play, axis, path, stop, ended=self._ended)

    def status(self) -> dict[str, Any]:
        """How it stands; `running` tells how many logs are being played."""
        return {**self._intake.status(), "running": self._running}

    def _ended(self) -> None:
        with self._lock:
            self._running -= 1
        self._intake.set(connected=self._running > 0)

    def _play(self, axis: str, path: Path, stop: threading.Event) -> None:
        samples = read_log(path, self._map).samples
        speed = None if self._config.speed == "max" else self._config.speed
        window, number = Window(ON_THEIR_WAY), 0
        for part in Replay(samples, Quality(), speed=speed, clock=WallClock(stop)):
            for rows in part.blocks(rows_of(samples)) if len(part) else ():
                if not window.wait(stop):
                    return
                self._intake.take(
                    Block(
                        axis,
                        rows,
                        number,
                        self._intake.name,
                        time.time(),
                        patient=True,
                        accepted=window.accepted,
                    )
                )
                number += 1
            if stop.is_set():
                return


def rows_of(samples: Samples) -> int:
    """Rows of a block of `LARGEST_S`.

    Examples
    --------
    >>> rows_of(Samples([0.0, 0.01, 0.02], {}))
    100
    """
    return max(1, round(LARGEST_S / nominal_period(samples.time))) if len(samples) > 1 else 1
