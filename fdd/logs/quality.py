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
from fdd.logs.angles import sample_numbers
from fdd.logs.stamps import JUMP_PERIODS, nominal_period
from fdd.measures import measure
from fdd.samples import CHANNELS, PRESSURES, Column

COUNTED_GAP = 1.0
"""s; the rows that a longer gap would have held are not counted as dropped."""
STUCK_SECONDS = 5.0
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
    any_gone = np.zeros(next(iter(columns.values())).size, dtype=bool) if columns else np.zeros(0, dtype=bool)
    for name, values in columns.items():
        mask = ~np.isfinite(values)
        count = int(mask.sum())
        any_gone |= mask
        if count:
            quality.notes.append(f"{name}: {count} values are missing ({100.0 * count / mask.size:.2g} %)")
    quality.nan_samples = int(any_gone.sum())


def check_magnitudes(columns: Mapping[str, Column], units: Mapping[str, str] | None = None) -> None:
    """Refuse quantities whose size tells that their unit of measure is another one.

    Parameters
    ----------
    columns : in SI. units : what the map or the file gives a channel in; SI where it says nothing.

    Raises
    ------
    InputError : names the channel, the largest value as it was written, and the likely unit.

    Examples
    --------
    >>> check_magnitudes({"position": np.array([0.0, 85.0])})
    Traceback (most recent call last):
    ...
    fdd.errors.InputError: channel position: up to 85 m, looks like mm; give unit: mm in the map (--map)
    """
    said = units or {}
    for name in PRESSURES:
        largest, unit = _largest(columns, name), said.get(name, "Pa")
        written = largest / measure(unit, "pressure").factor
        likely = "bar" if written < 1e3 else "kPa" if written < 1e5 else "Pa"
        if largest > HIGHEST_PRESSURE:
            problem = f"up to {written:.3g} {unit}, more than any hydraulic circuit holds"
            raise _in_another_unit(name, problem, unit, likely)
        # A drained accumulator may well show nothing; a chamber is precharged, and its noise alone is more.
        if name != "pressure_accumulator" and 0.0 < largest < _least_pressure(columns):
            looks = f"pressures look like {likely}" if likely != unit else "no pressures of a cylinder"
            problem = f"{looks} (at most {written:.3g} {unit})"
            raise _in_another_unit(name, problem, unit, likely)
    position, unit = _largest(columns, "position"), said.get("position", "m")
    if position > 10.0:
        written = position / measure(unit, "length").factor
        likely = "mm" if written < 1e4 else "um"
        raise _in_another_unit("position", f"up to {written:.3g} {unit}, looks like {likely}", unit, likely)
    oil, unit = columns.get("oil_temperature"), said.get("oil_temperature", "°C")
    if oil is not None and np.nanmedian(oil) > 200.0:
        scale = measure(unit, "temperature")
        written = (float(np.nanmedian(oil)) - scale.offset) / scale.factor
        raise _in_another_unit("oil_temperature", f"{written:.0f} {unit}, looks like kelvin", unit, "K")


def _in_another_unit(channel: str, problem: str, said: str, likely: str) -> InputError:
    mend = f"give unit: {likely}" if likely != said else "correct its scale or unit"
    return InputError(f"channel {channel}: {problem}", mend=f"{mend} in the map (--map)")


def _least_pressure(columns: Mapping[str, Column]) -> float:
    """What a chamber's largest pressure reaches at least, Pa: more where no chamber shows any."""
    chambers = [_largest(columns, n) for n in ("pressure_1", "pressure_2") if n in columns]
    return 2e4 if chambers and max(*chambers, _largest(columns, "pressure_difference")) < 2e4 else 2e3


def _largest(columns: Mapping[str, Column], name: str) -> float:
    values = columns.get(name)
    if values is None or not np.isfinite(values).any():
        return 0.0
    return float(max(np.nanmax(values), -np.nanmin(values)))


def suspicions(time: Column, columns: Mapping[str, Column], period: float) -> list[str]:
    """Notes on channels that are usable but look wrong: standstill, stuck, impossible speeds.

    Parameters
    ----------
    time : (n,) s.
    columns : channels in SI.
    period : s, nominal.
    """
    notes = []
    moving = (columns[n] for n in ("position", "pump_angle", "pump_speed") if n in columns)
    if not any(np.nanmax(v) > np.nanmin(v) for v in moving if np.isfinite(v).any()):
        notes.append("standstill: neither the position nor the pump moves throughout the log")
    for name, values in columns.items():
        if CHANNELS[name].dimension != "pressure":
            continue
        start, length = _longest_constant(values)
        if length * period > STUCK_SECONDS and values[start] != 0.0:
            notes.append(
                f"{name}: exactly {values[start]:.6g} Pa for {length * period:.1f} s "
                f"from t={time[start]:.1f} s, looks stuck or at its limit"
            )
    notes += _speed_notes(time, columns)
    return notes


def _speed_notes(time: Column, columns: Mapping[str, Column]) -> list[str]:
    notes = []
    angle, speed = columns.get("pump_angle"), columns.get("pump_speed")
    if angle is None:
        return notes
    there = np.isfinite(angle)
    rate = np.abs(np.diff(angle[there]) / np.diff(time[there]))
    if rate.size:
        bursts = rate > max(1000.0, 4.0 * float(np.percentile(rate, 99.0)))
        if bursts.any():
            notes.append(
                f"pump_angle: {int(bursts.sum())} steps of impossible speed "
                f"(up to {rate.max():.0f} rad/s), the angle sensor slips or is disturbed"
            )
    if speed is None or not (both := there & np.isfinite(speed)).any():
        return notes
    steps = np.diff(time[both])
    # Over a hole in the log one sample of the speed says nothing about how far the pump turned.
    near = steps <= JUMP_PERIODS * float(np.median(steps)) if steps.size else steps > 0.0
    turned = float(np.abs(np.diff(angle[both]))[near].sum())
    expected = float((np.abs(speed[both][1:]) * steps)[near].sum())
    if turned > 10.0 and not 0.8 < expected / turned < 1.25:
        notes.append(
            f"pump_speed is {expected / turned:.3g} times the rate of pump_angle: "
            "the unit or scale of one of them is wrong"
        )
    return notes


def _longest_constant(values: Column) -> tuple[int, int]:
    """Start and length (rows) of the longest run of one value."""
    # NaN differs from itself, so that missing values end a run.
    edges = np.flatnonzero(np.concatenate(([True], values[1:] != values[:-1], [True])))
    lengths = np.diff(edges)
    longest = int(np.argmax(lengths))
    return int(edges[longest]), int(lengths[longest])
