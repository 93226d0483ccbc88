"""Fewer points, same picture: decimation that never loses a spike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.float64]

BUCKETS = 500
"""Buckets per signal: about one per pixel of a plot; those over the whole page have twice as many pixels."""
KEPT_PER_BUCKET = 6
"""First, last, lowest, highest, and the first and last missing value."""


def decimate(time: Column, values: Column, buckets: int = BUCKETS) -> tuple[Column, Column]:
    """Keep each bucket's first, lowest, highest and last value, and its gaps.

    The line drawn through what is kept covers the same pixels as the line
    through everything: M4 of Jugel et al., doi:10.14778/2732951.2732953, with
    missing values kept as breaks.

    Parameters
    ----------
    time : (n,) increasing. values : (n,), NaN where missing.
    buckets : of equal length; at most `KEPT_PER_BUCKET` points are kept of each, four where none is missing.

    Returns
    -------
    time, values : (k,) what is kept, in order; all of it where n is small already.

    Examples
    --------
    >>> t = np.arange(100_000) * 1e-3
    >>> x = np.zeros_like(t); x[4321] = 1.0
    >>> kept_t, kept_x = decimate(t, x, buckets=500)
    >>> kept_x.size <= 2000, kept_x.max(), round(float(kept_t[kept_x.argmax()]), 3)
    (True, np.float64(1.0), 4.321)
    """
    n = values.size
    if n <= 4 * buckets:
        return time, values
    size = -(-n // buckets)
    table = np.pad(values, (0, -n % size), constant_values=np.nan).reshape(-1, size)
    missing = np.isnan(table)
    start = np.arange(len(table)) * size
    # Padding must not count as a gap: the last bucket ends at the last sample.
    last_of = np.minimum(start + size, n) - 1
    real_gap = missing & (start[:, None] + np.arange(size) < n)
    has_gap = real_gap.any(axis=1)
    keep = np.zeros(n, dtype=bool)
    keep[start] = keep[last_of] = True
    keep[np.minimum(start + np.where(missing, np.inf, table).argmin(axis=1), last_of)] = True
    keep[np.minimum(start + np.where(missing, -np.inf, table).argmax(axis=1), last_of)] = True
    keep[(start + real_gap.argmax(axis=1))[has_gap]] = True
    keep[(start + size - 1 - real_gap[:, ::-1].argmax(axis=1))[has_gap]] = True
    return time[keep], values[keep]


def envelope(
    time: Column, low: Column, high: Column, buckets: int = BUCKETS
) -> tuple[Column, Column, Column]:
    """Bucket-wise outline of a band (n,), NaN where there is none: lowest `low` and highest `high` at the mid
    times of at most so many `buckets`; NaN where a bucket has no band at all."""
    n = time.size
    if n <= buckets:
        return time, low, high
    start = np.arange(0, n, -(-n // buckets))
    stop = np.append(start[1:], n) - 1
    missing = np.isnan(low) | np.isnan(high)
    lowest = np.minimum.reduceat(np.where(missing, np.inf, low), start)
    highest = np.maximum.reduceat(np.where(missing, -np.inf, high), start)
    empty = np.isinf(lowest) | np.isinf(highest)
    mid = 0.5 * (time[start] + time[stop])
    # The outline reaches to both ends of the log.
    mid[0], mid[-1] = time[0], time[-1]
    return mid, np.where(empty, np.nan, lowest), np.where(empty, np.nan, highest)


def bucket_means(values: NDArray[np.float64], buckets: int = BUCKETS) -> NDArray[np.float64]:
    """Means over buckets of consecutive rows: (m, k) to at most (buckets, k)."""
    m = values.shape[0]
    if m <= buckets:
        return values
    start = np.arange(0, m, -(-m // buckets))
    counts = np.diff(np.append(start, m)).astype(np.float64)
    return np.add.reduceat(values, start, axis=0) / counts.reshape(-1, *([1] * (values.ndim - 1)))


def break_at_gaps(time: Column, values: Column) -> tuple[Column, Column]:
    """Put a NaN into every hole in time, so that no line is drawn across dropped samples.

    A hole is longer than ten usual steps and long enough to be seen (1/500 of the log).
    """
    if time.size < 3:
        return time, values
    steps = np.diff(time)
    limit = max(10.0 * float(np.median(steps)), float(time[-1] - time[0]) / 500.0)
    holes = np.flatnonzero(steps > limit)
    if not holes.size:
        return time, values
    middle = 0.5 * (time[holes] + time[holes + 1])
    return np.insert(time, holes + 1, middle), np.insert(values, holes + 1, np.nan)


def intervals(time: Column, mask: NDArray[np.bool_], at_most: int = 150) -> list[tuple[float, float]]:
    """Stretches of `time` (n,) where `mask` (n,) holds, close neighbours joined until there are so few.

    Examples
    --------
    >>> intervals(np.arange(5.0), np.array([True, True, False, False, True]))
    [(0.0, 2.0), (4.0, 4.0)]
    """
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    begin, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not begin.size:
        return []
    starts, stops = time[begin], time[np.minimum(end, time.size - 1)]
    if starts.size > at_most:
        widths = starts[1:] - stops[:-1]
        widest = np.sort(np.argpartition(widths, -(at_most - 1))[-(at_most - 1) :])
        starts = np.concatenate((starts[:1], starts[widest + 1]))
        stops = np.concatenate((stops[widest], stops[-1:]))
    return [(float(a), float(b)) for a, b in zip(starts, stops, strict=True)]
