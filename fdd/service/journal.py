"""Blocks that are stored and not in their axes' states: worked after a restart, or when there is time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from fdd.service.axis import AxisWatch, Look
from fdd.service.backlog import Backlog
from fdd.service.blocks import Decoder
from fdd.service.life import worked_key
from fdd.service.store import Store, Transaction
from fdd.service.storing import Writer

PORTION = 32
"""Blocks that are worked between two steps of the fleet: some hundredths of a second."""
MOST_NAMED = 3


class Journal:
    """The journal of a store, for a fleet.

    Parameters
    ----------
    clock : Unix seconds.

    Attributes
    ----------
    backlog : axes that are put off.
    """

    def __init__(self, store: Store, writer: Writer, backlog: Backlog, clock: Callable[[], float]) -> None:
        self._store, self._writer, self.backlog, self._clock = store, writer, backlog, clock
        self._decoder = Decoder()

    def rows(self, axis: str, most: float = math.inf) -> Iterator[tuple[int, bytes]]:
        """Blocks of an axis (row, payload) that are not in its state, at most so many."""
        last = self._writer.last_row.get(axis, 0)
        while most > 0 and (rows := self._store.journal(axis, last, int(min(most, PORTION)))):
            yield from rows
            last, most = rows[-1][0], most - len(rows)

    def replayed(self, watch: AxisWatch) -> Iterator[list[Look]]:
        """Work again what an axis had worked before a restart; what came while it was put off is left."""
        worked = self._store.meta(worked_key(watch.name))
        for number, payload in self.rows(watch.name):
            if worked is not None and number > int(worked):
                self.backlog.put_off(watch.name, math.nan, self._store.journal_bytes(watch.name))
                return
            self._writer.last_row[watch.name] = number
            yield self.work(watch, payload)
        if worked is not None:
            with self._store.transaction() as t:
                t.forget(worked_key(watch.name))

    def work(self, watch: AxisWatch, payload: bytes) -> list[Look]:
        """Work a block of an axis; b"" is the end of its waiting."""
        wall = self._clock() - self.behind_s(watch)
        if not payload:
            return watch.settle(wall, flush=True)
        block = self._decoder.decode(payload, "journal", axis=watch.name)
        return watch.push(replace(block, received=wall))

    def behind_s(self, watch: AxisWatch) -> float:
        """s of data that are stored and not worked yet, of an axis that is put off."""
        clock = watch.order.clock
        behind = self.backlog.newest.get(watch.name, math.nan) + clock.offset - clock.last_time
        return max(behind, 0.0) if math.isfinite(behind) else 0.0

    def put_off(self, axes: Sequence[str]) -> Callable[[Transaction], object]:
        """From now on only store what comes of these axes; what notes in the store how far each is worked."""
        for axis in axes:
            self.backlog.put_off(axis, math.nan, 0)

        def write(t: Transaction) -> None:
            # A row's number is known only now that this step's blocks are in the journal.
            for axis in axes:
                t.meta(worked_key(axis), str(self._writer.last_row.get(axis, 0)))

        return write

    def portion(self, watch: AxisWatch) -> tuple[list[bytes], Callable[[Transaction], object]]:
        """The next blocks of an axis that is put off, and what notes them; without more it is followed again.

        Raises StoreTrouble: they cannot be read now.
        """
        axis, rows = watch.name, list(self.rows(watch.name, PORTION))
        payloads = [payload for _, payload in rows]
        if rows:
            self._writer.last_row[axis] = rows[-1][0]
        if len(rows) < PORTION:
            self.backlog.followed_again(axis)
            return payloads, lambda t: t.forget(worked_key(axis))
        self.backlog.worked(axis, sum(map(len, payloads)))
        return payloads, lambda t: t.meta(worked_key(axis), str(rows[-1][0]))

    def problems(self, followed: int, off: Sequence[AxisWatch]) -> list[str]:
        """What is behind, of the axes that are put off, in a line."""
        if not off:
            return []
        behind, names = max(map(self.behind_s, off)), ", ".join(watch.name for watch in off[:MOST_NAMED])
        more = f" and {len(off) - MOST_NAMED} more" if len(off) > MOST_NAMED else ""
        told = f"overloaded: {followed} of {followed + len(off)} axes are followed, the others are stored"
        return [f"{told} and worked later, {behind:.0f} s behind: {names}{more}"]
