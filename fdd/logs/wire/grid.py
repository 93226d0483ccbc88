"""Numbers of rows on the grid of their nominal period."""

from __future__ import annotations

import numpy as np

from fdd.logs.wire.compiled import njit

_KEPT = 0.99
"""Share of what rounding left over that the next row takes up: a late stamp is made good by the row after it,
and a clock that runs a little faster than its nominal rate gains no rows."""


@njit()
def grid_numbers(steps):  # type: ignore[no-untyped-def]
    """Whole numbers that add up to the steps, which are in periods.

    Parameters
    ----------
    steps : (n,) periods from row to row.

    Returns
    -------
    (n + 1,) integers, the first 0.
    """
    numbers = np.empty(steps.size + 1, np.int64)
    numbers[0], rest = 0, 0.0
    for k in range(steps.size):
        wanted = steps[k] + rest
        whole = np.floor(wanted + 0.5)
        rest = _KEPT * (wanted - whole)
        numbers[k + 1] = numbers[k] + np.int64(whole)
    return numbers
