"""An axis's whole state, from which it goes on after a restart."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
from numpy.typing import NDArray

from fdd.errors import InputError

_CODEC = pa.Codec("zstd", 1)
"""States halve, as with zlib in six times the time."""


@dataclass(frozen=True)
class Checkpoint:
    """The state of an axis.

    Attributes
    ----------
    time : s of the stream's clock. wall : Unix seconds.
    sequence : id of the last journal row whose block is in the state.
    version : of the state's form. body : the state, packed by whom it belongs to.
    """

    axis: str
    time: float
    wall: float
    sequence: int
    profile_sha256: str
    model_sha256: str
    version: str
    body: bytes


def packed(body: bytes) -> tuple[bytes, str]:
    """What is stored of a state, and its SHA-256."""
    small = len(body).to_bytes(8, "little") + _CODEC.compress(body, asbytes=True)
    return small, hashlib.sha256(small).hexdigest()


def unpacked(small: bytes, sha256: str, where: str) -> bytes:
    """The state of what `packed` gave.

    Raises
    ------
    InputError : it is not what was stored, or was packed by another version.
    """
    if hashlib.sha256(small).hexdigest() != sha256:
        raise InputError("a checkpoint is damaged", where=where, mend="the axis must start anew")
    try:
        body: bytes = _CODEC.decompress(small[8:], int.from_bytes(small[:8], "little"), asbytes=True)
    except (OSError, ValueError, OverflowError, MemoryError):
        raise InputError(
            "a checkpoint is of another version of fdd", where=where, mend="the axis must start anew"
        ) from None
    return body


def joined(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Named arrays of numbers as one run of bytes; NumPy's own archive takes ten times as long.

    Examples
    --------
    >>> parted(joined({"a": np.array([[1.0, 2.0]]), "b": np.array([], dtype=np.uint8)}))
    {'a': array([[1., 2.]]), 'b': array([], dtype=uint8)}
    """
    head = orjson.dumps([(name, a.dtype.str, a.shape) for name, a in arrays.items()])
    return b"".join([len(head).to_bytes(8, "little"), head, *(a.tobytes() for a in arrays.values())])


def parted(body: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of what `joined` gave.

    Raises
    ------
    ValueError, TypeError : it is not that.
    """
    start = 8 + int.from_bytes(body[:8], "little")
    out: dict[str, NDArray[Any]] = {}
    for name, kind, shape in orjson.loads(body[8:start]):
        dtype, count = np.dtype(kind), int(np.prod(shape))
        out[name] = np.frombuffer(body, dtype, count, start).reshape(shape).copy()
        start += count * dtype.itemsize
    return out
