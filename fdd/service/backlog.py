"""Who is followed under overload: the other axes' blocks are stored at once and worked when there is time."""

from __future__ import annotations

from collections.abc import Sequence

TURN_S = 1.0
LEAST_SPARE, ENOUGH_SPARE = 0.02, 0.1
"""Shares of the fleet's time without work: below the first for two turns some axes more are put off, above
the second one catches up. What lies between keeps them from going to and fro."""
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
    >>> backlog = Backlog()
    >>> [backlog.turn(now, 0.0, ["A1", "A2", "A3"]) for now in (1.0, 2.0, 2.5, 3.0)]
    [[], [], [], ['A3']]
    """

    def __init__(self, most_bytes: int = 4 << 30) -> None:
        self._most_bytes = most_bytes
        self.newest: dict[str, float] = {}
        self._bytes: dict[str, int] = {}
        self.spare = 1.0
        self._turned: float | None = None
        self._spare_s = 0.0
        self._short = 0

    def turn(self, now: float, spare_s: float, followed: Sequence[str]) -> list[str]:
        """Axes that are to be put off now: the last ones of those followed, never the only one.

        Parameters
        ----------
        now, spare_s : monotonic s, and s without work so far.
        """
        if self._turned is None:
            self._turned, self._spare_s = now, spare_s
        if now - self._turned < TURN_S:
            return []
        self.spare = (spare_s - self._spare_s) / (now - self._turned)
        self._turned, self._spare_s = now, spare_s
        self._short = self._short + 1 if self.spare < LEAST_SPARE else 0
        many = max(1, round(PUT_OFF * len(followed))) if self._short > 1 and len(followed) > 1 else 0
        return [*followed[len(followed) - many :]]

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

    def next(self, *, idle: bool) -> str | None:
        """The axis that catches up now, if any: the one put off last, as it is behind least."""
        if idle or self.spare > ENOUGH_SPARE or sum(self._bytes.values()) > self._most_bytes:
            return next(reversed(self.newest), None)
        return None
