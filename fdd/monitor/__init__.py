"""Live diagnosis of one axis: a log replayed or JSON lines on a stream, and the loop that diagnoses them.

A source is an iterator of blocks of `Samples`; an empty block means that nothing came for a while, so that
the monitor can look after its display and its stop signal. Findings do not depend on how blocks are cut.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdd.bounds import MOST_PENDING
from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding, Quality
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.identification.log_scales import StreamScales
from fdd.logs.channel_map import ChannelMap
from fdd.logs.formats.messages import objects_at_once
from fdd.logs.quality import check_magnitudes
from fdd.monitor.stream import Gaps, StreamClock, StreamMap, split_lines
from fdd.samples import Samples

BLOCK_S = 0.1
REPLAY_ROWS = 50_000
READ_BYTES = 1 << 16
CHECKED_S = 5.0
"""s of data after which the units of measure are checked once."""
MOST_NAMES = 8


class WallClock:
    """The machine's monotonic clock; waiting ends at once when `stop` is set."""

    def __init__(self, stop: threading.Event) -> None:
        self._stop = stop

    def now(self) -> float:
        """Seconds since some instant."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait for `seconds`, or until the monitor is told to stop."""
        if seconds > 0.0:
            self._stop.wait(seconds)


def pieces(samples: Samples) -> Iterator[Samples]:
    """Blocks of `BLOCK_S`, as a rig sends them.

    Examples
    --------
    >>> [len(part) for part in pieces(Samples(np.arange(25) * 0.01, {}))]
    [10, 10, 5]
    """
    stamps, row = samples.time, 0
    while row < stamps.size:
        stop = max(int(np.searchsorted(stamps, stamps[row] + BLOCK_S)), row + 1)
        yield samples.rows(row, stop)
        row = stop


class Replay:
    """A whole log, block by block, at `speed` times real time; None is as fast as the machine can."""

    def __init__(self, samples: Samples, quality: Quality, *, speed: float | None, clock: WallClock) -> None:
        self._samples, self._quality, self._speed, self._clock = samples, quality, speed, clock

    def __iter__(self) -> Iterator[Samples]:
        if self._speed is None:
            yield from self._samples.blocks(REPLAY_ROWS)
            return
        started = self._clock.now()
        for part in pieces(self._samples):
            due = started + float(part.time[-1] - self._samples.time[0]) / self._speed
            # A long hole in the log is waited through in steps, so that the display stays alive.
            while (wait := due - self._clock.now()) > 2.0 * BLOCK_S:
                self._clock.sleep(BLOCK_S)
                yield self._samples.rows(0, 0)
            self._clock.sleep(wait)
            yield part

    def quality(self) -> Quality:
        """What the reader noted about the log."""
        return self._quality

    def remarks(self) -> list[str]:
        """None: the reader has told all."""
        return []


