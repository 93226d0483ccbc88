"""Long columns in stretches: what is counted row by row needs no second column for what lies between."""

from __future__ import annotations

from collections.abc import Iterator

STRETCH_ROWS = 1 << 16
"""Rows whose temporaries stay in the processor's cache."""


def stretches(rows: int, overlap: int = 1) -> Iterator[slice]:
    """Consecutive stretches of a column, each with the first rows of the next: all differences once.

    Parameters
    ----------
    rows : of the column. overlap : rows that two stretches share.

    Examples
    --------
    >>> [(s.start, s.stop) for s in stretches(65540)]
    [(0, 65537), (65536, 65540)]
    """
    for start in range(0, max(rows - overlap, 0), STRETCH_ROWS):
        yield slice(start, min(start + STRETCH_ROWS + overlap, rows))
