"""From raw columns to channels in SI, as a channel map says; angles from counts, valves and speeds."""

from __future__ import annotations

import numpy as np

from fdd.logs.channel_map import ChannelSource
from fdd.logs.stamps import sample_numbers
from fdd.samples import Column

LONGEST_BRIDGE = 1.0
"""s; over a longer gap nobody knows how far the pump turned, and nothing is added."""


def to_si(channel: str, source: ChannelSource, raw: Column, direction: Column | None = None) -> Column:
    """One channel in SI: unwrap, give direction, scale, convert.

    Parameters
    ----------
    channel : its name in the contract.
    source : the map's entry.
    raw : (n,) numbers as they stand in the log.
    direction : (n,) column named by ``sign_of``.

    Returns
    -------
    (n,) values in the channel's SI unit.
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
    """Give a quantity the sign of another one, e.g. of a directional valve.

    Parameters
    ----------
    raw : (n,) values; NaN where missing.
    direction : (n,) only its sign counts; NaN keeps the last sign. Before the first one a value is missing,
        and an angle stands.
    accumulate : True for an angle: each step takes the sign of the row it ends
        in. False multiplies the values.
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

    Where the speed is a count difference over the nominal period, this gives the
    counts back exactly. Missing rows and NaN are bridged by the mean of their
    neighbours times the periods missed, up to `LONGEST_BRIDGE`.

    Parameters
    ----------
    time : (n,) s, increasing.
    speed : (n,) rad/s, NaN where missing.
    period : s.

    Returns
    -------
    (n,) rad, 0 at the first row that has a speed; NaN where the speed is NaN.
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
