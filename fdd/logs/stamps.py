"""Stamps as recorders write them, made times that increase: late ones, repeats, packets, resets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.wire.grid import grid_numbers
from fdd.samples import Column

JUMP_PERIODS = 10
"""A gap of more nominal periods than this is a time jump."""
LATE_SHARE = 0.01
"""Above this share of rows out of order, the clock is not just late."""
BURST_SHARE = 0.2
STOPPED_S = 4 * 3600.0
"""A log that stands still for longer is two logs, or has a stamp from before its clock was set."""


def increasing_time(
    time: Column, place: Callable[[int], str] = "row {}".format
) -> tuple[Column, NDArray[np.intp], list[str]]:
    """Strictly increasing stamps of the log's longest part.

    Rows of one packet are spread, repeats dropped, late stamps put between their neighbours.

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
    time = _spread_packets(time, notes)
    rows = np.flatnonzero(np.isfinite(time))
    if rows.size == 0:
        raise InputError("channel time: no value at all")
    if rows.size < time.size:
        notes.append(f"{time.size - rows.size} rows without a time stamp were left out")
        time = time[rows]
    repeated = np.concatenate(([False], time[1:] == time[:-1]))
    if repeated.any():
        notes.append(f"{int(repeated.sum())} rows repeat the time stamp before them and were left out")
        rows, time = rows[~repeated], time[~repeated]
    back = np.flatnonzero(time[1:] < time[:-1])
    if back.size:
        period = float(np.median(np.abs(np.diff(time))))
        later = np.minimum.accumulate(time[::-1])[::-1]
        late = time > later
        # A stamp equal to a later one would leave no room between the two.
        late[:-1] |= time[:-1] >= later[1:]
        if late.sum() > max(3, LATE_SHARE * time.size) or (time - later).max() > JUMP_PERIODS * period:
            at = int(back[0]) + 1
            where = f"time runs backwards at {place(int(rows[at]))}"
            raise InputError(
                f"{where}: {time[at]:.6f} s after {time[at - 1]:.6f} s",
                mend="sort the log, or cut it where its clock was reset",
            )
        index = np.arange(time.size, dtype=np.float64)
        time = np.interp(index, index[~late], time[~late])
        notes.append(f"{int(late.sum())} late time stamps were put between their neighbours")
    cuts = np.flatnonzero(np.diff(time) > STOPPED_S) + 1
    if cuts.size:
        edges = np.concatenate(([0], cuts, [time.size]))
        longest = int(np.argmax(np.diff(edges)))
        part = slice(int(edges[longest]), int(edges[longest + 1]))
        notes.append(
            f"the log stands still for more than {STOPPED_S / 3600:g} h: "
            f"{time.size - (part.stop - part.start)} rows before or after its longest part were left out"
        )
        rows, time = rows[part], time[part]
    return time, rows, notes


def _spread_packets(time: Column, notes: list[str]) -> Column:
    """Rows that share a stamp because they came in one packet, spread evenly up to the next one.

    A stamp that is repeated now and then is a row that is there twice; where more than `BURST_SHARE` of all
    rows repeat the one before, the logger stamps packets.
    """
    if time.size < 4 or not np.isfinite(time).all():
        return time
    changed = time[1:] != time[:-1]
    starts = np.flatnonzero(np.concatenate(([True], changed)))
    if 1.0 - float(changed.mean()) < BURST_SHARE or starts.size < 3:
        return time
    counts = np.diff(np.append(starts, time.size))
    usual = float(np.median(counts))
    lengths = np.diff(time[starts])
    lengths = np.append(lengths, np.median(lengths) * counts[-1] / max(usual, 1.0))
    # Over a gap a packet is as long as usual.
    lengths = np.minimum(lengths, 2.0 * np.median(lengths / counts) * counts)
    place = np.arange(time.size) - np.repeat(starts, counts)
    notes.append(f"stamps come in packets of {usual:g} rows; the rows were spread evenly")
    return np.asarray(time + place * np.repeat(lengths / counts, counts))


def nominal_period(time: Column) -> float:
    """Median step of the stamps, s."""
    # To the nanosecond: stamps carry rounding of their own.
    return round(float(np.median(np.diff(time), overwrite_input=True)), 9) if time.size > 1 else float("nan")


def sample_numbers(time: Column, period: float) -> NDArray[np.int64]:
    """Number of each row on the grid of the nominal period, so that gaps are whole periods.

    A stamp that came late makes a long step and then a short one; the row keeps
    its own number, it is not counted as a missing row.

    Parameters
    ----------
    time : (n,) s, increasing.
    period : s, nominal.

    Returns
    -------
    (n,) integers, strictly increasing; a step of k means k - 1 missing rows.

    Examples
    --------
    >>> sample_numbers(np.array([0.0, 1.0, 2.9, 3.0, 5.0]), 1.0).tolist()
    [0, 1, 2, 3, 5]
    >>> sample_numbers(np.array([0.0, 1.0, 2.4999, 2.9998, 4.0]), 1.0).tolist()
    [0, 1, 2, 3, 4]
    """
    return np.asarray(grid_numbers(time, period)) if time.size else np.empty(0, dtype=np.int64)
