"""Numbers of rows on the grid of their nominal period."""

from __future__ import annotations

import numpy as np

from fdd.logs.wire.compiled import njit

_KEPT = 0.99
"""Share of what rounding left over that the next row takes up: a late stamp is made good by the row after it,
and a clock that runs a little faster than its nominal rate gains no rows."""


@njit(error_model="numpy")
def grid_numbers(time, period):  # type: ignore[no-untyped-def]
    """Whole numbers that add up to the steps of time in periods, and grow from row to row.

    Parameters
    ----------
    time : (n,) s, one row or more. period : s, nominal.

    Returns
    -------
    (n,) integers.
    """
    numbers = np.empty(time.size, np.int64)
    numbers[0], rest = 0, 0.0
    for k in range(time.size - 1):
        wanted = (time[k + 1] - time[k]) / period + rest
        whole = np.floor(wanted + 0.5)
        rest = _KEPT * (wanted - whole)
        numbers[k + 1] = numbers[k] + np.int64(whole)
    # A late row shares its number with the next one: step back to make room for it.
    slack = numbers[-1] - (time.size - 1)
    for k in range(time.size - 1, -1, -1):
        slack = min(slack, numbers[k] - k)
        numbers[k] = slack + k
    return numbers
