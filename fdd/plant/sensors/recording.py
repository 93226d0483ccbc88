"""How the log is taken: late, missing and blank rows, drawn row by row whatever the blocks."""

from __future__ import annotations

import zlib
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from fdd.errors import InputError
from fdd.plant import PERIOD, Array, Validated
from fdd.samples import CHANNELS, missing_required

SHORTEST_BURST, LONGEST_BURST = 5, 30
MOST_CHANNELS = 4


def generator(seed: int, purpose: str, *indices: int) -> np.random.Generator:
    """A random stream of its own for each purpose, so that one more draw here changes nothing there."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(purpose.encode()), *indices]))


class Recording(Validated):
    """How the log is taken.

    Attributes
    ----------
    dropped : probability that a row is missing.
    late : probability that a row is taken late; its stamp says so.
    latest : s, most that it is late.
    jitter : s, standard deviation of the stamps' error: the row is taken on time, its stamp is a little off.
    nan_bursts_per_minute : bursts of NaN, 5 to 30 rows long, each in one to four channels.
    load_force : whether the load is measured.
    rate : Hz of the log. Below 1000 it keeps every second or fifth of the rows that are taken each
        millisecond, at 2000 two are taken; controller and faults go on once a millisecond.
    speed : how pump speed is had: ``counts`` of the angle's encoder since the millisecond before, or a
        drive's own reading, ``sampled`` with the errors of the unit's sensor.
    channels : those that the log has; None for all.
    """

    dropped: Annotated[float, Field(ge=0.0, le=0.5)] = 0.001
    late: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0005
    latest: Annotated[float, Field(ge=0.0, le=0.9e-3)] = 0.9e-3
    jitter: Annotated[float, Field(ge=0.0, le=1e-5)] = 0.0
    nan_bursts_per_minute: Annotated[float, Field(ge=0.0, le=60.0)] = 0.2
    load_force: bool = False
    rate: Literal[200, 500, 1000, 2000] = 1000
    speed: Literal["counts", "sampled"] = "counts"
    channels: tuple[str, ...] | None = None

    @model_validator(mode="after")
    def _enough(self) -> Recording:
        where = "recording channels"
        for name in self.channels or ():
            if name not in CHANNELS or name == "time":
                raise InputError(f"unknown channel {name!r}", where=where)
        if self.channels is not None and (absent := missing_required(self.channels)):
            raise InputError(f"no diagnosis without {', '.join(absent)}", where=where, mend="add these")
        return self

    @property
    def each(self) -> int:
        """Rows taken each millisecond."""
        return max(self.rate // 1000, 1)

    @property
    def period(self) -> float:
        """s, between rows that are taken."""
        return PERIOD / self.each

    @property
    def keeps_every(self) -> int:
        """Rows taken for each that the log keeps."""
        return max(1000 // self.rate, 1)

    def has(self, channel: str) -> bool:
        """Whether the log has that channel, where it is measured at all."""
        return self.channels is None or channel in self.channels

    @classmethod
    def perfect(cls) -> Recording:
        """Every row, on time, whole."""
        return cls(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0)


class Lateness:
    """By how many of the `substeps` of a row each row is taken late; the first is on time."""

    def __init__(self, recording: Recording, substeps: int, seed: int) -> None:
        self.share = recording.late
        self.most = min(int(recording.latest * substeps / PERIOD + 1e-9), substeps - 1)
        self._rng = generator(seed, "late rows")
        self._first = True

    def steps(self, n: int) -> NDArray[np.int64]:
        """Of the next n rows, (n,), each 0 to `most`."""
        late = np.zeros(n, dtype=np.int64)
        if self.share > 0.0 and self.most > 0:
            # One draw a row: below the share it is late, and by how much within the share says by how many.
            drawn = self._rng.random(n)
            rows = np.flatnonzero(drawn < self.share)
            late[rows] = 1 + (drawn[rows] / self.share * self.most).astype(np.int64)
            np.minimum(late, self.most, out=late)
        if self._first and n:
            late[0], self._first = 0, False
        return late


class NanBursts:
    """Bursts of NaN in the channels `names`: a Poisson process over the rows, one for each `stream`."""

    def __init__(self, recording: Recording, seed: int, names: list[str], stream: str = "") -> None:
        self.names = names
        self._rng = generator(seed, f"NaN bursts{stream}")
        rate = recording.nan_bursts_per_minute * recording.period / 60.0
        self._gap = 1.0 / rate if rate > 0.0 else np.inf
        self._row, self._next = 0, self._rng.exponential(self._gap)
        self._open: list[tuple[int, int, list[str]]] = []

    def blank(self, columns: dict[str, Array], n: int) -> None:
        """Put NaN into the next n rows of `columns` (each (n,)), in place."""
        end = self._row + n
        while self._next < end:
            start = int(self._next)
            stop = start + int(self._rng.integers(SHORTEST_BURST, LONGEST_BURST + 1))
            struck = self._rng.permutation(len(self.names))[: int(self._rng.integers(1, MOST_CHANNELS + 1))]
            self._open.append((start, stop, [self.names[k] for k in struck]))
            self._next += self._rng.exponential(self._gap)
        for start, stop, names in self._open:
            rows = slice(max(start - self._row, 0), stop - self._row)
            for name in names:
                columns[name][rows] = np.nan
        self._row = end
        self._open = [burst for burst in self._open if burst[1] > end]
