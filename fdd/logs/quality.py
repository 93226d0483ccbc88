"""What is missing or odd in a log, and what makes it unusable.

Missing rows, late stamps, gaps and NaN are reported. Only what would make every
answer wrong is refused: a clock that runs backwards, quantities in another unit
of measure than is said, a log too short or without the channels it needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fdd.errors import InputError
from fdd.logs.stamps import JUMP_PERIODS, nominal_period, sample_numbers
from fdd.measures import measure
from fdd.samples import PRESSURES, Column

COUNTED_GAP = 1.0
"""s; the rows that a longer gap would have held are not counted as dropped."""
HIGHEST_PRESSURE = 2e8
RECOMMENDED_SECONDS = 5.0


@dataclass
class DataQuality:
    """What was missing or odd.

    Attributes
    ----------
    dropped_samples : rows missing on the grid of the nominal period.
    nan_samples : rows in which at least one channel has no value.
    time_jumps : gaps of more than `JUMP_PERIODS` periods.
    notes : one line each, for people.
    period : s, nominal sampling period.
    """

    dropped_samples: int = 0
    nan_samples: int = 0
    time_jumps: int = 0
    notes: list[str] = field(default_factory=list)
    period: float = float("nan")


def check_time(time: Column, shortest: float) -> DataQuality:
    """Count missing rows, late stamps and time jumps.

    Raises
    ------
    InputError : fewer than `shortest` seconds of data.
    """
    period = nominal_period(time)
    seconds = 0.0 if time.size < 2 else min(float(time[-1] - time[0]) + period, time.size * period)
    if seconds < shortest:
        raise InputError(
            f"a log of {seconds:.3g} s ({time.size} rows) is too short",
            mend=f"record at least {max(RECOMMENDED_SECONDS, shortest):g} s",
        )
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
    """Refuse quantities whose size tells that their unit of measure is another one.

    Parameters
    ----------
    columns : in SI. units : what the map or the file gives a channel in; SI where it says nothing.

    Raises
    ------
    InputError : names the channel, the largest value as it was written, and the likely unit.
    """
    said = units or {}

    def refused(channel: str, problem: str, unit: str, likely: str) -> InputError:
        mend = f"give unit: {likely}" if likely != unit else "correct its scale or unit"
        return InputError(f"channel {channel}: {problem}", mend=f"{mend} in the map (--map)")

    largest = {name: _largest(columns[name]) for name in (*PRESSURES, "position") if name in columns}
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


def _largest(values: Column) -> float:
    return float(max(np.nanmax(values), -np.nanmin(values))) if np.isfinite(values).any() else 0.0
