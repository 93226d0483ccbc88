"""Blocks of one axis as they arrive, to samples in the order of time: repeated, late, reordered ones told."""

from __future__ import annotations

import zlib
from bisect import insort
from collections.abc import Mapping, Sequence
from math import isnan, nan
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MOST_HELD_BLOCKS
from fdd.errors import InputError
from fdd.monitor.stream import CLOCK_AHEAD_S, CLOCK_BACK_S, Gaps, StreamClock
from fdd.restorable import Restorable
from fdd.samples import Samples
from fdd.service.blocks import Block

Array = NDArray[np.float64]

_REMEMBERED = 1024
"""Blocks by which a repeated one is known: more than any sender has on its way."""
_MOST_MISSING = 1_000_000
"""A number farther ahead is that of a sender that counts anew."""
_MOST_GIVEN_UP = 64
_RECENT = 4096
"""Stamps that were passed on, by which a row that comes after newer ones is known as repeated."""
_MOST_OVERTAKEN = 5
"""Blocks before the first one that may still come: what half a second has."""
_COUNTS = ("received", "repeated", "late", "reordered", "missing_blocks")
_KEY = itemgetter(0)


class Order(Restorable):
    """Put one axis's blocks in order, holding `hold` s of data at most (up to 1), and follow its clock.

    With sequence numbers a block is passed on at once when the ones before it were, and else waits until they
    come or `hold` s of data are held. Without, each row waits until one `hold` s newer has come. A block
    known by number and content is *repeated*. Rows at or before one that was passed on are *late*, or
    *repeated* where a row with their stamp was passed on. A number that goes back, with other content and
    not among those given up as missing, means that the sender started anew. Stamps that go back by more than
    1 s or ahead by more than a year mean that its clock was set: times go on after a gap of 1 s. A stream
    that starts with the time of day is counted from its start.

    Attributes
    ----------
    clock : `offset` (s) is what is added to the sender's stamps, `resets` how often it was set.
    gaps : of what was passed on: rows missing on the grid of the period (`dropped`), longer holes (`jumps`).
    counts : samples received, repeated, late; blocks reordered; sequence numbers that never came in time.
    """

    STATE = (
        "clock", "gaps", "counts", "_held", "_known", "_known_next", "_recent", "_counted", "_expected",
        "_newest", "_passed", "_given_up",
    )  # fmt: skip

    def __init__(self, hold: float = 0.5) -> None:
        self._hold = min(hold, CLOCK_BACK_S)
        self.clock, self.gaps = StreamClock(), Gaps()
        self.counts: dict[str, int] = dict.fromkeys(_COUNTS, 0)
        # Rows that wait, by sequence number, or by their first stamp where the sender does not count.
        self._held: list[tuple[float, Samples]] = []
        # Sequence number (-1 without), checksum and first stamp of the latest blocks; where the next goes.
        self._known, self._known_next = np.full((3, _REMEMBERED), nan), 0
        self._recent = np.empty(0)
        self._start_anew(counted=False)

    def _start_anew(self, *, counted: bool) -> None:
        self._counted = counted
        # Number that comes next; newest stamp that came and newest that was passed on, by the sender.
        self._expected = self._newest = self._passed = nan
        self._given_up: list[tuple[float, float]] = []

    def take(self, blocks: Sequence[Block]) -> Samples:
        """Take blocks as they came; what is in order now, perhaps nothing, at times that go on (s)."""
        return self._passed_on([part for block in blocks for part in self._in_order(block)])

    def _in_order(self, block: Block) -> list[Samples]:
        """What need not wait any longer with a block, by the sender's stamps."""
        samples, number = block.samples, block.sequence
        self.counts["received"] += len(samples)
        if self._is_known(samples, number):
            self.counts["repeated"] += len(samples)
            return []
        out = []
        if self._is_new_start(samples, number):
            out = self._released(everything=True)
            self._start_anew(counted=number is not None)
        first, last = float(samples.time[0]), float(samples.time[-1])
        if number is not None and number < self._expected:
            self.counts["late"] += len(samples)
            return out
        if number is None:
            self.counts["reordered"] += int(first < self._newest)
            self._hold_by_stamps(samples)
            self._newest = last if isnan(self._newest) else max(self._newest, last)
        else:
            self.counts["reordered"] += int(bool(self._held) and number < self._held[-1][0])
            insort(self._held, (float(number), samples), key=_KEY)
            self._newest = last
        return [*out, *self._released()]

    def flush(self) -> Samples:
        """Give all that is held: at the end of a stream, or when it has fallen silent."""
        return self._passed_on(self._released(everything=True))

    @property
    def held_samples(self) -> int:
        """Samples that wait for ones before them."""
        return sum(len(rows) for _, rows in self._held)

    def _is_known(self, samples: Samples, number: int | None) -> bool:
        """Whether the very same block came before; it is remembered where not."""
        checksum = zlib.crc32(samples.time.data)
        for column in samples.columns.values():
            checksum = zlib.crc32(column.data, checksum)
        key = -1.0 if number is None else float(number)
        numbers, checksums, firsts = self._known
        if ((numbers == key) & (checksums == checksum) & (firsts == samples.time[0])).any():
            return True
        self._known[:, self._known_next] = key, checksum, samples.time[0]
        self._known_next = (self._known_next + 1) % _REMEMBERED
        return False

    def _is_new_start(self, samples: Samples, number: int | None) -> bool:
        first, last = float(samples.time[0]), float(samples.time[-1])
        if isnan(self._newest) or self._counted != (number is not None):
            return True
        if number is not None:
            back = number < self._expected and not any(a <= number < b for a, b in self._given_up)
            return back or number > self._expected + _MOST_MISSING
        if first > self._newest + CLOCK_AHEAD_S:
            return True
        if first >= self._newest - CLOCK_BACK_S:
            return False
        # A long block that was overtaken begins far back, yet ends where the newer ones begin.
        fits = first > self._passed if not isnan(self._passed) else last >= self._held[0][0] - self._hold
        return not (fits and last - first > self._hold)

    def _hold_by_stamps(self, samples: Samples) -> None:
        """Hold rows that are newer than what was passed on, merged with held ones that they overlap."""
        stale = samples.time <= self._passed
        if stale.any():
            # Rows that come after newer ones: repeated where their stamp was passed on, else late.
            repeated = int(np.isin(samples.time[stale], self._recent).sum())
            self.counts["repeated"] += repeated
            self.counts["late"] += int(stale.sum()) - repeated
            samples = samples.rows(int(stale.sum()), len(samples))
        if not len(samples):
            return
        first, last = float(samples.time[0]), float(samples.time[-1])
        touching = [h for h in self._held if h[0] <= last and h[1].time[-1] >= first]
        if touching:
            self._held = [h for h in self._held if h not in touching]
            time, columns = _joined([*(rows for _, rows in touching), samples])
            stamps, rows = np.unique(time, return_index=True)
            samples = Samples(stamps, {n: v[rows] for n, v in columns.items()})
            self.counts["repeated"] += time.size - stamps.size
        insort(self._held, (float(samples.time[0]), samples), key=_KEY)

    def _released(self, *, everything: bool = False) -> list[Samples]:
        """What need not wait any longer, and is not held any more."""
        out = []
        while self._held and (everything or self._is_due()):
            key, samples = self._held.pop(0)
            if self._counted:
                self._give_up(key)
                self._expected = max(key + 1.0, self._expected)  # not back: two senders may count alike
            else:
                self._recent = np.concatenate([self._recent, samples.time])[-_RECENT:]
            self._passed = float(samples.time[-1])
            out.append(samples)
        return out

    def _is_due(self) -> bool:
        key, samples = self._held[0]
        if not self._counted:
            return bool(self._newest - samples.time[-1] >= self._hold)
        if key <= self._expected or (isnan(self._expected) and key == 0.0):
            return True
        # Of what is held, in the order of numbers, a clock that was set in between does not count.
        steps = np.diff([rows.time[0] for _, rows in self._held])
        held_s = steps[(steps > 0.0) & (steps < CLOCK_AHEAD_S)].sum() + self._held[-1][1].duration
        return len(self._held) > MOST_HELD_BLOCKS or bool(held_s > self._hold)

    def _give_up(self, number: float) -> None:
        """Wait no longer for the blocks before one; before a stream's first none is known to be missing."""
        first = self._expected
        if isnan(first):
            first = max(0.0, number - _MOST_OVERTAKEN)
        else:
            self.counts["missing_blocks"] += max(0, int(number - first))
        if first < number:
            self._given_up = [*self._given_up, (first, number)][-_MOST_GIVEN_UP:]

    def _passed_on(self, parts: list[Samples]) -> Samples:
        """The parts as one, with times that go on."""
        if not parts:
            return Samples([], {})
        time, columns = _joined(parts)
        time, kept = self.clock.follow(time)
        if not kept.all():
            self.counts["late"] += int((~kept).sum())
            time, columns = time[kept], {n: v[kept] for n, v in columns.items()}
        self.gaps.count(time)
        return Samples(time, columns)

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from a state. Raises InputError: it is no state of an `Order`."""
        try:
            super().restore(state)
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(f"no state of an order ({type(error).__name__})", mend="start anew") from None


def _joined(parts: list[Samples]) -> tuple[Array, dict[str, Array]]:
    """Rows of all parts one after the other; a channel that a part lacks is missing there."""
    if len(parts) == 1:
        return parts[0].time, parts[0].columns
    names = dict.fromkeys(name for p in parts for name in p.channels)
    columns = {n: np.concatenate([p.get(n) for p in parts]) for n in names}
    return np.concatenate([p.time for p in parts]), columns
