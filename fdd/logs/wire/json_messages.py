"""JSON messages to columns: all of a chunk parsed in one call, one by one where that does not take them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import orjson

from fdd.bounds import DEEPEST_MESSAGE, MOST_ELEMENTS
from fdd.logs.wire.chunks import Batch, Field, FieldPath
from fdd.samples import Column

_LOOKED_AT = 20
_UNIT_KEYS = ("unit", "units", "x-unit")


class JsonMessages:
    """See `fdd.logs.wire.chunks.Decoder`.

    Parameters
    ----------
    schema : JSON Schema of the messages; b"" where there is none.
    """

    def __init__(self, schema: bytes = b"") -> None:
        self._units: dict[FieldPath, str] = {}
        with suppress(ValueError, RecursionError):  # no JSON
            self._units = dict(_units_below(json.loads(schema), ()))

    def fields(self, first: Batch) -> list[Field]:
        """The numbers in the first messages."""
        found: dict[FieldPath, None] = {}
        for text in first.payloads(_LOOKED_AT):
            for path in _paths(_object(text)):
                found[path] = None
        return [Field(p, self._units.get(p)) for p in found]

    def columns(self, batch: Batch, paths: Sequence[FieldPath]) -> list[Column]:
        """See `Decoder.columns`."""
        payloads = batch.payloads()
        messages = objects_at_once(payloads) or [_object(p) for p in payloads]
        return [_numbers(messages, path) for path in paths]


def objects_at_once(payloads: Sequence[bytes]) -> list[dict[str, Any]] | None:
    """Parse one JSON object from each payload in a single call; None where any is something else.

    Examples
    --------
    >>> objects_at_once([b'{"x": 1}', b'{"x": 2}']), objects_at_once([b'{"x": 1}', b"2"])
    ([{'x': 1}, {'x': 2}], None)
    """
    joined = b"[" + b",".join(payloads) + b"]"
    try:
        found = orjson.loads(joined)
    except orjson.JSONDecodeError:
        # Python's own takes NaN and integers of any size, at several times the cost.
        try:
            found = json.loads(joined)
        except (ValueError, RecursionError):
            return None
    # One payload may hold two objects with a comma between them.
    whole = len(found) == len(payloads) and all(type(one) is dict for one in found)
    return list(found) if whole else None


def _object(text: bytes) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"not JSON ({type(error).__name__}): {text[:40]!r}") from None
    if not isinstance(found, dict):
        raise ValueError(f"not a JSON object: {text[:40]!r}")
    return found


def _paths(value: Any, before: FieldPath = ()) -> Iterator[FieldPath]:
    if isinstance(value, dict) and len(before) < DEEPEST_MESSAGE:
        for key, inner in value.items():
            yield from _paths(inner, (*before, key))
    elif isinstance(value, list) and len(before) < DEEPEST_MESSAGE:
        for k, inner in enumerate(value[:MOST_ELEMENTS]):
            yield from _paths(inner, (*before, k))
    elif isinstance(value, bool | int | float) and before:
        yield before


def _numbers(messages: Sequence[Mapping[str, Any]], path: FieldPath) -> Column:
    values: list[Any] = [m.get(str(path[0])) for m in messages]
    for part in path[1:]:
        if isinstance(part, int):
            values = [v[part] if isinstance(v, list) and part < len(v) else None for v in values]
        else:
            values = [v.get(part) if isinstance(v, dict) else None for v in values]
    try:
        return np.array(values, dtype=np.float64).reshape(len(messages))
    except (TypeError, ValueError, OverflowError):
        odd = next((v for v in values if v is not None and not isinstance(v, int | float)), values[0])
        raise ValueError(f"{str(odd)[:40]!r} is not a number") from None


def _units_below(node: Any, path: FieldPath) -> Iterator[tuple[FieldPath, str]]:
    if not isinstance(node, dict) or len(path) > DEEPEST_MESSAGE:
        return
    unit = next((node[k] for k in _UNIT_KEYS if isinstance(node.get(k), str)), None)
    if unit and path:
        yield path, unit
    members = node.get("properties")
    for key, inner in members.items() if isinstance(members, dict) else ():
        yield from _units_below(inner, (*path, str(key)))
