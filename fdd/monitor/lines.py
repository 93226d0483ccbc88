"""JSON lines to samples: what is malformed is counted, a clock that was set is followed."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MAX_LINE_BYTES
from fdd.diagnosis.findings import Quality
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.logs.quality import check_magnitudes
from fdd.logs.wire.messages import objects_at_once
from fdd.monitor.mapping import all_numbers, channels_in_si, column_of_rows, keys_of, stream_sources
from fdd.monitor.stream_clock import Gaps, StreamClock
from fdd.samples import Samples

Array = NDArray[np.float64]

CHECKED_S = 5.0
"""s of data after which the units of measure are checked once."""
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
    """Turn lines into samples, and remember what was odd.

    Parameters
    ----------
    channel_map : names and units of the lines' keys; the contract's names in SI without one.
        `wrap`, `sign_of` of an angle and topics need a whole log and are refused.

    Attributes
    ----------
    clock : of the stream. malformed : lines that were no JSON object with a time and numbers.

    Examples
    --------
    >>> parser = LineParser()
    >>> parser.samples([b'{"time": 0.5, "position": 0.01}', b'nonsense'])["position"].tolist()
    [0.01]
    >>> parser.malformed
    1
    """

    def __init__(self, channel_map: ChannelMap | None = None) -> None:
        self._sources = stream_sources(channel_map)
        if "time" not in self._sources:
            raise InputError("channel map: no time channel", mend="add e.g. time: {column: t, unit: s}")
        self._keys = keys_of(self._sources)
        self.malformed = 0
        self.clock, self._gaps = StreamClock(), Gaps()
        self._not_finite = self._nan = 0
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
        columns = channels_in_si(self._sources, lambda key: column_of_rows(rows, key))
        if "time" not in columns:
            self._count_malformed(len(rows))
            return Samples([], {})
        time = columns.pop("time")
        stamped = np.isfinite(time)
        self._count_malformed(int((~stamped).sum()))
        time, columns = time[stamped], {n: v[stamped] for n, v in columns.items()}
        time, kept = self.clock.follow(time)
        block = Samples(time[kept], {n: self._finite(v[kept]) for n, v in columns.items()})
        self._account(block)
        return block

    def _objects(self, lines: list[bytes]) -> list[dict[str, Any]]:
        found = objects_at_once(lines)
        if found is None:
            found = []
            for line in lines:
                try:
                    one = json.loads(line)
                except (ValueError, RecursionError):
                    one = None
                if isinstance(one, dict):
                    found.append(one)
                else:
                    self._count_malformed(1)
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
            stamps = {str(self._sources["time"].column): time} if time is not None else {}
            rows = [
                dict(zip((*stamps, *columns), row, strict=True))
                for row in zip(*stamps.values(), *columns.values(), strict=True)
            ]
        except (KeyError, TypeError, ValueError, AttributeError):
            rows = []
        if not rows or block["schema"] != "fdd.block/1":
            self._count_malformed(1)
            return []
        return rows

    def _usable(self, row: dict[str, Any]) -> bool:
        """Whether all that is read of a line are numbers; also collects names that nobody knows."""
        for key in row:
            if key not in self._keys and len(self._unknown) < MOST_NAMES and key not in self._unknown:
                self._unknown[key] = None
                self._remarks.append(f"{key[:40]!r} is no channel and is passed over")
        usable = all_numbers(row, self._keys)
        self._count_malformed(int(not usable))
        return usable

    def _finite(self, values: Array) -> Array:
        infinite = np.isinf(values)
        self._not_finite += int(infinite.sum())
        return np.where(infinite, np.nan, values)

    def _account(self, block: Samples) -> None:
        if not len(block):
            return
        self._gaps.count(block.time)
        gone = np.zeros(len(block), dtype=bool)
        for name in block.channels:
            gone |= np.isnan(block[name])
        self._nan += int(gone.sum())
        if self._unchecked is not None:
            self._unchecked.append(block)
            if block.time[-1] - self._unchecked[0].time[0] >= CHECKED_S:
                check_magnitudes(Samples.concatenate(self._unchecked).columns)
                self._unchecked = None

    def _count_malformed(self, count: int) -> None:
        self.malformed += count
        if self.malformed and not self._told_malformed:
            self._told_malformed = True
            self._remarks.append(
                "a line is malformed and was left out; further ones are counted "
                '(one JSON object a line is wanted, as in {"time": 0.001, "position": 0.01}, or a block)'
            )

    def quality(self) -> Quality:
        """Counts and notes so far."""
        notes = [
            f"{text}: {count}"
            for count, text in (
                (self.malformed, "malformed lines left out"),
                (self.clock.late, "late or repeated lines left out"),
                (self._not_finite, "infinite values taken as missing"),
                (self.clock.resets, "times that the clock was set"),
            )
            if count
        ]
        if self._unknown:
            notes.append(f"passed over, no channels: {', '.join(k[:40] for k in self._unknown)}")
        return Quality(
            dropped_samples=self._gaps.dropped,
            nan_samples=self._nan,
            time_jumps=self._gaps.jumps,
            notes=notes,
        )

    def remarks(self) -> list[str]:
        """Notes that are new since the last call."""
        out, self._remarks = self._remarks + self.clock.remarks(), []
        return out
