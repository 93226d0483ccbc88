"""Numbers of rows on the grid of their nominal period, compiled: kept on disk until its folder changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from estimators.compiled import compiler

njit = compiler(Path(__file__).parent)
_KEPT = 0.99
"""Share of what rounding left over that the next row takes up: a late stamp is made good by the row after it,
and a clock that runs a little faster than its nominal rate gains no rows."""


@njit(error_model="numpy")
def grid_steps(time, period, rest, kept):  # type: ignore[no-untyped-def]
    """(n - 1,) steps of (n,) times (s) in whole periods (s), and the periods that rounding left over before.

    `rest`: periods, left over before the first step. `kept`: share of it that the next step takes up.
    """
    steps, rests = np.empty(time.size - 1, np.int64), np.empty(time.size - 1)
    for k in range(time.size - 1):
        rests[k] = rest
        wanted = (time[k + 1] - time[k]) / period + rest
        whole = np.floor(wanted + 0.5)
        rest = kept * (wanted - whole)
        steps[k] = np.int64(whole)
    return steps, rests


@njit(error_model="numpy")
def grid_numbers(time, period):  # type: ignore[no-untyped-def]
    """(n,) whole numbers that add up to the (n,) steps of time in periods, and grow from row to row."""
    steps, _ = grid_steps(time, period, 0.0, _KEPT)
    numbers = np.empty(time.size, np.int64)
    numbers[0] = 0
    for k in range(time.size - 1):
        numbers[k + 1] = numbers[k] + steps[k]
    # A late row shares its number with the next one: step back to make room for it.
    slack = numbers[-1] - (time.size - 1)
    for k in range(time.size - 1, -1, -1):
        slack = min(slack, numbers[k] - k)
        numbers[k] = slack + k
    return numbers
