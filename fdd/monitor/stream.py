"""What senders of a live stream mean: lines, their keys as channels in SI, and their clock: followed where it
was set; what came late and what is missing is counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_LINE_BYTES
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap, ChannelSource, to_si
from fdd.logs.grid import grid_steps
from fdd.logs.quality import COUNTED_GAP, JUMP_PERIODS, nominal_period
from fdd.restorable import Restorable
from fdd.samples import CHANNELS

Array = NDArray[np.float64]

CLOCK_BACK_S, CLOCK_AHEAD_S = 1.0, 365.0 * 86400.0
"""s; stamps that go back or ahead by more mean that the clock was set, not that a row came late, or that the
axis stood still over a night or a month. A clock without a battery starts decades ago."""
CLOCK_GAP_S = 1.0
"""s between the rows before and after the clock was set."""
EPOCH_S = 1e6
"""s; a stream that starts later than this carries the time of day and is counted from its start."""
TOGETHER = 1000
"""Rows that are looked at together: a clock that is set at each of them must not take time squared."""
MOST_REMARKS = 100
PERIOD_STEPS = 100
"""Steps of time that tell the period."""
REST_KEPT = 0.8
"""See `grid_steps`; less than of a whole log, as a period that few steps told is a little off."""


def split_lines(tail: bytes, chunk: bytes, ended: bool) -> tuple[list[bytes], bytes, int]:
    """Whole lines of the rest before and what came, the new rest, and how many were left out as too long."""
    first, *more = chunk.split(b"\n")
    # Of a line without end no more is copied than tells that it is too long.
    *whole, rest = [tail if len(tail) > MAX_LINE_BYTES else tail + first, *more]
    if ended:
        whole, rest = [*whole, rest], b""
    overlong = sum(len(line) > MAX_LINE_BYTES for line in whole)
    lines = [line for line in whole if len(line) <= MAX_LINE_BYTES and line.strip()]
    # One byte more than allowed is kept of a line without end: it stays overlong, and small.
    return lines, rest[: MAX_LINE_BYTES + 1], overlong


class StreamMap:
    """A channel map applied to what a stream sends: `keys` (all that are read, in order) to channels in SI.

    Without a map the contract's names in SI; the key ``time`` in s where the map has no time.
    Raises InputError: the map has a topic, `wrap`, or `sign_of` of an angle, which need a whole log.

    Examples
    --------
    >>> known = StreamMap(ChannelMap.from_yaml("position: {column: x, unit: mm, sign_of: s}"))
    >>> list(known.keys), known.are_numbers({"x": 1, "name": "a"}), known.are_numbers({"x": True})
    (['time', 'x', 's'], True, False)
    >>> known.of_rows([{"x": 5, "s": 1}, {"x": None}, {}])
    {'position': array([0.005,   nan,   nan])}
    """

    def __init__(self, channel_map: ChannelMap | None) -> None:
        self.sources = {"time": ChannelSource(column="time")}
        if channel_map is None:
            self.sources |= {n: ChannelSource(column=n) for n in CHANNELS}
        for name, source in {} if channel_map is None else channel_map.channels.items():
            if source.from_ is not None:
                continue  # the pipeline accumulates the pump's speed itself
            angle = CHANNELS[name].dimension == "angle"
            if source.column is None or source.wrap is not None or (angle and source.sign_of is not None):
                only = "a stream takes plain columns only (no topic, wrap or sign_of of an angle)"
                mend = "name the key of the JSON lines: {column: KEY, unit: UNIT}"
                raise InputError(f"channel {name}: {only}", mend=mend)
            self.sources[name] = source
        self.keys = dict.fromkeys(
            k for s in self.sources.values() for k in (s.column, s.sign_of) if k is not None
        )

    def in_si(self, raw: Callable[[str], Array | None]) -> dict[str, Array]:
        """The channels that are there, `time` among them; `raw` gives a key's numbers (n,), or None."""
        out = {}
        for name, source in self.sources.items():
            values = raw(str(source.column))
            if values is None:
                continue
            direction = raw(source.sign_of) if source.sign_of else None
            if source.sign_of and direction is None:
                direction = np.full(values.size, np.nan)
            out[name] = to_si(name, source, values, direction)
        return out

    def of_rows(self, rows: Sequence[Mapping[str, Any]]) -> dict[str, Array]:
        """The same of JSON objects, one a row; a channel that no row has is not there."""

        def column(key: str) -> Array | None:
            if not any(key in row for row in rows):
                return None
            return np.array([_number(row.get(key)) for row in rows], dtype=np.float64)

        return self.in_si(column)

    def are_numbers(self, row: Mapping[str, Any]) -> bool:
        """Whether what is read of a JSON object are numbers or null."""
        return all(row.get(key) is None or type(row[key]) in (float, int) for key in self.keys)


