"""From raw columns to channels in SI, as a channel map says."""

from __future__ import annotations

import numpy as np

from fdd.logs.angles import directed, unwrap_counts
from fdd.logs.channel_map import ChannelSource
from fdd.samples import Column


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
    scale = source.scale * source.sign
    if scale != 1.0 or source.offset != 0.0:
        values = scale * values + source.offset
    if unit.factor != 1.0 or unit.offset != 0.0:
        values = unit.factor * values + unit.offset
    return np.asarray(values, dtype=np.float64)
