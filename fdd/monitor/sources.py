"""Where live samples come from: a log replayed at some speed, or JSON lines on a stream.

A source is an iterator of blocks of `Samples`; an empty block means that nothing came for a
while, so that the monitor can look after its display and its stop signal. The findings do not
depend on how a source cuts its blocks.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np

from fdd.bounds import MOST_PENDING
from fdd.diagnosis.findings import Quality
from fdd.errors import InputError
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
    """A whole log, block by block, at the speed it was recorded or another.

    Parameters
    ----------
    samples, quality : of the log.
    speed : times real time; None is as fast as the machine can.
    clock : what it waits with.
    """

    def __init__(self, samples: Samples, quality: Quality, *, speed: float | None, clock: WallClock) -> None:
        self.samples = samples
        self._quality, self._speed, self._clock = quality, speed, clock

    def __iter__(self) -> Iterator[Samples]:
        if self._speed is None:
            yield from self.samples.blocks(REPLAY_ROWS)
            return
        started = self._clock.now()
        for part in pieces(self.samples):
            due = started + float(part.time[-1] - self.samples.time[0]) / self._speed
            # A long hole in the log is waited through in steps, so that the display stays alive.
            while (wait := due - self._clock.now()) > 2.0 * BLOCK_S:
                self._clock.sleep(BLOCK_S)
                yield self.samples.rows(0, 0)
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

    The stream is read in a thread of its own, so that a silent machine does not hold the
    monitor up; a monitor that cannot keep up makes the writer wait.

    Parameters
    ----------
    read : gives at most that many bytes as soon as there are any; empty at the end.
    parser : turns lines into samples.
    clock : tells when a block is due.
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
            while True:
                chunk = self._read(READ_BYTES)
                self._chunks.put(chunk)
                if not chunk:
                    return
        except BaseException as error:  # handed over to the thread that iterates
            self._chunks.put(error)
