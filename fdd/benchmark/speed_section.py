"""The report's section on speed; `fdd.benchmark.speed`, where it is there, does the measuring."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import astuple, fields, is_dataclass
from typing import Any

PACKAGE = "fdd.benchmark.speed"


def measure_speed() -> list[Any]:
    """Rows of the speed measurement, dataclasses with name, figures and a note; none without that package."""
    try:
        package = importlib.import_module(PACKAGE)
    except ModuleNotFoundError as missing:
        if missing.name != PACKAGE:
            raise
        return []
    return list(package.measure())


def speed_lines(rows: Sequence[Any]) -> list[str]:
    """The section as lines of Markdown, empty without rows.

    Examples
    --------
    >>> speed_lines([])
    []
    """
    if not rows:
        return []
    if not is_dataclass(rows[0]):
        raise TypeError(f"rows of {PACKAGE} are dataclasses, not {type(rows[0]).__name__}")
    head = [field.name.replace("_", " ") for field in fields(rows[0])]
    body = [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in astuple(row)] for row in rows]
    lines = [head, ["---"] * len(head), *body]
    return ["## Speed", "", *["| " + " | ".join(line) + " |" for line in lines], ""]
