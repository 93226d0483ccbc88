"""Live diagnosis of one axis: sources of samples, and the loop that turns them into events."""

from fdd.monitor.lines import LineParser
from fdd.monitor.monitor import Event, Found, JsonLines, Noted, Replay, Status, WallClock, pieces, watch

__all__ = [
    "Event", "Found", "JsonLines", "LineParser", "Noted", "Replay", "Status", "WallClock", "pieces", "watch",
]  # fmt: skip
