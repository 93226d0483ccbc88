"""A channel map applied to what a stream sends: keys to channels in SI."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.conversion import to_si
from fdd.samples import CHANNELS

Array = NDArray[np.float64]


def stream_sources(channel_map: ChannelMap | None) -> dict[str, ChannelSource]:
    """Where each channel stands in a stream; the contract's names in SI without a map.

    Raises
    ------
    InputError : the map has a topic, `wrap`, or `sign_of` of an angle, which need a whole log.

    Examples
    --------
    >>> stream_sources(ChannelMap.from_yaml("position: {column: x, unit: mm}"))["position"].column
    'x'
    """
    if channel_map is None:
        return {n: ChannelSource(column=n) for n in CHANNELS}
    out: dict[str, ChannelSource] = {}
    for name, source in channel_map.channels.items():
        if source.from_ is not None:
            continue  # the pipeline accumulates the pump's speed itself
        angle = CHANNELS[name].dimension == "angle"
        if source.column is None or source.wrap is not None or (angle and source.sign_of is not None):
            raise InputError(
                f"channel {name}: a stream takes plain columns only (no topic, wrap or sign_of of an angle)",
                mend="name the key of the JSON lines: {column: KEY, unit: UNIT}",
            )
        out[name] = source
    return out


def keys_of(sources: Mapping[str, ChannelSource]) -> dict[str, None]:
    """All keys that are read, in order.

    Examples
    --------
    >>> list(keys_of({"position": ChannelSource(column="x", sign_of="s")}))
    ['x', 's']
    """
    return dict.fromkeys(k for s in sources.values() for k in (s.column, s.sign_of) if k is not None)


def channels_in_si(
    sources: Mapping[str, ChannelSource], raw: Callable[[str], Array | None]
) -> dict[str, Array]:
    """The channels that are there, `time` among them, in SI.

    Parameters
    ----------
    raw : gives the numbers (n,) of a key, None where there are none.

    Raises
    ------
    InputError : the column of a sign is missing.

    Examples
    --------
    >>> sources = {"position": ChannelSource(column="x", unit="mm")}
    >>> channels_in_si(sources, {"x": np.array([5.0])}.get)["position"].tolist()
    [0.005]
    """
    out = {}
    for name, source in sources.items():
        values = raw(str(source.column))
        if values is None:
            continue
        direction = raw(source.sign_of) if source.sign_of else None
        if source.sign_of and direction is None:
            direction = np.full(values.size, np.nan)
        out[name] = to_si(name, source, values, direction)
    return out


def column_of_rows(rows: Sequence[Mapping[str, Any]], key: str) -> Array | None:
    """The numbers of one key in JSON objects, one a row; None where no row has it.

    Examples
    --------
    >>> column_of_rows([{"x": 1}, {"x": None}, {}], "x")
    array([ 1., nan, nan])
    """
    if not any(key in row for row in rows):
        return None
    return np.array([_number(row.get(key)) for row in rows], dtype=np.float64)


def all_numbers(row: Mapping[str, Any], keys: Mapping[str, None]) -> bool:
    """Whether what is read of a JSON object are numbers or null.

    Examples
    --------
    >>> all_numbers({"x": 1, "name": "a"}, {"x": None}), all_numbers({"x": True}, {"x": None})
    (True, False)
    """
    return all(row.get(key) is None or type(row[key]) in (float, int) for key in keys)


def _number(value: Any) -> float:
    if value is None:
        return float("nan")
    try:
        return float(value)
    except OverflowError:  # an integer beyond any float
        return float("inf")
