"""Numbers in bytes, for the compiled walks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.logs.wire.compiled import njit

FLOAT, INT, UINT, ZIGZAG = range(4)
"""Kinds of numbers; the last one is Protobuf's sint."""


def cells() -> tuple[NDArray[np.uint64], NDArray[np.float64], NDArray[np.float32]]:
    """Room for eight bytes that `number` reads as one of two floats: compiled code cannot view a number."""
    bits = np.zeros(1, np.uint64)
    return bits, bits.view(np.float64), bits.view(np.float32)


@njit()
def bits_of(data, at, size, big):  # type: ignore[no-untyped-def]
    """The `size` bytes from `at` on as an integer; `big`: the highest first."""
    value = np.uint64(0)
    for b in range(size):
        place = size - 1 - b if big else b
        value |= np.uint64(data[at + b]) << np.uint64(8 * place)
    return value


@njit()
def number(bits, size, kind, room):  # type: ignore[no-untyped-def]
    """What bits of `size` bytes mean as a number of this kind; `room`: `cells`."""
    if kind == FLOAT:
        room[0][0] = bits
        return room[1][0] if size == 8 else np.float64(room[2][0])
    if kind == INT:
        return np.float64(np.int64(bits << np.uint64(64 - 8 * size)) >> (64 - 8 * size))
    if kind == ZIGZAG:
        half = np.int64(bits >> np.uint64(1))
        return np.float64(-half - 1 if bits & np.uint64(1) else half)
    return np.float64(bits)
