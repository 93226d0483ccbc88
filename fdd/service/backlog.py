"""Who is followed under overload: the other axes' blocks are stored at once and worked when there is time."""

from __future__ import annotations

import math
from collections.abc import Sequence

TURN_S = 1.0
LEAST_SPARE, CALM_SPARE, ENOUGH_SPARE = 0.02, 0.08, 0.2
"""Shares of the fleet's time without work: below the first for two turns some axes are put off, and while any
are also below the second; above the third one catches up. Between them nobody goes to and fro."""
PUT_OFF = 0.2
"""Share of the followed axes that is put off in a turn."""


class Backlog:
    """Axes that were put off, and when one is next.

    Parameters
    ----------
    most_bytes : of blocks that are stored and not worked. Beyond it axes catch up without spare time, which
        makes all senders wait.

    Attributes
    ----------
    newest : axis to the stamp of its newest block, s of the sender's clock. spare : share of the last turn.

    Examples
    --------
    >>> backlog, axes = Backlog(), [f"A{k}" for k in range(5)]
    >>> [backlog.turn(now, 0.0, waiting, axes) for now, waiting in ((0.0, 0.0), (1.0, 0.5), (2.0, 1.0))]
    [[], [], ['A4']]
    >>> for stamp in (7.0, math.nan):  # an empty block
    ...     backlog.put_off("A4", stamp, 100)
    >>> backlog.newest
    {'A4': 7.0}
    """

    def __init__(self, most_bytes: int = 4 << 30) -> None:
        self._most_bytes = most_bytes
        self.newest: dict[str, float] = {}
        self._bytes: dict[str, int] = {}
        self.spare, self._short = 1.0, 0
        # When the last turn began (s), what was spare until then, and what waited.
        self._before: tuple[float, float, float] | None = None

    def is_due(self, now: float) -> bool:
        """Whether a turn is over at a monotonic time, s."""
        return self._before is None or now - self._before[0] >= TURN_S

    def turn(self, now: float, spare_s: float, waiting_s: float, followed: Sequence[str]) -> list[str]:
        """Axes that are to be put off now: the last ones of those followed, never the only one, and none
        while what waits grows less.

        Parameters
        ----------
        now, spare_s : monotonic s, and s without work so far. waiting_s : s of data of the axis that
        lags most.
        """
        began, spare, waited = self._before or (now - TURN_S, spare_s - TURN_S, waiting_s)
        self._before = now, spare_s, waiting_s
        self.spare = (spare_s - spare) / (now - began)
        self._short = self._short + 1 if self.spare < (CALM_SPARE if self.newest else LEAST_SPARE) else 0
        if self._short < 2 or waiting_s < waited or len(followed) < 2:
            return []
        return [*followed[-max(1, round(PUT_OFF * len(followed))) :]]

    def put_off(self, axis: str, stamp: float, size: int) -> None:
        """An axis is put off, or another block of it was stored: its newest stamp (s; NaN where it has none),
        bytes."""
        if axis not in self.newest or math.isfinite(stamp):
            self.newest[axis] = stamp
        self._bytes[axis] = self._bytes.get(axis, 0) + size

    def worked(self, axis: str, size: int) -> None:
        """Stored blocks of an axis were worked: bytes."""
        self._bytes[axis] = max(0, self._bytes[axis] - size)

    def followed_again(self, axis: str) -> None:
        """An axis has caught up, or is forgotten."""
        self.newest.pop(axis, None)
        self._bytes.pop(axis, None)

    def clear(self) -> None:
        """All axes are followed."""
        self.newest.clear()
        self._bytes.clear()

    def next(self, *, idle: bool) -> str | None:
        """The axis that catches up now, if any: the one put off last, as it is behind least."""
        may = idle or self.spare > ENOUGH_SPARE or self.is_full
        return next(reversed(self.newest), None) if may else None

    @property
    def is_full(self) -> bool:
        """Whether more is stored than may be."""
        return sum(self._bytes.values()) > self._most_bytes