def _number(value: float | None) -> float:
    try:
        return float("nan" if value is None else value)
    except OverflowError:  # an integer beyond any float
        return float("inf")


class StreamClock(Restorable):
    """Turn a sender's stamps into times that only go on.

    `last_time`: s, of the last row given; `offset`: s, added to the sender's stamps; `late`: rows that came
    late or again; `resets`: times that the clock was set.
    """

    STATE = ("last_time", "offset", "late", "resets")

    def __init__(self) -> None:
        self.last_time = self.offset = float("nan")
        self.late = self.resets = 0
        self._remarks: deque[str] = deque(maxlen=MOST_REMARKS)

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
            stamps = time[start : start + TOGETHER] + self.offset
            # Highest stamp before each row: what a late row is compared with.
            jump = stamps - np.fmax.accumulate(np.concatenate([[last], stamps]))[:-1]
            set_ = np.flatnonzero((jump < -CLOCK_BACK_S) | (jump > CLOCK_AHEAD_S))
            stop = int(set_[0]) if set_.size else stamps.size
            good = np.isnan(jump) | (jump > 0.0)  # before the first row is none
            out[start : start + stop], kept[start : start + stop] = stamps[:stop], good[:stop]
            self.late += int((~good[:stop]).sum())
            if good[:stop].any():
                last = float(stamps[:stop][good[:stop]][-1])
            start += stop
            if set_.size:
                self.offset += last + CLOCK_GAP_S - float(stamps[stop])
                self.resets += 1
                self._remarks.append(f"the clock was set at {last:.3f} s; times go on from there")
        self.last_time = last
        return out, kept

    def remarks(self) -> list[str]:
        """Notes that are new since the last call."""
        out = list(self._remarks)
        self._remarks.clear()
        return out


class Gaps(Restorable):
    """Count missing rows and jumps of a stream, however it is cut; the first steps tell the period.

    `dropped`, `jumps`: rows missing on the grid of the period; gaps of more than `JUMP_PERIODS` periods.
    `period`: s; NaN until `PERIOD_STEPS` steps have told it. `rest`: periods that rounding left over; see
    `grid_steps`. `waiting`: s, the last rows' times: what the next ones are counted from.
    """

    STATE = ("dropped", "jumps", "period", "rest", "waiting")

    def __init__(self) -> None:
        self.dropped = self.jumps = 0
        self.period, self.rest = float("nan"), 0.0
        self.waiting = np.empty(0)

    def count(self, time: Array) -> None:
        """Go on by the times (n,) s of a block; they increase."""
        time = np.concatenate([self.waiting, time])
        if np.isnan(self.period):
            if time.size <= PERIOD_STEPS:
                self.waiting = time
                return
            self.period = nominal_period(time[: PERIOD_STEPS + 1])
        # A step is judged with the one after it: a late row makes a long one and then a short one.
        steps, self.waiting = np.diff(time), time[-2:]
        whole, rests = grid_steps(time, self.period, self.rest, REST_KEPT)
        missing = np.where(steps <= COUNTED_GAP, whole - 1, 0)
        self.dropped += int(np.maximum(missing[:-1] + np.minimum(missing[1:], 0), 0).sum())
        self.jumps += int((steps[:-1] > JUMP_PERIODS * self.period).sum())
        self.rest = float(rests[-1])
