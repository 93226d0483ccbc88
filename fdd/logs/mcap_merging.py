"""Messages of several topics into one MCAP file, merged by time, however they come in blocks.

Times are ns; chunks of 1 MiB, zstd, with checksums and indexes. What is held back is only what a slower
topic may still have to come before.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from fdd import __version__
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.logs.json_rows import Columns, json_rows, json_schema
from fdd.samples import CHANNELS

CHUNK_BYTES = 1 << 20
LIBRARY = f"fdd {__version__}"
MOST_HELD = 2_000_000
"""Messages that wait for a slower topic; beyond that its source has stopped."""
_AXIS = re.compile(r"[A-Za-z0-9_.\-]{1,64}")
_END = np.iinfo(np.int64).max
_UNITS = {c.name: f"{c.unit}: {c.meaning}" for c in CHANNELS.values()}


def require_axis(axis: str) -> None:
    """Refuse a name that cannot stand in a topic.

    Raises
    ------
    InputError : it has other characters than letters, digits, _ . and -.

    Examples
    --------
    >>> require_axis("axis_a")
    """
    if not _AXIS.fullmatch(axis):
        raise InputError(f"axis {axis[:70]!r} cannot stand in a topic", mend="use letters, digits, _ . and -")


def nanoseconds(time: NDArray[np.float64], start_ns: int) -> NDArray[np.int64]:
    """Log times of (n,) seconds.

    Raises
    ------
    InputError : one is negative, which MCAP cannot hold.

    Examples
    --------
    >>> nanoseconds(np.array([0.001]), 5)
    array([1000005])
    """
    stamps = start_ns + np.rint(np.asarray(time, dtype=np.float64) * 1e9).astype(np.int64)
    if stamps.size and stamps.min() < 0:
        raise InputError(
            f"time starts at {float(np.min(time)):.3f} s, MCAP has no negative times", mend="give a start_ns"
        )
    return np.asarray(stamps, dtype=np.int64)


@dataclass(frozen=True)
class Messages:
    """Messages with texts of their own: topic, schema's name and text, (n,) ns, n UTF-8 objects."""

    name: str
    title: str
    schema: bytes
    stamps: NDArray[np.int64]
    texts: list[bytes]


@dataclass
class _Queue:
    """One topic: what waits of it, and up to when it is known."""

    channel: int
    name: str
    members: tuple[str, ...]
    known: int = -1
    waiting: list[tuple[NDArray[np.int64], list[bytes]]] = field(default_factory=list)


