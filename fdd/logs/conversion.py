"""From raw columns to channels in SI, as a channel map says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fdd.logs.angles import directed, unwrap_counts
from fdd.logs.channel_map import ChannelSource

Column = NDArray[np.float64]


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

    Examples
    --------
    >>> to_si("position", ChannelSource(column="x", unit="mm"), np.array([5.0])).tolist()
    [0.005]
    """
    values = raw if source.wrap is None else unwrap_counts(raw, source.wrap)
    if direction is not None:
        values = directed(values, direction, accumulate=source.measure_of(channel).dimension == "angle")
    unit = source.measure_of(channel)
    scale = source.scale * source.sign
    if scale != 1.0 or source.offset != 0.0:
        values = scale * values + source.offset
    if unit.factor != 1.0 or unit.offset != 0.0:
        values = unit.factor * values + unit.offset
    return np.asarray(values, dtype=np.float64)


def checked_finite(columns: Mapping[str, Column]) -> tuple[dict[str, Column], list[str]]:
    """Infinite values become missing ones; a note tells how many.

    Returns
    -------
    The columns, and one note per channel that had any.
    """
    out: dict[str, Column] = {}
    notes: list[str] = []
    for channel, values in columns.items():
        infinite = np.isinf(values)
        count = int(infinite.sum())
        out[channel] = np.where(infinite, np.nan, values) if count else values
        if count:
            notes.append(f"{channel}: {count} infinite values taken as missing")
    return out, notes


def with_values(columns: Mapping[str, Column]) -> tuple[dict[str, Column], list[str]]:
    """Leave out channels without a single value.

    Returns
    -------
    The channels that have values, and the names of those that have none.
    """
    empty = [name for name, values in columns.items() if not np.isfinite(values).any()]
    return {k: v for k, v in columns.items() if k not in empty}, empty
