"""JSON messages: all of a chunk parsed in one call, one by one where that does not take them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import orjson

from fdd.bounds import DEEPEST_MESSAGE

_UNIT_KEYS = ("unit", "units", "x-unit")


def json_objects(payloads: Sequence[bytes]) -> list[dict[str, Any]]:
    """One object from each payload; ValueError shows the first that holds none."""
    return objects_at_once(payloads) or [_object(p) for p in payloads]


def objects_at_once(payloads: Sequence[bytes]) -> list[dict[str, Any]] | None:
    """Parse one JSON object from each payload in a single call; None where any is something else."""
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


def schema_units(schema: bytes) -> dict[tuple[str | int, ...], str]:
    """Path of a number to the unit that a JSON Schema gives; nothing of a text that is none."""
    with suppress(ValueError, RecursionError):
        return dict(_units_below(json.loads(schema), ()))
    return {}


def _units_below(node: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    if not isinstance(node, dict) or len(path) > DEEPEST_MESSAGE:
        return
    unit = next((node[k] for k in _UNIT_KEYS if isinstance(node.get(k), str)), None)
    if unit and path:
        yield path, unit
    members = node.get("properties")
    for key, inner in members.items() if isinstance(members, dict) else ():
        yield from _units_below(inner, (*path, str(key)))
