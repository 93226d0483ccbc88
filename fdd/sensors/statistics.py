"""Robust statistics of rows, compiled: ranks, the noise, and steps that their neighbours do not show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.compiled import njit

Array = NDArray[np.float64]

GAUSS_75, GAUSS_90 = 1.1503, 1.6449
"""Quantiles of the absolute value of a standard normal variable at 75 and 90 %."""
LEAST_VALUES = 8


@njit(nogil=True)
def smallest(values: Array, rank: int) -> float:
    """The value of this rank (0: least) among (n,) without NaN, which are put in another order.

    Hoare's selection: on what a frame has it takes half the time of NumPy's partition.
    """
    low, high = 0, values.size - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return float(values[rank])


@njit(nogil=True)
def place(values: Array, at: float) -> int:
    """How many of (n,) rising values lie before `at`.

    Numba's own search, differences and sums each bring the compiler's modules along when kept code is loaded.
    """
    low, high = 0, values.size
    while low < high:
        middle = (low + high) // 2
        if values[middle] < at:
            low = middle + 1
        else:
            high = middle
    return low


@njit(nogil=True)
def spread(values: Array) -> float:
    """Standard deviation of the rows' noise in (n,) without NaN; 0 of fewer than 8.

    From second differences, robust to jumps in up to a tenth of the rows. The larger of two quantiles, so
    that it is not 0 where values are rounded and mostly stand still, and covers a frame of which only a part
    is noisy.
    """
    if values.size < LEAST_VALUES:
        return 0.0
    second = np.empty(values.size - 2)
    for i in range(second.size):
        second[i] = abs((values[i + 2] - values[i + 1]) - (values[i + 1] - values[i]))
    at_75, at_90 = int(0.75 * (second.size - 1)), int(0.9 * (second.size - 1))
    high = smallest(second, at_90)
    return max(smallest(second[:at_90], at_75) / GAUSS_75, high / GAUSS_90) / np.sqrt(6.0)


@njit(nogil=True)
def widest(values: Array, reach: int) -> Array:
    """Largest of each of (n,) and the `reach` on either side; NaN where one of them is."""
    out = values.copy()
    for i in range(values.size):  # element by element: assigned slices compile for a second
        for k in range(max(i - reach, 0), min(i + reach + 1, values.size)):
            out[i] = np.maximum(out[i], values[k])
    return out


@njit(nogil=True)
def excess(time: Array, values: Array, stride: int = 1) -> Array:
    """What of each row's step is beyond its neighbours' rates, (n,) of (n,); 0 at the ends, NaN beside a NaN.

    Parameters
    ----------
    stride : rows that a step spans: 2 sees a jump that two rows share.

    Examples
    --------
    >>> excess(np.arange(6.0), np.array([0.0, 1.0, 2.0, 8.0, 9.0, 10.0])).tolist()
    [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]
    """
    out = np.zeros(values.size)
    if time.size < 4 * stride:
        return out
    # A late stamp makes one step of time long and the next too short to divide by.
    least = 0.5 * stride * (time[-1] - time[0]) / (time.size - 1)
    steps = np.maximum(time[stride:] - time[:-stride], least)
    rate = (values[stride:] - values[:-stride]) / steps
    for i in range(time.size - 3 * stride):
        earlier, middle, later = rate[i], rate[i + stride], rate[i + 2 * stride]
        within = min(max(middle, min(earlier, later)), max(earlier, later))
        known = not np.isnan(earlier + middle + later)
        out[i + 2 * stride] = (middle - within) * steps[i + stride] if known else np.nan
    return out
