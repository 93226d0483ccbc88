"""The JSON form of a block: objects, lists of numbers, times."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from fdd.bounds import MOST_BLOCK_ROWS
from fdd.errors import InputError

Array = NDArray[np.float64]


def json_object(payload: bytes) -> dict[str, Any]:
    """A message's JSON object; NaN is taken as Python writes it.

    Raises
    ------
    InputError : it is none.
    """
    try:
        found = orjson.loads(payload)
    except orjson.JSONDecodeError:
        # Python's own takes NaN and integers of any size, at several times the cost.
        try:
            found = json.loads(payload)
        except (ValueError, RecursionError):
            found = None
    if not isinstance(found, dict):
        raise InputError(
            f"neither a JSON object nor an Arrow stream: {payload[:40]!r}",
            mend="send messages of fdd.block/1",
        )
    return found


def json_numbers(name: str, values: object) -> Array:
    """A column (n,) of a list of numbers; null is NaN.

    Raises
    ------
    InputError : it is none, or too long.
    """
    if isinstance(values, list) and len(values) <= MOST_BLOCK_ROWS:
        try:
            column = np.array(values)
            if column.dtype == object and not any(isinstance(v, str) for v in values):
                column = np.array(values, dtype=np.float64)  # null becomes NaN
            if column.ndim == 1 and (column.dtype.kind in "fiu" or not column.size):
                return column.astype(np.float64, copy=False)
        except (TypeError, ValueError, OverflowError):
            pass
    raise InputError(
        f"column {name[:40]!r} is no list of at most {MOST_BLOCK_ROWS} numbers",
        mend="write null for missing ones",
    )


def json_times(given: object) -> Array:
    """Times (n,) in s of a list, or of start, period and n.

    Raises
    ------
    InputError : it is neither.
    """
    if not isinstance(given, dict):
        return json_numbers("time", given)
    start, period, n = given.get("start"), given.get("period"), given.get("n")
    if (
        not isinstance(start, int | float)
        or not isinstance(period, int | float)
        or not isinstance(n, int)
        or bool in (type(start), type(period), type(n))
        or not 1 <= n <= MOST_BLOCK_ROWS
        or len(given) > 3
    ):
        raise InputError(
            f"time is no object of start, period and n (1 to {MOST_BLOCK_ROWS})",
            mend='write "time": {"start": 12.3, "period": 0.001, "n": 100}',
        )
    try:
        return float(start) + float(period) * np.arange(n, dtype=np.float64)
    except OverflowError:
        raise InputError("time starts, or goes on, beyond any number") from None
