"""JSON lines to samples: what is malformed is counted, a clock that was set is followed."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_LINE_BYTES
from fdd.diagnosis.findings import Quality
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.conversion import to_si
from fdd.logs.quality import COUNTED_GAP, check_magnitudes
from fdd.logs.stamps import JUMP_PERIODS
from fdd.logs.wire.json_messages import objects_at_once
from fdd.samples import CHANNELS, Samples

Array = NDArray[np.float64]

CLOCK_BACK_S, CLOCK_AHEAD_S = 1.0, 3600.0
"""s; stamps that go back or ahead by more mean that the clock was set, not that a row came late."""
CLOCK_GAP_S = 1.0
"""s between the rows before and after the clock was set."""
EPOCH_S = 1e6
"""s; a stream that starts later than this carries the time of day and is counted from its start."""
CHECKED_S = 5.0
"""s of data after which the units of measure are checked once."""
PERIOD_STEPS = 100
"""Steps of time that tell the period."""
MOST_NAMES = 8


def split_lines(tail: bytes, chunk: bytes, ended: bool) -> tuple[list[bytes], bytes, int]:
    """Whole lines of what came, the rest, and how many lines were dropped for their length.

    Parameters
    ----------
    tail : rest of the last call. chunk : what came. ended : whether it was the last.

    Examples
    --------
    >>> split_lines(b'{"a"', b': 1}\\n{"a": 2', False)
    ([b'{"a": 1}'], b'{"a": 2', 0)
    """
    *whole, rest = (tail + chunk).split(b"\n")
    if ended:
        whole, rest = [*whole, rest], b""
    overlong = sum(len(line) > MAX_LINE_BYTES for line in whole)
    lines = [line for line in whole if len(line) <= MAX_LINE_BYTES and line.strip()]
    # One byte more than allowed is kept of a line without end: it stays overlong, and small.
    return lines, rest[: MAX_LINE_BYTES + 1], overlong


class LineParser:
    """Turn lines into samples, and remember what was odd.

    Parameters
    ----------
    channel_map : names and units of the lines' keys; the contract's names in SI without one.
        `wrap`, `sign_of` of an angle and topics need a whole log and are refused.
    after, offset : s; last time of an earlier run and its clock offset, to go on from.

    Attributes
    ----------
    malformed : lines that were no JSON object with a time and numbers.
    last_time : s, of the last sample given.
    offset : s, added to the stream's stamps.

    Examples
    --------
    >>> parser = LineParser()
    >>> parser.samples([b'{"time": 0.5, "position": 0.01}', b'nonsense'])["position"].tolist()
    [0.01]
    >>> parser.malformed
    1
    """

    def __init__(
        self,
        channel_map: ChannelMap | None = None,
        *,
        after: float = float("nan"),
        offset: float = float("nan"),
    ) -> None:
        self._sources = _sources(channel_map)
        named = [k for s in self._sources.values() for k in (s.column, s.sign_of) if k is not None]
        self._keys = dict.fromkeys(named)
        self.malformed = 0
        self.last_time = after
        self.offset = offset
        self._late = self._not_finite = self._nan = self._dropped = self._jumps = self._resets = 0
        self._period = float("nan")
        self._early = self._accounted = np.empty(0)
        self._unknown: dict[str, None] = {}
        self._remarks: list[str] = []
        self._unchecked: list[Samples] | None = []
        self._told_malformed = False

    def samples(self, lines: list[bytes]) -> Samples:
        """The block that these lines hold, perhaps empty.

        Raises
        ------
        InputError : the first seconds show that a channel is in another unit of measure.
        """
        rows = [r for r in self._objects(lines) if self._usable(r)]
        raw = {n: self._column(rows, s) for n, s in self._sources.items() if self._present(rows, s)}
        if "time" not in raw:
            self._count_malformed(len(rows))
            return Samples([], {})
        columns = {
            n: to_si(n, s, raw[n], self._column(rows, ChannelSource(column=s.sign_of)) if s.sign_of else None)
            for n, s in self._sources.items()
            if n in raw
        }
        time = columns.pop("time")
        stamped = np.isfinite(time)
        self._count_malformed(int((~stamped).sum()))
        time, columns = time[stamped], {n: v[stamped] for n, v in columns.items()}
        time, kept = self._followed(time)
        block = Samples(time[kept], {n: self._finite(v[kept]) for n, v in columns.items()})
        self._account(block)
        return block

    def _objects(self, lines: list[bytes]) -> list[dict[str, Any]]:
        found = objects_at_once(lines)
        if found is not None:
            return found
        out = []
        for line in lines:
            try:
                one = json.loads(line)
            except (ValueError, RecursionError):
                one = None
            if isinstance(one, dict):
                out.append(one)
            else:
                self._count_malformed(1)
        return out

    def _usable(self, row: dict[str, Any]) -> bool:
        """Whether all that is read of a line are numbers; also collects names that nobody knows."""
        for key in row:
            if key not in self._keys and len(self._unknown) < MOST_NAMES and key not in self._unknown:
                self._unknown[key] = None
                self._remarks.append(f"{key[:40]!r} is no channel and is passed over")
        for key in self._keys:
            value = row.get(key)
            if value is not None and type(value) is not float and type(value) is not int:
                self._count_malformed(1)
                return False
        return True

    @staticmethod
    def _present(rows: list[dict[str, Any]], source: ChannelSource) -> bool:
        return any(source.column in r for r in rows)

    @staticmethod
    def _column(rows: list[dict[str, Any]], source: ChannelSource) -> Array:
        return np.array([_number(r.get(str(source.column))) for r in rows], dtype=np.float64)

    def _finite(self, values: Array) -> Array:
        infinite = np.isinf(values)
        self._not_finite += int(infinite.sum())
        return np.where(infinite, np.nan, values)

    def _followed(self, time: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Times that go on from the last ones, and which rows do."""
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
            self._late += int((~good[:stop]).sum())
            if good[:stop].any():
                last = float(stamps[:stop][good[:stop]][-1])
            start += stop
            if start < time.size:
                self.offset += last + CLOCK_GAP_S - float(stamps[stop])
                self._resets += 1
                self._remarks.append(f"the clock was set at {last:.3f} s; times go on from there")
        self.last_time = last
        return out, kept

    def _account(self, block: Samples) -> None:
        if not len(block):
            return
        self._count_gaps(np.diff(np.concatenate([self._accounted[-1:], block.time])))
        self._accounted = block.time[-1:]
        gone = np.zeros(len(block), dtype=bool)
        for name in block.channels:
            gone |= np.isnan(block[name])
        self._nan += int(gone.sum())
        if self._unchecked is not None:
            self._unchecked.append(block)
            if block.time[-1] - self._unchecked[0].time[0] >= CHECKED_S:
                check_magnitudes(Samples.concatenate(self._unchecked).columns)
                self._unchecked = None

    def _count_gaps(self, steps: Array) -> None:
        """Count missing rows and jumps; the first steps wait until they tell the period."""
        if np.isnan(self._period):
            self._early = steps = np.concatenate([self._early, steps])
            if steps.size < PERIOD_STEPS:
                return
            self._period, self._early = float(np.median(steps)), np.empty(0)
        missing = np.rint(steps[steps <= COUNTED_GAP] / self._period) - 1.0
        self._dropped += int(missing[missing > 0.0].sum())
        self._jumps += int((steps > JUMP_PERIODS * self._period).sum())

    def _count_malformed(self, count: int) -> None:
        self.malformed += count
        if self.malformed and not self._told_malformed:
            self._told_malformed = True
            self._remarks.append(
                "a line is malformed and was left out; further ones are counted "
                '(one JSON object a line is wanted, as in {"time": 0.001, "position": 0.01})'
            )

    def quality(self) -> Quality:
        """Counts and notes so far."""
        notes = [
            f"{text}: {count}"
            for count, text in (
                (self.malformed, "malformed lines left out"),
                (self._late, "late or repeated lines left out"),
                (self._not_finite, "infinite values taken as missing"),
                (self._resets, "times that the clock was set"),
            )
            if count
        ]
        if self._unknown:
            notes.append(f"passed over, no channels: {', '.join(k[:40] for k in self._unknown)}")
        return Quality(
            dropped_samples=self._dropped, nan_samples=self._nan, time_jumps=self._jumps, notes=notes
        )

    def remarks(self) -> list[str]:
        """Notes that are new since the last call."""
        out, self._remarks = self._remarks, []
        return out


def _number(value: Any) -> float:
    if value is None:
        return float("nan")
    try:
        return float(value)
    except OverflowError:  # an integer beyond any float
        return float("inf")


def _sources(channel_map: ChannelMap | None) -> dict[str, ChannelSource]:
    if channel_map is None:
        return {n: ChannelSource(column=n) for n in CHANNELS}
    out: dict[str, ChannelSource] = {}
    for name, source in channel_map.channels.items():
        if source.from_ is not None:
            continue  # the pipeline accumulates the pump's speed itself
        angle = CHANNELS[name].dimension == "angle"
        if source.column is None or source.wrap is not None or (angle and source.sign_of is not None):
            raise InputError(
                f"channel {name}: a stream takes plain columns only (no topic, wrap or sign_of of an angle)",
                mend="name the key of the JSON lines: {column: KEY, unit: UNIT}",
            )
        out[name] = source
    if "time" not in out:
        raise InputError("channel map: no time channel", mend="add e.g. time: {column: t, unit: s}")
    return out
