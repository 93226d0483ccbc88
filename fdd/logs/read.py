"""Read a log of any format into the house's currency: channels in SI on one time base, and what was odd."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fdd.errors import InputError
from fdd.logs.angles import accumulate_speed
from fdd.logs.channel_map import ChannelMap
from fdd.logs.conversion import to_si
from fdd.logs.formats import LogFile, open_log
from fdd.logs.formats.mcap import McapFile
from fdd.logs.formats.signals import Signal
from fdd.logs.quality import DataQuality, check_magnitudes, check_time, count_missing
from fdd.logs.rates import aligned, between, on_common_rows, own_measurements, own_period
from fdd.logs.sources import Feed, feeds_of
from fdd.logs.stamps import longest_part, nominal_period, ordered_time, spread_bursts
from fdd.samples import Column, Samples, missing_required

TIME_OF_DAY_S = 3600.0
"""A log that starts later than this, and than ten times its length, carries the time of day or of a long
recording; it is counted from its start."""
_REQUIRED = (
    "position", "pump_speed", "pump_angle", "pressure_difference", "pressure_1", "pressure_2", "command",
)  # fmt: skip
_HOLDS = ("command", "position_setpoint")
"""Channels that stand still between two demands, whatever they were sampled at."""


@dataclass
class Log:
    """A log in the house's currency.

    Attributes
    ----------
    samples : channels in SI.
    quality : what was missing or odd.
    name : file name.
    axis : of the topic, the map, or the caller; None where nothing tells.
    metadata : of an MCAP file: record name to its key-value pairs. A run of
        ours has ``metadata["unit"]["yaml"]`` and ``metadata["scenario"]["json"]``.
    start_ns : ns since 1970, of t = 0; 0 where the file has no date.
    """

    samples: Samples
    quality: DataQuality
    name: str
    axis: str | None = None
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    start_ns: int = 0


def read_log(
    path: str | Path,
    map: ChannelMap | str | Path | None = None,
    axis: str | None = None,
    *,
    shortest: float = 2.0,
) -> Log:
    """Read a log of any format of `fdd.logs.formats`.

    Parameters
    ----------
    path : the log. Its content tells what it is, whatever its suffix.
    map : where the channels stand: a channel map, or the path of one. Not needed
        where columns carry the contract's names, or MCAP messages stand on
        ``/eha/<axis>/measurement``.
    axis : which axis of an MCAP file with several.
    shortest : s; a shorter log is refused.

    Returns
    -------
    Log : samples in SI and what was odd about them.

    Raises
    ------
    InputError : one line that names file, place, problem and mend.

    Examples
    --------
    >>> log = read_log("run.csv", map="rig.map.yaml")  # doctest: +SKIP
    >>> log.samples["position"], log.quality.dropped_samples  # doctest: +SKIP
    """
    path = Path(path)
    channel_map = map if isinstance(map, ChannelMap | None) else ChannelMap.load(map)
    try:
        file = open_log(path, channel_map.csv if channel_map else None)
        feeds, chosen = feeds_of(file, channel_map, axis)
        units = {c: f.source.unit for c, f in feeds.items() if f.source.unit is not None}
        return _checked(file, *_on_one_time_base(file, feeds), chosen, channel_map, units, shortest)
    except InputError as error:
        raise (error if error.where == str(path) else error.at(path)) from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", where=path) from None


def _on_one_time_base(file: LogFile, feeds: dict[str, Feed]) -> tuple[Column, dict[str, Column], bool]:
    """Channels in SI at the rows of the mapped time, or else of the fastest signal that a diagnosis needs.

    Returns
    -------
    (n,) s; columns (n,) by channel; whether the time is the file's own clock.
    """
    asked = Counter(s.name for f in feeds.values() for s in (f.signal, f.direction) if s is not None)
    raw = file.read(n for n in asked if n in file.signals)

    def taken(signal: Signal) -> Column:
        """A signal's numbers, held no longer than a feed still needs them."""
        asked[signal.name] -= 1
        return raw[signal.name] if asked[signal.name] else raw.pop(signal.name)

    timed = feeds.get("time")
    columns = {
        channel: to_si(
            channel,
            feed.source,
            taken(feed.signal),
            None if feed.direction is None else taken(feed.direction),
        )
        for channel, feed in feeds.items()
        if feed.signal.name in raw
    }
    mapped = columns.pop("time", None)
    if not columns:
        raise InputError("no usable channels: the map gives a time alone", where=file.path)
    # One row without its time would be lost; the file's own stamps serve all of them.
    if mapped is not None and isinstance(file, McapFile) and not np.isfinite(mapped).all():
        mapped = None
    rows = {f.signal.clock: columns[c].size for c, f in feeds.items() if c in columns}
    needed = [feeds[c].signal.clock for c in _REQUIRED if c in columns] or list(rows)
    main = timed.signal.clock if timed is not None else max(needed, key=lambda clock: rows[clock])
    at = file.stamps(main)
    if at is None and mapped is None:
        raise InputError("no time", where=file.path, mend="say with --map which column is the time")
    rows_at = mapped if at is None else at
    for channel, feed in feeds.items():
        late = feed.source.delay
        if channel not in columns or (feed.signal.clock == main and late == 0.0):
            continue
        own = rows_at if feed.signal.clock == main else file.stamps(feed.signal.clock)
        if own is None or rows_at is None or (feed.signal.clock != main and at is None):
            raise InputError(
                f"channel {channel} has {columns[channel].size} rows, the time has {rows.get(main, 0)}",
                where=file.path,
                mend="map channels of one rate, or a file that has a time for each",
            )
        columns[channel] = aligned(rows_at, own - late, columns[channel])
    time = at if mapped is None else mapped
    assert time is not None
    return time, columns, mapped is None


