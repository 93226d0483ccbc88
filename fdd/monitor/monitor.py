"""Where live samples come from, a log replayed or JSON lines on a stream, and the loop that diagnoses them.

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

import numpy as np

from fdd.bounds import MOST_PENDING
from fdd.diagnosis.findings import Diagnosis, Estimate, FaultFinding, Quality
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.identification.log_scales import StreamScales
from fdd.monitor.lines import LineParser, split_lines
from fdd.samples import Samples

BLOCK_S = 0.1
REPLAY_ROWS = 50_000
READ_BYTES = 1 << 16


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
