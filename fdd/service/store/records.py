"""What the store holds of axes: their states, and quantities over minutes, hours and days."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
from numpy.typing import NDArray

from fdd.errors import InputError

_CODEC = pa.Codec("zstd", 1)
"""States halve, as with zlib in six times the time."""
SPANS_S = {"minute": 60.0, "hour": 3600.0, "day": 86400.0}
"""Level to its span; all begin at whole multiples of it (UTC)."""


@dataclass(frozen=True)
class Checkpoint:
    """The state of an axis, from which it goes on after a restart, at `time` (s of the stream's clock) and
    `wall` (Unix seconds). `sequence`: id of the last journal row whose block is in the state; `version`: of
    the state's form; `arrays`: the state, by names of whom it belongs to."""

    axis: str
    time: float
    wall: float
    sequence: int
    profile_sha256: str
    model_sha256: str
    version: str
    arrays: Mapping[str, NDArray[Any]]


def packed(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, str]:
    """What is stored of named arrays, and its SHA-256; NumPy's own archive takes ten times as long.

    Examples
    --------
    >>> unpacked(*packed({"a": np.array([[1.0, 2.0]]), "b": np.array([], dtype=np.uint8)}), where="fdd.db")
    {'a': array([[1., 2.]]), 'b': array([], dtype=uint8)}
    """
    head = orjson.dumps([(name, a.dtype.str, a.shape) for name, a in arrays.items()])
    body = b"".join([len(head).to_bytes(8, "little"), head, *(a.tobytes() for a in arrays.values())])
    small = len(body).to_bytes(8, "little") + _CODEC.compress(body, asbytes=True)
    return small, hashlib.sha256(small).hexdigest()


def unpacked(small: bytes, sha256: str, where: str) -> dict[str, NDArray[Any]]:
    """The arrays of what `packed` gave; raises InputError where it is damaged, or of another version."""
    mend = "the axis must start anew"
    if hashlib.sha256(small).hexdigest() != sha256:
        raise InputError("a checkpoint is damaged", where=where, mend=mend)
    try:
        body: bytes = _CODEC.decompress(small[8:], int.from_bytes(small[:8], "little"), asbytes=True)
        start = 8 + int.from_bytes(body[:8], "little")
        out: dict[str, NDArray[Any]] = {}
        for name, kind, shape in orjson.loads(body[8:start]):
            dtype, count = np.dtype(kind), int(np.prod(shape))
            out[name] = np.frombuffer(body, dtype, count, start).reshape(shape).copy()
            start += count * dtype.itemsize
    except (OSError, ValueError, TypeError, OverflowError, MemoryError):
        raise InputError("a checkpoint is of another version of fdd", where=where, mend=mend) from None
    return out


@dataclass(frozen=True)
class Rollup:
    """What a quantity was over a span, in SI: `n` values, `std` of all (divided by n, not n - 1) with what
    each errs by itself. `start_wall`: Unix seconds, any within the span; the store sets its beginning."""

    axis: str
    quantity: str
    start_wall: float
    n: int
    mean: float
    std: float
    min: float
    max: float

    def over(self, level: str) -> Rollup:
        """The same, of the span of a level that it belongs to.

        Examples
        --------
        >>> Rollup("A1", "leakage", 7325.0, 1, 2.0, 0.0, 2.0, 2.0).over("hour").start_wall
        7200.0
        """
        span = SPANS_S[level]
        return replace(self, start_wall=math.floor(self.start_wall / span) * span)

    def merged(self, other: Rollup) -> Rollup:
        """Both parts together, by Chan, Golub and LeVeque's update (1979), which loses no digits.

        Examples
        --------
        >>> one, two = (Rollup("A1", "leakage", 0.0, n, m, 0.0, m, m) for n, m in ((1, 2.0), (3, 6.0)))
        >>> both = one.merged(two); both.n, both.mean, round(both.std, 3)
        (4, 5.0, 1.732)
        """
        n, apart = self.n + other.n, other.mean - self.mean
        square = (self.n * self.std**2 + other.n * other.std**2 + apart**2 * (self.n * other.n / n)) / n
        return replace(
            self, n=n, mean=self.mean + apart * (other.n / n), std=math.sqrt(square),
            min=min(self.min, other.min), max=max(self.max, other.max),
        )  # fmt: skip
