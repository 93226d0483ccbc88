"""Who is followed under overload: the other axes' blocks are stored at once and worked when there is time."""

from __future__ import annotations

import math
from collections.abc import Sequence

TURN_S = 1.0
LEAST_SPARE, ENOUGH_SPARE = 0.02, 0.1
"""Shares of the fleet's time without work: below the first for two turns axes are put off, above the second
one catches up. What lies between keeps them from going to and fro."""
STORING = 0.25
"""What a block costs that is stored alone, of one that is worked (measured: 0.2 to 0.25 of 0.9 ms)."""
DRAINED = 0.8
"""Of the axes that the fleet can follow so many are, so that what has come to wait is worked soon."""
PATIENCE = 5
"""Turns that what has come to wait is given, before further axes are put off."""


class Backlog:
    """Axes that were put off, and when one is next.

    The fleet's time is what working one axis costs, times those followed and `STORING` times the others; from
    both follows how many it can follow.

    Parameters
    ----------
    most_bytes : of blocks that are stored and not worked. Beyond it axes catch up without spare time, which
        makes all senders wait.

    Attributes
    ----------
    newest : axis to the stamp of its newest block, s of the sender's clock. spare : share of the last turn.

    Examples
    --------
    A fleet that works 2 s of data in a second, of three axes:

    >>> backlog = Backlog()
    >>> for now in (1.0, 2.0, 3.0):
    ...     backlog.took(2.0, followed=True)
    ...     print(backlog.turn(now, 0.0, ["A1", "A2", "A3"]))
    []
    []
    ['A2', 'A3']
    """

    def __init__(self, most_bytes: int = 4 << 30) -> None:
        self._most_bytes = most_bytes
        self.newest: dict[str, float] = {}
        self._bytes: dict[str, int] = {}
        self.spare, self._can = 1.0, math.inf
        self._turned: float | None = None
        self._spare_s = self._worked_s = self._stored_s = 0.0
        self._short = 0

    def took(self, seconds: float, *, followed: bool) -> None:
        """Count s of data that were worked, or stored alone."""
        if followed:
            self._worked_s += seconds
        else:
            self._stored_s += seconds

    def turn(self, now: float, spare_s: float, followed: Sequence[str]) -> list[str]:
        """Axes that are to be put off now: the last ones of those followed, never the only one.

        Parameters
        ----------
        now, spare_s : monotonic s, and s without work so far.
        """
        if self._turned is None:
            self._turned, self._spare_s, self._worked_s = now, spare_s, 0.0
        span = now - self._turned
        if span < TURN_S:
            return []
        self.spare = (spare_s - self._spare_s) / span
        data = self._worked_s + STORING * self._stored_s
        axes = len(followed) + len(self.newest)
        can = data / max(span * (1.0 - self.spare), 1e-9)  # s of data a second
        self._can = (can - STORING * axes) / (1.0 - STORING) if data > 0.0 else math.inf
        self._turned, self._spare_s, self._worked_s, self._stored_s = now, spare_s, 0.0, 0.0
        self._short = self._short + 1 if self.spare < LEAST_SPARE else 0
        if self._short < 2 or len(followed) < 2:
            return []
        self._short = -PATIENCE
        can = max(1, min(int(DRAINED * self._can), len(followed) - 1))
        return [*followed[can:]]

    def put_off(self, axis: str, stamp: float, size: int) -> None:
        """An axis is put off, or another block of it was stored: its newest stamp (s), bytes."""
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

    def next(self, followed: int, *, idle: bool) -> str | None:
        """The axis that catches up now, if any: the one put off last, as it is behind least.

        Parameters
        ----------
        followed : axes that are. idle : nothing else waits.
        """
        may = idle or (self.spare > ENOUGH_SPARE and followed < self._can) or self.is_full
        return next(reversed(self.newest), None) if may else None

    @property
    def is_full(self) -> bool:
        """Whether more is stored than may be."""
        return sum(self._bytes.values()) > self._most_bytes
