"""What is remembered of each channel from hop to hop: plain arrays, so that they can be saved as they are."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.limits import INDEX, NAMES

Array = NDArray[np.float64]

COUNT = len(NAMES)
CELL_HISTORY = 250
"""Cells of 20 ms: the noise of the last five seconds."""
STILL, MOVING = 0, 1
"""Hops in which the pump turned less than once, or more: noise and repeats are compared with their like."""


def _nan() -> Array:
    return np.full(COUNT, np.nan)


def _zero() -> Array:
    return np.zeros(COUNT)


def _classes() -> Array:
    return np.zeros((2, COUNT))


@dataclass
class Memory:
    """Per channel (12,), or per class of hop and channel (2, 12).

    Attributes
    ----------
    rows, present : rows that came, and those with a value.
    run_value, run_since, run_rows : the value that the channel shows, since when (s), in how many rows.
    changed : whether it ever changed.
    hops, repeat, noisiest, quietest : hops judged good; the largest chance of a repeated value and the
        largest and least noise that they showed.
    loud, loud_since, faint, faint_since : hops in a row with far more, or less, noise, and when they began.
    absent_since, absent_s, absent_first : a gap that is open; seconds missing lately; when that began.
    held_until : until when repeats are taken for a loose contact's.
    failed_since, good : since when it is not to be trusted, NaN if it is; good hops since.
    biased : sum of steps that a pressure made.
    excited : hops with a turning pump since the channel changed last.
    volume : (5,) m³ that the pump displaced since the position changed last: sum, least, most, what
        leakage allows; and whether the position stopped in mid-motion.
    last_value : what the channel showed before `run_value`.
    good_value, good_time, doubtful_since, previous, stamps : for the masks of rows.
    cells, cell_count : the last excesses of cells, newest last, and how many there are.
    derived : (1,) whether Δp is p1 - p2 to the last digit: 1, 0, NaN not known.
    """

    rows: Array = field(default_factory=_zero)
    present: Array = field(default_factory=_zero)
    run_value: Array = field(default_factory=_nan)
    run_since: Array = field(default_factory=_nan)
    run_rows: Array = field(default_factory=_zero)
    changed: Array = field(default_factory=_zero)
    hops: Array = field(default_factory=_classes)
    repeat: Array = field(default_factory=_classes)
    noisiest: Array = field(default_factory=_classes)
    quietest: Array = field(default_factory=lambda: np.full((2, COUNT), np.inf))
    loud: Array = field(default_factory=_zero)
    loud_since: Array = field(default_factory=_nan)
    faint: Array = field(default_factory=_zero)
    faint_since: Array = field(default_factory=_nan)
    absent_since: Array = field(default_factory=_nan)
    absent_s: Array = field(default_factory=_zero)
    absent_first: Array = field(default_factory=_nan)
    held_until: Array = field(default_factory=lambda: np.full(COUNT, -np.inf))
    failed_since: Array = field(default_factory=_nan)
    good: Array = field(default_factory=_zero)
    biased: Array = field(default_factory=_zero)
    excited: Array = field(default_factory=_zero)
    volume: Array = field(default_factory=lambda: np.zeros(5))
    last_value: Array = field(default_factory=_nan)
    good_value: Array = field(default_factory=_nan)
    good_time: Array = field(default_factory=_nan)
    doubtful_since: Array = field(default_factory=_nan)
    previous: Array = field(default_factory=_nan)
    stamps: Array = field(default_factory=lambda: np.full(2, np.nan))
    cells: Array = field(default_factory=lambda: np.zeros((COUNT, CELL_HISTORY)))
    cell_count: Array = field(default_factory=_zero)
    derived: Array = field(default_factory=lambda: np.array([np.nan]))

    def is_derived(self, k: int) -> bool:
        """Whether channel k is a Δp that was made of both chambers' pressures."""
        return k == INDEX["pressure_difference"] and self.derived[0] == 1.0
