"""The clock of a live stream: followed where it was set; what came late and what is missing is counted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.logs.quality import COUNTED_GAP
from fdd.logs.stamps import JUMP_PERIODS

Array = NDArray[np.float64]

CLOCK_BACK_S, CLOCK_AHEAD_S = 1.0, 3600.0
"""s; stamps that go back or ahead by more mean that the clock was set, not that a row came late."""
CLOCK_GAP_S = 1.0
"""s between the rows before and after the clock was set."""
EPOCH_S = 1e6
"""s; a stream that starts later than this carries the time of day and is counted from its start."""
PERIOD_STEPS = 100
"""Steps of time that tell the period."""


class StreamClock:
    """Turn a sender's stamps into times that only go on.

    Parameters
    ----------
    after, offset : s; last time of an earlier run and its clock offset, to go on from.

    Attributes
    ----------
    last_time : s, of the last row given.
    offset : s, added to the sender's stamps.
    late, resets : rows that came late or again; times that the clock was set.

    Examples
    --------
    >>> clock = StreamClock()
    >>> times, kept = clock.follow(np.array([5.0, 5.1, 5.1, 0.0, 0.1]))
    >>> times[kept].round(3).tolist(), clock.late, clock.resets
    ([5.0, 5.1, 6.1, 6.2], 1, 1)
    """

    def __init__(self, after: float = float("nan"), offset: float = float("nan")) -> None:
        self.last_time = after
        self.offset = offset
        self.late = self.resets = 0
        self._remarks: list[str] = []

    def follow(self, time: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Times (n,) s that go on from the last ones, and which of the rows do (n,)."""
        if time.size and np.isnan(self.offset):
            self.offset = 0.0
            if np.isnan(self.last_time) and time[0] > EPOCH_S:
                self.offset = -float(time[0])
                self._remarks.append(f"the clock starts at {time[0]:.3f} s; times are counted from there")
        out, kept, last = np.empty_like(time), np.zeros(time.size, dtype=bool), self.last_time
        start = 0
        while start < time.size:
            stamps = time[start:] + self.offset
            # Highest stamp before each row: what a late row is compared with.
            before = np.maximum.accumulate(
                np.concatenate([[last if np.isfinite(last) else -np.inf], stamps])
            )[:-1]
            jump = stamps - before
            known = np.isfinite(before)
            set_ = np.flatnonzero(known & ((jump < -CLOCK_BACK_S) | (jump > CLOCK_AHEAD_S)))
            stop = int(set_[0]) if set_.size else stamps.size
            good = ~known | (jump > 0.0)
            out[start : start + stop], kept[start : start + stop] = stamps[:stop], good[:stop]
            self.late += int((~good[:stop]).sum())
            if good[:stop].any():
                last = float(stamps[:stop][good[:stop]][-1])
            start += stop
            if start < time.size:
                self.offset += last + CLOCK_GAP_S - float(stamps[stop])
                self.resets += 1
                self._remarks.append(f"the clock was set at {last:.3f} s; times go on from there")
        self.last_time = last
        return out, kept

    def remarks(self) -> list[str]:
        """Notes that are new since the last call."""
        out, self._remarks = self._remarks, []
        return out


class Gaps:
    """Count missing rows and jumps of a stream, however it is cut; the first steps tell the period.

    Attributes
    ----------
    dropped, jumps : rows missing on the grid of the period; gaps of more than `JUMP_PERIODS` periods.
    period : s; NaN until `PERIOD_STEPS` steps have told it.

    Examples
    --------
    >>> gaps = Gaps()
    >>> for part in np.split(np.delete(np.arange(300) * 0.001, [150, 151]), [40, 200]):
    ...     gaps.count(part)
    >>> gaps.dropped, gaps.jumps
    (2, 0)
    """

    def __init__(self) -> None:
        self.dropped = self.jumps = 0
        self.period = float("nan")
        self.early = self.last = np.empty(0)

    def count(self, time: Array) -> None:
        """Go on by the times (n,) s of a block; they increase."""
        if not time.size:
            return
        steps = np.diff(np.concatenate([self.last, time]))
        self.last = time[-1:]
        if np.isnan(self.period):
            self.early = steps = np.concatenate([self.early, steps])
            if steps.size < PERIOD_STEPS:
                return
            self.period, self.early = float(np.median(steps)), np.empty(0)
        missing = np.rint(steps[steps <= COUNTED_GAP] / self.period) - 1.0
        self.dropped += int(missing[missing > 0.0].sum())
        self.jumps += int((steps > JUMP_PERIODS * self.period).sum())
