"""The watch over a unit's sensors: blocks of samples in, what may be trusted of them out."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from fdd.errors import InputError
from fdd.restorable import Restorable
from fdd.samples import Samples
from fdd.sensors.finding import FAILING, Memory, SensorFinding, SensorFindings, njit
from fdd.sensors.judge import FrameJudge
from fdd.sensors.limits import DIFFERENCE, INDEX, NAMES, ONE, TWO, Array, Limits, Mask
from fdd.sensors.scan import FRAME_S
from fdd.unit import Unit

TAIL_S = 0.3
"""s of a frame that are judged once more with the next one."""
BACK_S = 0.05
"""A value that does not come back within this time has jumped for good."""


class SensorWatch(Restorable):
    """Judge each channel before any hydraulics: which may be trusted, and since when not.

    Verdicts fall at the ends of frames of half a second, counted from the first row, once a row after the
    frame came; single rows that cannot be true are taken out as they come. So nothing depends on how the log
    was cut into blocks, and nothing is held back: what was passed before a verdict stays passed. Ranges,
    counts, noise, stroke and speeds are those of the unit's profile.
    """

    STATE = ("_first", "_last", "_frame", "_tail", "_parts", "_findings")

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self._limits = Limits.of(unit)
        self._bounds = self._limits.row_bounds()
        self._first, self._last, self._frame = np.nan, -np.inf, 0
        self._tail: tuple[Array, Array] = np.empty(0), np.empty((len(NAMES), 0))
        self._parts: list[tuple[Array, Array, Mask]] = []
        self._findings = SensorFindings(Memory.new())
        self._judge = FrameJudge(self._limits, self._findings)

    def push(self, samples: Samples) -> Samples:
        """The same samples, with NaN where a value must not be trusted.

        A failed channel is NaN from the verdict on, single impossible rows at once. Spikes and slips leave a
        channel usable; a slip's step is in `findings`. Raises InputError: time that does not go on.
        """
        n = len(samples)
        if not n:
            return samples
        time = samples.time
        if time[0] <= self._last:
            raise InputError(
                f"time {time[0]:.6f} s comes after {self._last:.6f} s",
                mend="push blocks in the order of time",
            )
        if np.isnan(self._first):
            self._first = float(time[0])
        values = np.concatenate([samples.get(name) for name in NAMES]).reshape(len(NAMES), n)
        frames = np.floor((time - self._first) / FRAME_S + 1e-9)
        masked = np.empty(values.shape, dtype=np.bool_)
        for a, b in pairwise([0, *(np.flatnonzero(frames[1:] != frames[:-1]) + 1).tolist(), n]):
            if frames[a] != self._frame:
                self._close_frame()
                self._frame = int(frames[a])
            part = time[a:b].copy(), values[:, a:b].copy()
            begin = float(self._parts[0][0][0] if self._parts else time[a])
            wild = impossible_rows(*part, begin, self._bounds, self._limits.dead, self._findings.memory)
            self._parts.append((*part, wild))
            masked[:, a:b] = wild | self._failed()[:, None]
        self._last = float(time[-1])
        if not np.count_nonzero(masked):
            return samples
        return samples.without({n: out for n in samples.channels if (out := masked[INDEX[n]]).any()})

    def findings(self) -> list[SensorFinding]:
        """Faults so far, in the order of their onsets."""
        return [f for f in self._findings.by_onset() if not f.sound]

    def take_jumps(self) -> list[tuple[float, float, float]]:
        """Begin, end and decision (s) of the position's jumps since this was last asked."""
        taken, self._findings.jumps = self._findings.jumps, []
        return taken

    def notes(self) -> list[str]:
        """What sound sensors could not show."""
        return [f.evidence for f in self._findings.by_onset() if f.sound]

    def states(self) -> list[dict[str, Any]]:
        """Of each channel that was seen: channel, state ("trusted" or the kind of failure), since (s).

        `since` is None for a channel that was good throughout; a channel that jumped or spiked, and is
        usable, says so with the time of the last such finding's onset.
        """
        out: list[dict[str, Any]] = []
        for name in (n for n, seen in zip(NAMES, self._findings.memory.present, strict=True) if seen > 0):
            mine = [f for f in self._findings.by_onset() if name in f.channels]
            lasting = [f for f in mine if f.kind in FAILING and f.until_s is None]
            usable = [f for f in mine if f.kind not in FAILING]
            latest = (lasting or usable)[-1:]
            state, since = (latest[0].kind, latest[0].onset_s) if latest else ("trusted", None)
            out.append({"channel": name, "state": state, "since": since})
        return out

    def _failed(self) -> Mask:
        """Channels out now, (12,); a Δp that was made of both chambers' fails with either."""
        failed = ~np.isnan(self._findings.memory.failed_since)
        if self._findings.memory.derived[0] == 1.0 and (failed[ONE] or failed[TWO]):
            failed[DIFFERENCE] = True
        return failed

    def _close_frame(self) -> None:
        """Judge the rows of the frame that is over, with the tail of the one before."""
        if not self._parts:
            return
        end = self._first + (self._frame + 1) * FRAME_S
        # A tail from before a gap belongs to another frame: nothing can be said across it.
        tail = slice(int(np.searchsorted(self._tail[0], end - FRAME_S - TAIL_S)), None)
        first = self._tail[0][tail].size
        time = np.concatenate([self._tail[0][tail], *(p[0] for p in self._parts)])
        values = np.concatenate([self._tail[1][:, tail], *(p[1] for p in self._parts)], axis=1)
        wild = np.concatenate([p[2] for p in self._parts], axis=1)
        self._judge.judge(time, values, first, wild, end)
        tail = slice(int(np.searchsorted(time, end - TAIL_S)), None)
        self._tail = time[tail].copy(), values[:, tail].copy()
        self._parts = []


