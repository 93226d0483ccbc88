"""JSON lines to samples in SI: what is malformed is counted, a clock that was set is followed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_LINE_BYTES
from fdd.diagnosis.findings import Quality
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.conversion import to_si
from fdd.logs.formats.messages import objects_at_once
from fdd.logs.quality import check_magnitudes
from fdd.monitor.stream_clock import Gaps, StreamClock
from fdd.samples import CHANNELS, Samples

Array = NDArray[np.float64]

CHECKED_S = 5.0
"""s of data after which the units of measure are checked once."""
MOST_NAMES = 8


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


def split_lines(tail: bytes, chunk: bytes, ended: bool) -> tuple[list[bytes], bytes, int]:
    """Whole lines of the last call's rest and what came, the new rest, and how many were dropped as too long.

    Examples
    --------
    >>> split_lines(b'{"a"', b': 1}\\n{"a": 2', False)
    ([b'{"a": 1}'], b'{"a": 2', 0)
    """
    first, *more = chunk.split(b"\n")
    # Of a line without end no more is copied than tells that it is too long.
    *whole, rest = [tail if len(tail) > MAX_LINE_BYTES else tail + first, *more]
    if ended:
        whole, rest = [*whole, rest], b""
    overlong = sum(len(line) > MAX_LINE_BYTES for line in whole)
    lines = [line for line in whole if len(line) <= MAX_LINE_BYTES and line.strip()]
    # One byte more than allowed is kept of a line without end: it stays overlong, and small.
    return lines, rest[: MAX_LINE_BYTES + 1], overlong


class LineParser:
    """Turn lines into samples, by a channel map as `StreamMap` takes it, and remember what was odd:
    `malformed` lines were no JSON object with a time and numbers.

    Examples
    --------
    >>> parser = LineParser()
    >>> parser.samples([b'{"time": 0.5, "position": 0.01}', b'nonsense'])["position"].tolist()
    [0.01]
    >>> parser.malformed
    1
    """

    def __init__(self, channel_map: ChannelMap | None = None) -> None:
        self._map = StreamMap(channel_map)
        if channel_map is not None and "time" not in channel_map.channels:
            raise InputError("channel map: no time channel", mend="add e.g. time: {column: t, unit: s}")
        self.malformed = 0
        self.clock, self._gaps = StreamClock(), Gaps()
        self._not_finite = self._nan = 0
        self._unknown: list[str] = []
        self._remarks: list[str] = []
        self._unchecked: list[Samples] | None = []
        self._told_malformed = False

    def samples(self, lines: list[bytes]) -> Samples:
        """The block that these lines hold, perhaps empty.

        Raises InputError: the first seconds show that a channel is in another unit of measure.
        """
        rows = [r for r in self._objects(lines) if self._usable(r)]
        columns = self._map.of_rows(rows)
        time = columns.pop("time", np.full(len(rows), np.nan))
        stamped = np.isfinite(time)
        self.malformed += int((~stamped).sum())
        time, columns = time[stamped], {n: v[stamped] for n, v in columns.items()}
        time, kept = self.clock.follow(time)
        infinite = {n: np.isinf(v[kept]) for n, v in columns.items()}
        self._not_finite += int(sum(bad.sum() for bad in infinite.values()))
        columns = {n: np.where(infinite[n], np.nan, v[kept]) for n, v in columns.items()}
        block = Samples(time[kept], columns)
        if len(block):
            self._gaps.count(block.time)
            self._nan += int(np.isnan(list(columns.values())).any(axis=0).sum()) if columns else 0
            self._check_units(block)
        return block

    def _objects(self, lines: list[bytes]) -> list[dict[str, Any]]:
        found = objects_at_once(lines)
        if found is None:
            found = [one for line in lines for one in objects_at_once([line]) or ()]
            self.malformed += len(lines) - len(found)
        return [row for one in found for row in (self._rows_of(one) if "schema" in one else (one,))]

    def _rows_of(self, block: dict[str, Any]) -> list[dict[str, Any]]:
        """The samples of a block as `fdd serve` takes it (docs/serve-blocks.md), one object each."""
        time: Any = block.get("time")
        columns: Any = block.get("columns")
        try:
            if isinstance(time, dict):
                start, period, n = (time[key] for key in ("start", "period", "n"))
                # No more stamps than values, whatever n says: one too many refuses the block.
                most = max(map(len, columns.values()), default=0) + 1
                time = [start + period * k for k in range(min(n, most))]
            stamps = {str(self._map.sources["time"].column): time} if time is not None else {}
            rows = [
                dict(zip((*stamps, *columns), row, strict=True))
                for row in zip(*stamps.values(), *columns.values(), strict=True)
            ]
        except (KeyError, TypeError, ValueError, AttributeError):
            rows = []
        if not rows or block["schema"] != "fdd.block/1":
            self.malformed += 1
            return []
        return rows

    def _usable(self, row: dict[str, Any]) -> bool:
        """Whether all that is read of a line are numbers; also collects names that nobody knows."""
        for key in row:
            if key not in self._map.keys and len(self._unknown) < MOST_NAMES and key not in self._unknown:
                self._unknown.append(key)
                self._remarks.append(f"{key[:40]!r} is no channel and is passed over")
        usable = self._map.are_numbers(row)
        self.malformed += not usable
        return usable

    def _check_units(self, block: Samples) -> None:
        if self._unchecked is not None:
            self._unchecked.append(block)
            if block.time[-1] - self._unchecked[0].time[0] >= CHECKED_S:
                check_magnitudes(Samples.concatenate(self._unchecked).columns)
                self._unchecked = None

    def quality(self) -> Quality:
        """Counts and notes so far."""
        odd = {
            "malformed lines left out": self.malformed,
            "late or repeated lines left out": self.clock.late,
            "infinite values taken as missing": self._not_finite,
            "times that the clock was set": self.clock.resets,
        }
        notes = [f"{text}: {count}" for text, count in odd.items() if count]
        if self._unknown:
            notes.append(f"passed over, no channels: {', '.join(k[:40] for k in self._unknown)}")
        gaps = self._gaps
        return Quality(
            dropped_samples=gaps.dropped, nan_samples=self._nan, time_jumps=gaps.jumps, notes=notes
        )

    def remarks(self) -> list[str]:
        """Notes that are new since the last call."""
        if self.malformed and not self._told_malformed:
            self._told_malformed = True
            self._remarks.append(
                "a line is malformed and was left out; further ones are counted "
                '(one JSON object a line is wanted, as in {"time": 0.001, "position": 0.01}, or a block)'
            )
        out, self._remarks = self._remarks + self.clock.remarks(), []
        return out
