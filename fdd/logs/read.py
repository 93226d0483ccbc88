"""Read a log of any format into the house's currency: channels in SI on one time base, and what was odd."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fdd.errors import InputError, listed
from fdd.logs.channel_map import ChannelMap, ChannelSource, accumulate_speed, to_si
from fdd.logs.formats import LogFile, Signal, open_log, told_with
from fdd.logs.formats.mcap import AXIS_TOPIC, McapFile
from fdd.logs.quality import (
    DataQuality,
    check_magnitudes,
    check_time,
    count_missing,
    increasing_time,
    nominal_period,
)
from fdd.logs.rates import aligned, between, on_common_rows, own_measurements, own_period
from fdd.measures import find_measure
from fdd.samples import CHANNELS, Column, Samples, missing_required

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
    """A log in the house's currency: its file's name, channels in SI, and what was missing or odd.

    `axis`: of the topic, the map, or the caller; None where nothing tells. `metadata`: record name to
    key-value pairs (MCAP); of our runs ``["unit"]["yaml"]`` among them. `start_ns`: ns since 1970, of t = 0;
    0 where the file has no date.
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
    map : where the channels stand: a channel map, or the path of one. Not needed where columns carry the
        contract's names, or MCAP messages stand on ``/eha/<axis>/measurement``.
    axis : which axis of an MCAP file with several.
    shortest : s; a shorter log is refused.

    Raises
    ------
    InputError : one line that names file, place, problem and mend.
    """
    path = Path(path)
    channel_map = map if isinstance(map, ChannelMap | None) else ChannelMap.load(map)
    with told_with(path):
        file = open_log(path, channel_map.csv if channel_map else None)
        feeds, chosen = feeds_of(file, channel_map, axis)
        raw, columns, of_file = _on_one_time_base(file, feeds)
        time, rows, told = increasing_time(raw, file.place)
        for name in columns if rows.size < raw.size else ():
            columns[name] = columns[name][rows]
        del raw, rows
        notes = file.notes + told
        first = float(time[0])
        if first > max(TIME_OF_DAY_S, 10.0 * float(time[-1] - time[0])):
            notes.append(f"the clock starts at {first:.3f} s; times are counted from there")
            time = time - first
        if file.truncated:
            notes.insert(0, f"file is truncated: read up to t={time[-1]:.3f} s")
        start_ns = file.start_ns - (0 if of_file or not file.start_ns else round(float(time[0]) * 1e9))
        units = {c: f.source.unit for c, f in feeds.items() if f.source.unit is not None}
        made = {} if channel_map is None else channel_map.channels
        samples, quality = _judged(time, columns, made, units, shortest)
        quality.notes[:0] = notes
        metadata, profiles = file.metadata, file.metadata.get("unit", {})
        if chosen is not None and "yaml" not in profiles and chosen in profiles:  # of a run of several axes
            metadata = {**metadata, "unit": {**profiles, "yaml": profiles[chosen]}}
        return Log(samples, quality, path.name, chosen, metadata, start_ns)


class Feed(NamedTuple):
    """A channel's source, its signal (of a time without a column its clock alone), and its direction's."""

    source: ChannelSource
    signal: Signal
    direction: Signal | None = None


def feeds_of(
    log: LogFile, channel_map: ChannelMap | None, axis: str | None
) -> tuple[dict[str, Feed], str | None]:
    """The feeds by channel, and the axis. Raises InputError: nothing usable, or several axes."""
    messages = isinstance(log, McapFile)
    if messages and log.truncated and not log.signals:
        raise InputError("cut off before its first message can be read", mend="record or copy it again")
    if channel_map is None:
        return _measurement(log, axis) if isinstance(log, McapFile) else (_named(log), axis)
    if messages and not channel_map.reads_mcap:
        raise InputError("the map names columns, but this is an MCAP file", mend="map topics")
    if not messages and channel_map.reads_mcap:
        raise InputError("the map names topics, but this is a table", mend="map columns")

    def found(source: ChannelSource, name: str | None) -> Signal:
        return log.field(str(source.topic), name) if isinstance(log, McapFile) else log.find(str(name))

    feeds = {}
    for channel, source in channel_map.channels.items():
        if source.from_ is None:
            signal = found(source, source.field if messages else source.column)
            direction = found(source, source.sign_of) if source.sign_of else None
            feeds[channel] = Feed(_with_unit(channel, source, signal), signal, direction)
    return feeds, axis or channel_map.axis


def _with_unit(channel: str, source: ChannelSource, signal: Signal) -> ChannelSource:
    """The source with the file's own unit where the map gives none."""
    given = source.unit is not None or (source.scale, source.offset) != (1.0, 0.0)
    if given or not signal.unit or find_measure(signal.unit, CHANNELS[channel].dimension) is None:
        return source
    return source.model_copy(update={"unit": signal.unit})