@njit(nogil=True)
def impossible_rows(
    time: Array, values: Array, frame_begin: float, bounds: Array, dead: Array, memory: Memory
) -> Mask:
    """Impossible values among `values` (12, n), taken at `time` (n,) s; rows have to come in their order.

    Their frame began at `frame_begin` (s); `bounds` are `Limits.row_bounds`, `dead` (12,) is what a broken
    loop reads, and the last good values are kept in `memory`.
    """
    out = np.zeros(values.shape, np.bool_)
    slack = np.empty(time.size)
    older, old = memory.stamps
    for i in range(time.size):
        # A late stamp takes time from the next step: allow for the two steps together.
        step, before = time[i] - old, old - older
        slack[i] = (0.0 if np.isnan(step) else step) + (0.0 if np.isnan(before) else before)
        older, old = old, time[i]
    memory.stamps[0], memory.stamps[1] = older, old
    for k in range(values.shape[0]):
        loose = memory.held_until[k] > frame_begin
        previous, low, high = memory.previous[k], bounds[0, k], bounds[1, k]
        for i in range(time.size):
            value = values[k, i]
            out[k, i] = value < low or value > high or (loose and (value == previous or value == dead[k]))
            previous = value
        memory.previous[k] = previous
        if bounds[2, k] < np.inf:
            _too_fast(time, slack, values[k], out[k], k, bounds[2, k], bounds[3, k], memory)
    return out


@njit(nogil=True)
def _too_fast(
    time: Array, slack: Array, values: Array, out: Mask, k: int, rate: float, floor: float, memory: Memory
) -> None:
    """Mark rows farther from the last good one than the rate allows, until they come back or stay."""
    good, at, doubtful = memory.good_value[k], memory.good_time[k], memory.doubtful_since[k]
    for i in range(time.size):
        if np.isnan(values[i]) or out[i]:
            continue
        far = abs(values[i] - good) > rate * (time[i] - at + slack[i]) + floor
        if far and not time[i] - doubtful >= BACK_S:
            out[i] = True
            doubtful = time[i] if np.isnan(doubtful) else doubtful
        else:
            good, at, doubtful = values[i], time[i], np.nan
    memory.good_value[k], memory.good_time[k], memory.doubtful_since[k] = good, at, doubtful