class MergedWriter:
    """Topics of JSON messages in one file, in the order of their times.

    Messages of equal time stand in the order in which their topics were added; those of one topic in the
    order in which they came. So the file does not depend on the blocks.

    Parameters
    ----------
    stream : open for writing bytes.
    metadata : records, name to texts. They come first: a file that is cut off later still tells what it was.

    Examples
    --------
    >>> import io
    >>> file = io.BytesIO()
    >>> writer = MergedWriter(file, {})
    >>> topic = writer.topic("/a", "A", {"time": np.zeros(1)})
    >>> writer.push(topic, np.array([5]), {"time": np.zeros(1)})
    >>> writer.finish()
    >>> file.getvalue()[:5]
    b'\\x89MCAP'
    """

    def __init__(self, stream: IO[bytes], metadata: Mapping[str, Mapping[str, str]]) -> None:
        from mcap.writer import CompressionType, Writer

        self._writer = Writer(
            stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_crcs=True
        )
        self._writer.start(profile="", library=LIBRARY)
        for name, values in metadata.items():
            self._writer.add_metadata(name, dict(values))
        self._queues: list[_Queue] = []
        self.most_held = MOST_HELD

    def topic(self, name: str, title: str, columns: Columns, schema: bytes | None = None) -> int:
        """Add a topic whose messages have these columns (or that `schema`); its number for `push`."""
        text = json_schema(columns, title, _UNITS) if schema is None else schema
        number = self._writer.register_schema(title, "jsonschema", text)
        channel = self._writer.register_channel(name, "json", number)
        self._queues.append(_Queue(channel, name, tuple(columns)))
        return len(self._queues) - 1

    def push(self, topic: int, stamps: NDArray[np.int64], columns: Columns, *, last: bool = False) -> None:
        """Messages of a topic, not before those that it had already.

        Parameters
        ----------
        topic : as `topic` gave it. stamps : (n,) ns. columns : each (n,), or a mapping of such.
        last : nothing more will come of this topic.

        Raises
        ------
        InputError : other columns than the topic's, or times that go back.
        """
        queue = self._queues[topic]
        if tuple(columns) != queue.members:
            raise InputError(
                f"{queue.name}: a block has the columns {', '.join(columns)}, "
                f"the ones before {', '.join(queue.members)}",
                mend="give all blocks the same columns",
            )
        self.push_texts(topic, stamps, json_rows(columns) if stamps.size else [], last=last)

    def push_texts(
        self, topic: int, stamps: NDArray[np.int64], texts: list[bytes], *, last: bool = False
    ) -> None:
        """As `push`, with the messages' own texts."""
        queue = self._queues[topic]
        if len(texts) != stamps.size:
            raise InputError(f"{queue.name}: {len(texts)} rows for {stamps.size} time stamps")
        if stamps.size:
            if int(stamps.min()) < queue.known:
                raise InputError(
                    f"{queue.name}: a block begins at {int(stamps.min()) * 1e-9:.6f} s, the one before ended "
                    f"at {queue.known * 1e-9:.6f} s",
                    mend="give the blocks in the order of time",
                )
            queue.waiting.append((stamps, texts))
            queue.known = int(stamps.max())
        if last:
            queue.known = _END

    def drain(self) -> None:
        """Write what no topic can have anything before."""
        self._write_before(min((q.known for q in self._queues), default=-1))
        held = sum(s.size for q in self._queues for s, _ in q.waiting)
        if held > self.most_held:
            slow = min(self._queues, key=lambda q: q.known).name
            raise InputError(
                f"{slow} is {held} messages behind the other topics",
                mend="give the blocks of all axes in turn",
            )

    def finish(self) -> None:
        """Write the rest, and the indexes."""
        self._write_before(_END)
        self._writer.finish()

    def _write_before(self, end: int) -> None:
        stamps: list[NDArray[np.int64]] = []
        channels: list[NDArray[np.int64]] = []
        texts: list[bytes] = []
        for queue in self._queues:
            rest: list[tuple[NDArray[np.int64], list[bytes]]] = []
            for times, rows in queue.waiting:
                ready = times < end
                count = int(ready.sum())
                if count < times.size:
                    rest.append((times[~ready], [r for r, go in zip(rows, ready, strict=True) if not go]))
                    rows = [r for r, go in zip(rows, ready, strict=True) if go]
                if count:
                    stamps.append(times[ready])
                    channels.append(np.full(count, queue.channel))
                    texts += rows
            queue.waiting = rest
        if not texts:
            return
        joined, numbers = np.concatenate(stamps), np.concatenate(channels)
        order = np.argsort(joined, kind="stable")
        add = self._writer.add_message
        for row, stamp, channel in zip(
            order.tolist(), joined[order].tolist(), numbers[order].tolist(), strict=True
        ):
            add(channel, stamp, texts[row], stamp)


@contextmanager
def merged_file(path: str | Path, metadata: Mapping[str, Mapping[str, str]]) -> Iterator[MergedWriter]:
    """A file of merged topics, written whole or not at all; see `fdd.files.whole_file`.

    Examples
    --------
    >>> with merged_file("run.mcap", {}) as writer:  # doctest: +SKIP
    ...     ...
    """
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        writer = MergedWriter(stream, metadata)
        yield writer
        writer.finish()


def checked_columns(columns: Mapping[str, Any], n: int, what: str) -> dict[str, Any]:
    """Flat columns as arrays of n rows.

    Raises
    ------
    InputError : a column has another length.

    Examples
    --------
    >>> checked_columns({"leakage": [6e-12]}, 1, "truth")
    {'leakage': array([6.e-12])}
    """
    out = {name: np.asarray(values) for name, values in columns.items()}
    for name, values in out.items():
        if values.shape != (n,):
            raise InputError(f"{what} {name}: {values.size} values for {n} time stamps")
    return out


def in_turn(lengths: Sequence[int], size: int) -> Iterator[tuple[int, slice]]:
    """Slices of at most `size` rows of several columns of these lengths, those of equal share in turn.

    Examples
    --------
    >>> list(in_turn([3, 1], 2))
    [(0, slice(0, 2, None)), (1, slice(0, 1, None)), (0, slice(2, 4, None))]
    """
    blocks = max((-(-n // size) for n in lengths), default=0)
    for k in range(blocks):
        for which, n in enumerate(lengths):
            part = -(-n // blocks)
            if k * part < n:
                yield which, slice(k * part, (k + 1) * part)