def _unusable(problem: str, there: str) -> InputError:
    mend = f"make a map with fdd map and give it with --map{there}"
    return InputError(f"no usable channels{problem}", mend=mend)


def _named(log: LogFile) -> dict[str, Feed]:
    """Signals that are called as the contract's channels."""
    found: dict[str, Signal] = {}
    for channel in CHANNELS:
        ends = sum(name.rsplit("/", 1)[-1] == channel for name in log.signals)
        if channel in log.doubled or channel in log.signals or ends == 1:
            found[channel] = log.find(channel)
    fed = next((signal for channel, signal in found.items() if channel != "time"), None)
    if fed is None:
        raise _unusable("", f"; its columns are: {listed(log.signals)}")
    if "time" not in found and log.stamps(fed.clock) is None:
        raise InputError("no column 'time'", mend="say with --map which column is the time")
    return {c: Feed(_with_unit(c, ChannelSource(column=s.name), s), s) for c, s in found.items()}


def _measurement(log: McapFile, axis: str | None) -> tuple[dict[str, Feed], str]:
    """The contract's topic of one axis."""
    axes = [found["axis"] for t in log.topics if (found := AXIS_TOPIC.match(t))]
    if not axes:
        there = f"it has: {listed(log.topics)}" if log.topics else "it has no topics"
        raise _unusable(": no topic /eha/<axis>/measurement", f" ({there})")
    if axis is not None and axis not in axes:
        raise InputError(f"no axis {axis!r}", mend=f"the file has: {listed(axes)}")
    if axis is None and len(axes) > 1:
        raise InputError(f"{len(axes)} axes: {listed(axes)}", mend="choose one with --axis")
    chosen = axis or axes[0]
    topic = f"/eha/{chosen}/measurement"
    if topic in log.reasons:
        log.field(topic, "position")
    fields = {str(s.field): s for s in log.signals.values() if s.topic == topic}
    if not fields:
        raise InputError("no message could be read", mend="the file may be cut off: record or copy it again")
    feeds = {c: Feed(ChannelSource(topic=topic, field=c), fields[c]) for c in CHANNELS if c in fields}
    if not set(feeds) - {"time"}:
        raise _unusable("", f"; its fields are: {listed(fields)}")
    return feeds, chosen


def _on_one_time_base(file: LogFile, feeds: dict[str, Feed]) -> tuple[Column, dict[str, Column], bool]:
    """Channels in SI at the rows of the mapped time, or else of the fastest signal that a diagnosis needs.

    Returns (n,) s; columns (n,) by channel; whether the time is the file's own clock.
    """
    asked = Counter(s.name for f in feeds.values() for s in (f.signal, f.direction) if s is not None)
    raw = file.read(n for n in asked if n in file.signals)

    def taken(signal: Signal) -> Column:
        """A signal's numbers, held no longer than a feed still needs them."""
        asked[signal.name] -= 1
        return raw[signal.name] if asked[signal.name] else raw.pop(signal.name)

    columns = {
        channel: to_si(channel, source, taken(signal), None if direction is None else taken(direction))
        for channel, (source, signal, direction) in feeds.items()
        if signal.name in raw
    }
    mapped = columns.pop("time", None)
    if not columns:
        raise InputError("no usable channels: the map gives a time alone")
    # One row without its time would be lost; the file's own stamps serve all of them.
    if mapped is not None and isinstance(file, McapFile) and not np.isfinite(mapped).all():
        mapped = None
    rows = {feeds[c].signal.clock: values.size for c, values in columns.items()}
    needed = [feeds[c].signal.clock for c in _REQUIRED if c in columns] or list(rows)
    main = feeds["time"].signal.clock if "time" in feeds else max(needed, key=lambda clock: rows[clock])
    at = file.stamps(main)
    rows_at = mapped if at is None else at
    if rows_at is None:
        raise InputError("no time", mend="say with --map which column is the time")
    for channel, values in columns.items():
        clock, late = feeds[channel].signal.clock, feeds[channel].source.delay
        if clock == main and late == 0.0:
            continue
        own = rows_at if clock == main else file.stamps(clock)
        if own is None or (clock != main and at is None):
            problem = f"channel {channel} has {values.size} rows, the time has {rows.get(main, 0)}"
            raise InputError(problem, mend="map channels of one rate, or a file that has a time for each")
        columns[channel] = aligned(rows_at, own - late, values)
    return (rows_at, columns, True) if mapped is None else (mapped, columns, False)