def _checked(
    file: LogFile,
    raw: Column,
    columns: dict[str, Column],
    of_file: bool,
    axis: str | None,
    channel_map: ChannelMap | None,
    units: dict[str, str],
    shortest: float,
) -> Log:
    notes = [*file.notes]
    if isinstance(file, McapFile) and file.damaged:
        notes.append(f"{file.damaged} damaged chunks were left out (checksum or compression is wrong)")
    spread, burst_notes = spread_bursts(raw)
    time, rows, time_notes = ordered_time(spread, file.place)
    kept, cut_notes = longest_part(time)
    time, rows = time[kept], rows[kept]
    for name in columns if rows.size < raw.size else ():
        columns[name] = columns[name][rows]
    del rows, spread
    notes += burst_notes + time_notes + cut_notes
    first = float(time[0])
    if first > max(TIME_OF_DAY_S, 10.0 * float(time[-1] - time[0])):
        notes.append(f"the clock starts at {first:.3f} s; times are counted from there")
        time = time - first
    if file.truncated:
        notes.insert(0, f"file is truncated: read up to t={time[-1]:.3f} s")
    start_ns = file.start_ns - (0 if of_file or not file.start_ns else round(float(time[0]) * 1e9))
    samples, quality = _judged(time, columns, notes, channel_map, units, shortest)
    return Log(samples, quality, file.path.name, axis, _of_axis(file.metadata, axis), start_ns)


def as_log(samples: Samples, axis: str | None = None, *, shortest: float = 2.0) -> Log:
    """Samples at hand as `read_log` would give them from a file.

    Parameters
    ----------
    samples : channels in SI, those that a diagnosis needs among them.
    axis : what the answer calls the axis. shortest : s; a shorter log is refused.

    Raises
    ------
    InputError : too short, a channel missing, or of a size that tells another unit of measure.

    Examples
    --------
    >>> t = np.arange(0.0, 5.0, 1e-3)
    >>> log = as_log(Samples(t, {"position": 1e-3 * t, "pump_speed": 0 * t, "pressure_difference": 1e5 + t}))
    >>> log.samples.channels, log.quality.period
    (('position', 'pump_speed', 'pressure_difference', 'pump_angle'), 0.001)
    """
    made, quality = _judged(samples.time, samples.columns, [], None, {}, shortest)
    return Log(made, quality, "samples", axis)


