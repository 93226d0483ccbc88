"""From a file's signals to channels in SI, by a map or the contract's names; angles of counts and speeds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fdd.errors import InputError, listed
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.formats.mcap import AXIS_TOPIC, McapFile
from fdd.logs.formats.signals import LogFile, Signal
from fdd.logs.quality import sample_numbers
from fdd.measures import find_measure
from fdd.samples import CHANNELS, Column

LONGEST_BRIDGE = 1.0
"""s; over a longer gap nobody knows how far the pump turned, and nothing is added."""


class Feed(NamedTuple):
    """A channel's source in an opened file, its signal, and the one whose sign is the direction.

    Of a time without a column the signal's clock alone counts.
    """

    source: ChannelSource
    signal: Signal
    direction: Signal | None = None


def feeds_of(
    log: LogFile, channel_map: ChannelMap | None, axis: str | None
) -> tuple[dict[str, Feed], str | None]:
    """The feeds by channel, and the axis.

    Raises InputError: nothing that the map or the contract names is in the file, or the file has several
    axes.
    """
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


def to_si(channel: str, source: ChannelSource, raw: Column, direction: Column | None = None) -> Column:
    """One channel in its SI unit, (n,): unwrap, give direction, scale, convert.

    `source`: the map's entry. `raw`, `direction`: (n,) numbers as they stand in the log, and those of the
    column named by ``sign_of``.
    """
    unit = source.measure_of(channel)
    values = raw if source.wrap is None else unwrap_counts(raw, source.wrap)
    if direction is not None:
        values = directed(values, direction, accumulate=unit.dimension == "angle")
    for factor, offset in ((source.scale * source.sign, source.offset), (unit.factor, unit.offset)):
        if (factor, offset) != (1.0, 0.0):
            values = factor * values + offset
    return np.asarray(values, dtype=np.float64)


def unwrap_counts(raw: Column, wrap: float) -> Column:
    """An angle that starts again at 0 each `wrap` counts, made continuous; NaN stays and is passed over."""
    out, there = raw.copy(), np.isfinite(raw)
    out[there] = np.unwrap(raw[there], period=wrap)
    return out


def directed(raw: Column, direction: Column, *, accumulate: bool) -> Column:
    """Give a quantity, (n,), NaN where missing, the sign of another one, e.g. of a directional valve.

    `direction`: (n,) only its sign counts; NaN keeps the last sign. Before the first one a value is missing,
    and an angle stands. `accumulate`: for an angle, of which each step takes the sign of the row it ends in.
    """
    known = np.where(np.isfinite(direction), np.arange(direction.size), -1)
    last = np.maximum.accumulate(known) if known.size else known
    sign = np.where(last >= 0, np.sign(direction[last]), 0.0 if accumulate else np.nan)
    if not accumulate:
        return np.asarray(raw * sign)
    out = raw.copy()
    there = np.flatnonzero(np.isfinite(raw))
    if there.size:
        steps = np.diff(raw[there]) * sign[there[1:]]
        out[there] = np.concatenate(([raw[there[0]]], raw[there[0]] + np.cumsum(steps)))
    return out


def accumulate_speed(time: Column, speed: Column, period: float) -> Column:
    """Angle from speed samples, each of which stands for one nominal period.

    Where the speed is a count difference over the nominal period, this gives the counts back exactly.
    Missing rows and NaN are bridged by the mean of their neighbours times the periods missed, up to
    `LONGEST_BRIDGE`.

    `time`: (n,) s, increasing. `speed`: (n,) rad/s, NaN where missing. `period`: s.

    Returns (n,) rad, 0 at the first row that has a speed; NaN where the speed is NaN.
    """
    angle = np.full(time.size, np.nan)
    there = np.flatnonzero(np.isfinite(speed))
    if there.size == 0:
        return angle
    missed = np.diff(sample_numbers(time, period)[there]) - 1
    present = speed[there]
    missed[missed * period > LONGEST_BRIDGE] = 0
    turned = period * (present[1:] + missed * 0.5 * (present[1:] + present[:-1]))
    del missed, present
    angle[there] = np.concatenate(([0.0], np.cumsum(turned, out=turned)))
    return angle