def as_log(samples: Samples, axis: str | None = None, *, shortest: float = 2.0) -> Log:
    """Samples at hand as `read_log` would give them from a file; `axis` is what the answer calls it. An
    InputError where they are shorter than `shortest` s, lack a channel, or seem to be in another unit."""
    made, quality = _judged(samples.time, samples.columns, {}, {}, shortest)
    return Log(made, quality, "samples", axis)


def _judged(
    time: Column, columns: dict[str, Column], made: dict[str, ChannelSource], units: dict[str, str],
    shortest: float,
) -> tuple[Samples, DataQuality]:  # fmt: skip
    """Channels that a diagnosis can use, and what is odd; `made`: the map's, some of them from others."""
    quality = check_time(time, shortest)
    notes: list[str] = []
    empty = []
    for channel, values in list(columns.items()):
        if count := int((infinite := np.isinf(values)).sum()):
            columns[channel] = values = np.where(infinite, np.nan, values)
            notes.append(f"{channel}: {count} infinite values taken as missing")
        if not np.isfinite(values).any():
            empty.append(channel)
            del columns[channel]
    of_command = "pump_speed" in made and made["pump_speed"].from_ == "command"
    demanded = of_command and "command" in columns and "pump_speed" not in columns
    if absent := missing_required({*columns, *(["pump_speed"] if demanded else [])}):
        silent = f" ({', '.join(empty)} without a single value)" if empty else ""
        mend = "record them, or name their columns with --map"
        raise InputError(f"missing channels: {', '.join(absent)}{silent}", mend=mend)
    check_magnitudes(columns, units)
    recorded = set(columns)
    if demanded:
        columns["pump_speed"] = columns["command"]
        told = "the command stands in for it: what the drive does not follow looks like a leak"
        quality.notes.append(f"pump_speed: not measured, {told}")
    if "pump_angle" not in columns:
        stands_for = made["pump_angle"].period if "pump_angle" in made else None
        columns["pump_angle"] = accumulate_speed(time, columns["pump_speed"], stands_for or quality.period)
    if "pressure_difference" not in columns:
        columns["pressure_difference"] = columns["pressure_1"] - columns["pressure_2"]
    slow = set()
    for name, values in columns.items():
        found = None if name in _HOLDS else own_measurements(time, values, quality.period)
        columns[name], own = found or (values, own_period(time, values, quality.period))
        if own is not None:
            slow.add(name)
        if own is not None and name in recorded:
            held = ", held or interpolated in between: taken as missing there" if found else ""
            every = f"measured every {own * 1e3:.4g} ms, the rows every {quality.period * 1e3:.4g} ms"
            notes.append(f"{name}: {every}{held}")
    # Rows with a speed alone tell nothing that its angle does not.
    meeting = on_common_rows(time, columns, [n for n in _REQUIRED[:-1] if n != "pump_speed"])
    if meeting is not None:
        for name, values in columns.items():
            held_on = name in ("oil_temperature", *_HOLDS)
            columns[name] = values[meeting] if held_on else between(time, values, meeting)
        time = time[meeting]
        quality.period = nominal_period(time)
        notes.append(f"rows are those that were measured, every {quality.period * 1e3:.4g} ms")
    count_missing({n: v for n, v in columns.items() if n in recorded - slow}, quality)
    quality.notes += notes + [f"{name}: no value at all, taken as absent" for name in empty]
    return Samples(time, columns), quality