def _judged(
    time: Column,
    columns: dict[str, Column],
    notes: list[str],
    channel_map: ChannelMap | None,
    units: dict[str, str],
    shortest: float,
) -> tuple[Samples, DataQuality]:
    """Channels that a diagnosis can use, and what is odd about them after the reader's notes."""
    quality = check_time(time, shortest)
    columns, infinite_notes, empty = _with_values(columns)
    made = {} if channel_map is None else channel_map.channels
    absent = missing_required({*columns, *(n for n, s in made.items() if s.from_ in columns)})
    if absent:
        silent = f" ({', '.join(empty)} without a single value)" if empty else ""
        raise InputError(
            f"missing channels: {', '.join(absent)}{silent}",
            mend="record them, or name their columns with --map",
        )
    check_magnitudes(columns, units)
    recorded = set(columns)
    _derive(time, columns, channel_map, quality)
    slow, slow_notes = _keep_measurements(time, columns, quality.period, set(columns) - recorded)
    # Rows with a speed alone tell nothing that its angle does not.
    meeting = on_common_rows(time, columns, [n for n in _REQUIRED[:-1] if n != "pump_speed"])
    if meeting is not None:
        for name, values in columns.items():
            held = name in ("oil_temperature", *_HOLDS)
            columns[name] = values[meeting] if held else between(time, values, meeting)
        time = time[meeting]
        quality.period = nominal_period(time)
        slow_notes.append(f"rows are those that were measured, every {quality.period * 1e3:.4g} ms")
    count_missing({n: v for n, v in columns.items() if n in recorded - slow}, quality)
    quality.notes = notes + quality.notes + infinite_notes + slow_notes
    quality.notes += [f"{name}: no value at all, taken as absent" for name in empty]
    return Samples(time, columns), quality


def _keep_measurements(
    time: Column, columns: dict[str, Column], period: float, made: set[str]
) -> tuple[set[str], list[str]]:
    """Leave the channels nothing but measurements; those that are slower than the rows, and notes."""
    slow, notes = set(), []
    for name, values in columns.items():
        found = None if name in _HOLDS else own_measurements(time, values, period)
        columns[name], own = found or (values, own_period(time, values, period))
        if own is not None:
            slow.add(name)
            if name in made:
                continue
            held = ", held or interpolated in between: taken as missing there" if found else ""
            notes.append(
                f"{name}: measured every {own * 1e3:.4g} ms, the rows every {period * 1e3:.4g} ms{held}"
            )
    return slow, notes


def _with_values(columns: dict[str, Column]) -> tuple[dict[str, Column], list[str], list[str]]:
    """Channels without infinite values, notes on those that had any, and names of those without any value."""
    out, notes, empty = {}, [], []
    for channel, values in columns.items():
        if count := int((infinite := np.isinf(values)).sum()):
            values = np.where(infinite, np.nan, values)
            notes.append(f"{channel}: {count} infinite values taken as missing")
        if np.isfinite(values).any():
            out[channel] = values
        else:
            empty.append(channel)
    return out, notes, empty


def _of_axis(metadata: dict[str, dict[str, str]], axis: str | None) -> dict[str, dict[str, str]]:
    """The metadata with this axis's unit as the key yaml, where a run of several axes has one for each."""
    units = metadata.get("unit", {})
    if axis is None or "yaml" in units or axis not in units:
        return metadata
    return {**metadata, "unit": {**units, "yaml": units[axis]}}


def _derive(
    time: Column, columns: dict[str, Column], channel_map: ChannelMap | None, quality: DataQuality
) -> None:
    """Add the pump's speed and angle and the pressure difference where the log has only what makes them."""
    made = channel_map.channels if channel_map else {}
    if "pump_speed" not in columns and "pump_speed" in made and made["pump_speed"].from_ == "command":
        columns["pump_speed"] = columns["command"]
        quality.notes.append(
            "pump_speed: not measured, the command stands in for it: "
            "what the drive does not follow looks like a leak"
        )
    if "pump_angle" not in columns:
        source = made.get("pump_angle")
        stands_for = source.period if source is not None and source.period else quality.period
        columns["pump_angle"] = accumulate_speed(time, columns["pump_speed"], stands_for)
    if "pressure_difference" not in columns:
        columns["pressure_difference"] = columns["pressure_1"] - columns["pressure_2"]
