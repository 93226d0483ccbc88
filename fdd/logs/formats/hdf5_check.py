"""Heaps of an HDF5 file that would let the library search without end."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from fdd.errors import InputError

_MARK = b"GCOL\x01\0\0\0"
"""Of a global heap collection (HDF5 file format 3.0, III.E), where texts of variable length stand."""
_PIECE = 1 << 20
_LARGEST = 1 << 32
"""Bytes of a heap that are looked at; the library's have 4096."""


def check_hdf5(path: Path) -> None:
    """Refuse a file with a heap whose free space has no size: the library takes it again and again.

    Raises
    ------
    InputError : names the byte.
    """
    with path.open("rb") as file:
        start, kept, end = 0, b"", 0
        while piece := file.read(_PIECE):
            after, text = file.tell(), kept + piece
            while (at := text.find(_MARK, max(end - start, 0))) >= 0:
                file.seek(start + at)
                found = _end_of_heap(file)
                if found is None:
                    raise InputError(
                        f"damaged HDF5 file (the heap at byte {start + at} has no end)",
                        where=path,
                        mend="copy it again",
                    )
                end = found
            file.seek(after)
            kept = text[1 - len(_MARK) :]
            start = after - len(kept)


def _end_of_heap(file: BinaryIO) -> int | None:
    """Byte after the objects of the heap at which the file stands; None where free space has no size."""
    left = min(int.from_bytes(file.read(16)[8:], "little"), _LARGEST) - 16
    while left >= 16 and len(about := file.read(16)) == 16:
        number, size = struct.unpack("<H6xQ", about)
        if number == 0:
            return None if size == 0 else file.tell()
        padded = -(-size // 8) * 8
        left -= 16 + padded
        if left >= 16:
            file.seek(padded, 1)
    return file.tell()
