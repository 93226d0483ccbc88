"""What is remembered of each channel from frame to frame: plain arrays, saved as they are."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.limits import NAMES

Array = NDArray[np.float64]

COUNT = len(NAMES)
CELL_HISTORY = 250
"""Cells of 20 ms: the noise of the last five seconds."""
STILL, MOVING = 0, 1
"""Classes of frames: the pump turned less than once, or more. Noise and repeats are compared within a
class."""
SHAPES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("frames", "repeat", "noisiest", "quietest"), (2, COUNT)),
    "volume": (5,), "stood": (4,), "stamps": (2,), "cells": (COUNT, CELL_HISTORY), "derived": (1,),
}  # fmt: skip
"""Of what is not (12,)."""
UNKNOWN = (
    "run_value", "run_since", "loud_since", "faint_since", "absent_since", "absent_first", "failed_since",
    "last_value", "good_value", "good_time", "doubtful_since", "previous", "stamps", "derived",
)  # fmt: skip
STARTS = {**dict.fromkeys(UNKNOWN, np.nan), "quietest": np.inf, "held_until": -np.inf}
"""What does not start at 0."""


class Memory(NamedTuple):
    """Per channel (12,), or per class of frame and channel (2, 12).

    Attributes
    ----------
    rows, present : rows that came, and those with a value.
    run_value, run_since, run_rows : the value that the channel shows, since when (s), in how many rows.
    changed : whether it ever changed.
    frames, repeat, noisiest, quietest : frames judged good; the largest chance of a repeated value and the
        largest and least noise that they showed.
    loud, loud_since, faint, faint_since : frames in a row with far more, or less, noise, and when they began.
    absent_since, absent_s, absent_first : a gap that is open; seconds missing lately; when that began.
    held_until : until when repeats are taken for a loose contact's.
    failed_since, good : since when it is not to be trusted, NaN if it is; good frames since.
    biased : sum of steps that a pressure made.
    excited : frames with a turning pump since the channel changed last.
    volume : (5,) m³ that the pump displaced since the position changed last: sum, least, most, what
        leakage allows; and whether the position stopped in mid-motion.
    stood : (4,) the position's last stand that a frame did not hold: since and until when (s), what the pump
        displaced meanwhile (m³); and since when it stands now.
    last_value : what the channel showed before `run_value`.
    good_value, good_time, doubtful_since, previous, stamps : for the masks of rows.
    cells, cell_count : the last excesses of cells, newest last, and how many there are.
    derived : (1,) whether Δp is p1 - p2 to the last digit: 1, 0, NaN not known.
    """

    rows: Array
    present: Array
    run_value: Array
    run_since: Array
    run_rows: Array
    changed: Array
    frames: Array
    repeat: Array
    noisiest: Array
    quietest: Array
    loud: Array
    loud_since: Array
    faint: Array
    faint_since: Array
    absent_since: Array
    absent_s: Array
    absent_first: Array
    held_until: Array
    failed_since: Array
    good: Array
    biased: Array
    excited: Array
    volume: Array
    stood: Array
    last_value: Array
    good_value: Array
    good_time: Array
    doubtful_since: Array
    previous: Array
    stamps: Array
    cells: Array
    cell_count: Array
    derived: Array

    @classmethod
    def new(cls) -> Memory:
        """Of a log that has not begun."""
        return cls(*(np.full(SHAPES.get(n, (COUNT,)), STARTS.get(n, 0.0)) for n in cls._fields))