class LineParser:
    """Turn lines into samples, by a channel map as `StreamMap` takes it, and remember what was odd:
    `malformed` lines were no JSON object with a time and numbers.
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
        """The block of these lines, perhaps empty. Raises InputError: another unit of measure by its size."""
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
        dropped, jumps = self._gaps.dropped, self._gaps.jumps
        return Quality(dropped_samples=dropped, nan_samples=self._nan, time_jumps=jumps, notes=notes)

    def remarks(self) -> list[str]:
        """Notes that are new since the last call."""
        if self.malformed and not self._told_malformed:
            self._told_malformed = True
            wanted = 'one JSON object a line is wanted, as in {"time": 0.001, "position": 0.01}, or a block'
            told = "a line is malformed and was left out; further ones are counted"
            self._remarks.append(f"{told} ({wanted})")
        out, self._remarks = self._remarks + self.clock.remarks(), []
        return out


class JsonLines:
    """JSON lines from a stream, one object a sample: ``{"time": 0.001, "position": 0.01, …}``, or a block.

    A thread of its own reads the stream, so that a silent machine does not hold the monitor up; a monitor
    that cannot keep up makes the writer wait. `read` gives at most that many bytes as soon as there are any,
    none at the end.
    """

    def __init__(self, read: Callable[[int], bytes], parser: LineParser, *, clock: WallClock) -> None:
        self._read, self._parser, self._clock = read, parser, clock
        self.quality, self.remarks = parser.quality, parser.remarks
        self._chunks: queue.Queue[bytes | BaseException] = queue.Queue(maxsize=64)

    def __iter__(self) -> Iterator[Samples]:
        threading.Thread(target=self._pump, daemon=True, name="fdd-stream").start()
        pending: list[bytes] = []
        tail, since, ended = b"", self._clock.now(), False
        while not ended:
            try:
                chunk = self._chunks.get(timeout=BLOCK_S)
            except queue.Empty:
                chunk = None
            if isinstance(chunk, BaseException):
                raise chunk
            if chunk is not None:
                ended = not chunk
                if not pending:
                    since = self._clock.now()
                lines, tail, overlong = split_lines(tail, chunk, ended)
                self._parser.malformed += overlong
                pending += lines
            due = self._clock.now() - since >= BLOCK_S or len(pending) >= MOST_PENDING
            if chunk is None or ended or (pending and due):
                yield self._parser.samples(pending)
                pending = []
        if np.isnan(self._parser.clock.last_time):
            raise InputError("no samples came", mend='send lines such as {"time": 0.001, "position": 0.01}')

    def _pump(self) -> None:
        try:
            while chunk := self._read(READ_BYTES):
                self._chunks.put(chunk)
            self._chunks.put(b"")
        except BaseException as error:  # handed over to the thread that iterates
            self._chunks.put(error)


@dataclass(frozen=True)
class Found:
    """A fault was detected at `time` (s of the stream)."""

    time: float
    finding: FaultFinding


@dataclass(frozen=True)
class Noted:
    """Something odd about the stream."""

    time: float
    text: str


@dataclass(frozen=True)
class Status:
    """How things stand: families' probabilities and the latest estimates."""

    time: float
    verdict: str
    probabilities: dict[str, float] = field(default_factory=dict)
    estimates: dict[str, Estimate] = field(default_factory=dict)


Event = Found | Noted | Status


def watch(
    source: JsonLines | Replay, pipeline: Pipeline, emit: Callable[[Event], None], *, clock: WallClock,
    stopped: Callable[[], bool] = lambda: False, duration: float | None = None,
    status_every: float | None = None, scales: StreamScales | None = None,
) -> Diagnosis:  # fmt: skip
    """Diagnose what a source gives until it ends, or until told to stop; the answer on everything seen.

    The pipeline is made with ``keep_trajectories=False``, else its memory grows for ever. `stopped` is asked
    after each block. `duration`: s of the stream after which to end; None goes on. `status_every`: s between
    `Status` events; None gives none. `scales` holds the stream against its profile.

    Raises InputError: channels that do not suffice, or are in another unit of measure.
    """
    first = last = math.nan
    status_due = clock.now()
    for block in source:
        for text in source.remarks():
            emit(Noted(last, text))
        if len(block):
            first = float(block.time[0]) if math.isnan(first) else first
            if duration is not None:
                # A stamp at the end itself still belongs to the span, whatever its last digit.
                block = block.rows(0, int((block.time <= first + duration + 1e-9).sum()))
        if len(block):
            last = float(block.time[-1])
            for text in scales.push(block) if scales is not None else ():
                emit(Noted(last, text))
            for finding in pipeline.push(block):
                emit(Found(finding.detected_s, finding))
        if status_every is not None and (now := clock.now()) >= status_due and not math.isnan(last):
            status_due = now + status_every
            told = pipeline.finish()
            emit(Status(last, told.verdict, told.probabilities, told.estimates))
        if stopped() or (duration is not None and last - first >= duration - 1e-9):
            break
    for text in source.remarks():
        emit(Noted(last, text))
    return pipeline.finish(source.quality())
