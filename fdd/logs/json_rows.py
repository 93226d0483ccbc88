"""Columns to JSON objects, a row each, without a Python loop over the values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, Any]
"""Name to (n,) numbers or booleans, or to a mapping of the same kind (a nested object)."""


def json_rows(columns: Columns) -> list[bytes]:
    """One JSON object per row; a value that is not finite is left out, as JSON has none.

    Numbers are written with the digits that give them back exactly.

    Parameters
    ----------
    columns : name to (n,) values, or to a nested mapping of such.

    Returns
    -------
    n objects, UTF-8.

    Examples
    --------
    >>> json_rows({"time": np.array([0.0, 0.5]), "ekf": {"leakage": np.array([np.nan, 1e-12])}})
    [b'{"time":0,"ekf":{}}', b'{"time":0.5,"ekf":{"leakage":1e-12}}']
    """
    rows = _objects(columns)
    return [] if rows is None else [text.encode() for text in rows.to_pylist()]


def _objects(columns: Columns) -> Any:
    import pyarrow as pa
    import pyarrow.compute as pc

    members = []
    for name, values in columns.items():
        key = pa.scalar(f",{json.dumps(name)}:")
        texts = _objects(values) if isinstance(values, Mapping) else _texts(np.asarray(values))
        if texts is not None:
            members.append(pc.binary_join_element_wise(key, texts, "", null_handling="emit_null"))
    if not members:
        return None
    # Each member brings its comma, and the first one is cut off: joining with null_handling="skip" loses
    # the rows in which every member is null.
    inner = pc.binary_join_element_wise(*members, "", null_handling="replace", null_replacement="")
    inner = pc.utf8_slice_codeunits(inner, start=1)
    return pc.binary_join_element_wise("{", inner, "}", "", null_handling="emit_null")


def _texts(values: NDArray[Any]) -> Any:
    """Numbers as text; null where a value is not finite."""
    import pyarrow as pa

    if values.dtype == np.bool_:
        return pa.array(values).cast(pa.string())
    if np.issubdtype(values.dtype, np.integer):
        return pa.array(values.astype(np.int64)).cast(pa.string())
    numbers = np.ascontiguousarray(values, dtype=np.float64)
    return pa.array(numbers, mask=~np.isfinite(numbers)).cast(pa.string())


def json_schema(columns: Columns, title: str, units: Mapping[str, str] | None = None) -> bytes:
    """JSON schema of `json_rows`' objects; `units` become the members' descriptions.

    Examples
    --------
    >>> json.loads(json_schema({"time": np.zeros(1)}, "T", {"time": "s"}))["properties"]
    {'time': {'type': 'number', 'description': 's'}}
    """
    return json.dumps({"title": title, **_schema(columns, units or {})}, ensure_ascii=False).encode()


def _schema(columns: Columns, units: Mapping[str, str]) -> dict[str, Any]:
    members: dict[str, Any] = {}
    for name, values in columns.items():
        if isinstance(values, Mapping):
            members[name] = _schema(values, units)
            continue
        kind = "boolean" if np.asarray(values).dtype == np.bool_ else "number"
        members[name] = {"type": kind, **({"description": units[name]} if name in units else {})}
    return {"type": "object", "properties": members}
