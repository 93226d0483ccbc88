"""Stamps made times that increase; what is missing or odd in a log, and what makes it unusable.

What is missing or late is reported. Only what would make every answer wrong is refused.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.grid import grid_numbers
from fdd.measures import measure
from fdd.samples import PRESSURES, Column

JUMP_PERIODS = 10
"""A gap of more nominal periods than this is a time jump."""
LATE_SHARE = 0.01
"""Above this share of rows out of order, the clock is not just late."""
BURST_SHARE = 0.2
STOPPED_S = 4 * 3600.0
"""A log that stands still for longer is two logs, or has a stamp from before its clock was set."""
COUNTED_GAP = 1.0
"""s; the rows that a longer gap would have held are not counted as dropped."""
HIGHEST_PRESSURE = 2e8
RECOMMENDED_SECONDS = 5.0


def increasing_time(
    time: Column, place: Callable[[int], str] = "row {}".format
) -> tuple[Column, NDArray[np.intp], list[str]]:
    """Strictly increasing stamps of the log's longest part.

    Rows of one packet are spread, repeats dropped, late stamps put between their neighbours. Of (n,) s as
    read it gives (m,) s, (m,) rows kept, and notes; `place` is how a user finds a row in the log.

    Raises InputError: time runs backwards for more than a few late stamps, or is missing everywhere.
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
            mend = "sort the log, or cut it where its clock was reset"
            raise InputError(f"{where}: {time[at]:.6f} s after {time[at - 1]:.6f} s", mend=mend)
        index = np.arange(time.size, dtype=np.float64)
        time = np.interp(index, index[~late], time[~late])
        notes.append(f"{int(late.sum())} late time stamps were put between their neighbours")
    cuts = np.flatnonzero(np.diff(time) > STOPPED_S) + 1
    if cuts.size:
        longest = max(np.split(np.arange(time.size), cuts), key=len)
        others = f"{time.size - longest.size} rows before or after its longest part were left out"
        notes.append(f"the log stands still for more than {STOPPED_S / 3600:g} h: {others}")
        rows, time = rows[longest], time[longest]
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
    """Numbers of (n,) rows on the grid of the nominal period, s; in a step of k rows k - 1 are missing.

    They increase strictly. A stamp that came late makes a long step and then a short one; the row keeps its
    own number.
    """
    return np.asarray(grid_numbers(time, period)) if time.size else np.empty(0, dtype=np.int64)


@dataclass
class DataQuality:
    """What was missing or odd.

    `dropped_samples`: rows missing on the grid of the nominal period. `nan_samples`: rows in which at least
    one channel has no value. `time_jumps`: gaps of more than `JUMP_PERIODS` periods. `notes`: one line each,
    for people. `period`: s, nominal sampling period.
    """

    dropped_samples: int = 0
    nan_samples: int = 0
    time_jumps: int = 0
    notes: list[str] = field(default_factory=list)
    period: float = float("nan")


def check_time(time: Column, shortest: float) -> DataQuality:
    """Count missing rows, late stamps and time jumps. Raises InputError: less than `shortest` s of data."""
    period = nominal_period(time)
    seconds = 0.0 if time.size < 2 else min(float(time[-1] - time[0]) + period, time.size * period)
    if seconds < shortest:
        mend = f"record at least {max(RECOMMENDED_SECONDS, shortest):g} s"
        raise InputError(f"a log of {seconds:.3g} s ({time.size} rows) is too short", mend=mend)
    quality = DataQuality(period=period)
    steps, missing = np.diff(time), np.diff(sample_numbers(time, period)) - 1
    quality.dropped_samples = int(missing[steps <= COUNTED_GAP].sum())
    del missing
    quality.time_jumps = int(np.count_nonzero(steps > JUMP_PERIODS * period))
    periods = steps / period
    # A step that is no whole number of periods: the stamp came late, or early.
    uneven = int(np.count_nonzero(np.abs(periods - np.rint(periods)) > 0.05))
    if quality.dropped_samples:
        share = 100.0 * quality.dropped_samples / (time.size + quality.dropped_samples)
        quality.notes.append(f"{quality.dropped_samples} rows are missing ({share:.2g} %)")
    if quality.time_jumps:
        row = int(np.argmax(steps))
        longest = f"{steps[row]:.3f} s at most (after t={time[row]:.3f} s)"
        quality.notes.append(f"time jumps {quality.time_jumps} times, {longest}")
    if uneven:
        share = 100.0 * uneven / (time.size - 1)
        quality.notes.append(f"{uneven} steps of time are uneven ({share:.2g} %, jitter or late stamps)")
    return quality


def count_missing(columns: Mapping[str, Column], quality: DataQuality) -> None:
    """Count rows with NaN, and note which channels have them."""
    gone = np.zeros(next((v.size for v in columns.values()), 0), dtype=bool)
    for name, values in columns.items():
        mask = ~np.isfinite(values)
        gone |= mask
        if count := int(mask.sum()):
            quality.notes.append(f"{name}: {count} values are missing ({100.0 * count / mask.size:.2g} %)")
    quality.nan_samples = int(gone.sum())


def check_magnitudes(columns: Mapping[str, Column], units: Mapping[str, str] | None = None) -> None:
    """Refuse quantities (`columns`, in SI) whose size tells that their unit of measure is another one.

    `units`: what the map or the file gives a channel in; SI where it says nothing. The InputError names the
    channel, the largest value as it was written, and the likely unit.
    """
    said = units or {}

    def refused(channel: str, problem: str, unit: str, likely: str) -> InputError:
        mend = f"give unit: {likely}" if likely != unit else "correct its scale or unit"
        return InputError(f"channel {channel}: {problem}", mend=f"{mend} in the map (--map)")

    judged = [name for name in (*PRESSURES, "position") if name in columns]
    largest = {name: float(np.nanmax(np.abs(columns[name]), initial=0.0)) for name in judged}
    chambers = [largest[name] for name in ("pressure_1", "pressure_2") if name in largest]
    # What a chamber's largest pressure reaches at least: more where no chamber shows any.
    quiet = bool(chambers) and max(*chambers, largest.get("pressure_difference", 0.0)) < 2e4
    for name in (name for name in PRESSURES if name in largest):
        unit = said.get(name, "Pa")
        written = largest[name] / measure(unit, "pressure").factor
        likely = "bar" if written < 1e3 else "kPa" if written < 1e5 else "Pa"
        if largest[name] > HIGHEST_PRESSURE:
            problem = f"up to {written:.3g} {unit}, more than any hydraulic circuit holds"
            raise refused(name, problem, unit, likely)
        # A drained accumulator may well show nothing; a chamber is precharged, and its noise alone is more.
        if name != "pressure_accumulator" and 0.0 < largest[name] < (2e4 if quiet else 2e3):
            looks = f"pressures look like {likely}" if likely != unit else "no pressures of a cylinder"
            raise refused(name, f"{looks} (at most {written:.3g} {unit})", unit, likely)
    if (position := largest.get("position", 0.0)) > 10.0:
        unit = said.get("position", "m")
        written = position / measure(unit, "length").factor
        likely = "mm" if written < 1e4 else "um"
        raise refused("position", f"up to {written:.3g} {unit}, looks like {likely}", unit, likely)
    oil, unit = columns.get("oil_temperature"), said.get("oil_temperature", "°C")
    if oil is not None and np.nanmedian(oil) > 200.0:
        scale = measure(unit, "temperature")
        written = (float(np.nanmedian(oil)) - scale.offset) / scale.factor
        raise refused("oil_temperature", f"{written:.0f} {unit}, looks like kelvin", unit, "K")
