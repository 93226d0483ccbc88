"""Stamps as recorders write them, made times that increase: late ones, repeats, packets, resets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.samples import Column

JUMP_PERIODS = 10
"""A gap of more nominal periods than this is a time jump."""
LATE_SHARE = 0.01
"""Above this share of rows out of order, the clock is not just late."""
BURST_SHARE = 0.2
STOPPED_S = 4 * 3600.0
"""A log that stands still for longer is two logs, or has a stamp from before its clock was set."""


def ordered_time(
    time: Column, place: Callable[[int], str] = "row {}".format
) -> tuple[Column, NDArray[np.intp], list[str]]:
    """Strictly increasing stamps: repeats dropped, late stamps put between their neighbours.

    Parameters
    ----------
    time : (n,) s, as read.
    place : how a user finds a row in the log.

    Returns
    -------
    time : (m,) s, strictly increasing.
    rows : (m,) rows kept.
    notes : what was done.

    Raises
    ------
    InputError : time runs backwards for more than a few late stamps, or is missing everywhere.
    """
    notes: list[str] = []
    rows = np.flatnonzero(np.isfinite(time))
    if rows.size == 0:
        raise InputError("channel time: no value at all")
    if rows.size < time.size:
        notes.append(f"{time.size - rows.size} rows without a time stamp were left out")
    stamps = time if rows.size == time.size else time[rows]
    repeated = np.concatenate(([False], stamps[1:] == stamps[:-1]))
    if repeated.any():
        notes.append(f"{int(repeated.sum())} rows repeat the time stamp before them and were left out")
        rows, stamps = rows[~repeated], stamps[~repeated]
    back = np.flatnonzero(stamps[1:] < stamps[:-1])
    if back.size == 0:
        return stamps, rows, notes
    period = float(np.median(np.abs(np.diff(stamps))))
    later = np.minimum.accumulate(stamps[::-1])[::-1]
    late = stamps > later
    # A stamp equal to a later one would leave no room between the two.
    late[:-1] |= stamps[:-1] >= later[1:]
    if late.sum() > max(3, LATE_SHARE * stamps.size) or (stamps - later).max() > JUMP_PERIODS * period:
        at = int(back[0]) + 1
        raise InputError(
            f"time runs backwards at {place(int(rows[at]))}: {stamps[at]:.6f} s after {stamps[at - 1]:.6f} s",
            mend="sort the log, or cut it where its clock was reset",
        )
    index = np.arange(stamps.size, dtype=np.float64)
    stamps = np.interp(index, index[~late], stamps[~late])
    notes.append(f"{int(late.sum())} late time stamps were put between their neighbours")
    return stamps, rows, notes


def spread_bursts(time: Column) -> tuple[Column, list[str]]:
    """Rows that share a stamp because they came in one packet, spread evenly up to the next one.

    A stamp that is repeated now and then is a row that is there twice (see `ordered_time`); where more than
    `BURST_SHARE` of all rows repeat the one before, the logger stamps packets.

    Parameters
    ----------
    time : (n,) s, as read.
    """
    if time.size < 4 or not np.isfinite(time).all():
        return time, []
    changed = time[1:] != time[:-1]
    if 1.0 - float(changed.mean()) < BURST_SHARE:
        return time, []
    starts = np.flatnonzero(np.concatenate(([True], changed)))
    counts = np.diff(np.append(starts, time.size))
    if starts.size < 3:
        return time, []
    lengths = np.diff(time[starts])
    lengths = np.append(lengths, np.median(lengths) * counts[-1] / max(float(np.median(counts)), 1.0))
    # Over a gap a packet is as long as usual.
    lengths = np.minimum(lengths, 2.0 * np.median(lengths / counts) * counts)
    place = np.arange(time.size) - np.repeat(starts, counts)
    spread = time + place * np.repeat(lengths / counts, counts)
    return spread, [
        f"stamps come in packets of {float(np.median(counts)):g} rows; the rows were spread evenly"
    ]


def longest_part(time: Column) -> tuple[slice, list[str]]:
    """Rows of the longest part of a log that was stopped for more than `STOPPED_S`: an early row goes."""
    cuts = np.flatnonzero(np.diff(time) > STOPPED_S) + 1
    if cuts.size == 0:
        return slice(0, time.size), []
    edges = np.concatenate(([0], cuts, [time.size]))
    longest = int(np.argmax(np.diff(edges)))
    a, b = int(edges[longest]), int(edges[longest + 1])
    note = (
        f"the log stands still for more than {STOPPED_S / 3600:g} h: "
        f"{time.size - (b - a)} rows before or after its longest part were left out"
    )
    return slice(a, b), [note]


def nominal_period(time: Column) -> float:
    """Median step of the stamps, s."""
    # To the nanosecond: stamps carry rounding of their own.
    return round(float(np.median(np.diff(time), overwrite_input=True)), 9) if time.size > 1 else float("nan")
