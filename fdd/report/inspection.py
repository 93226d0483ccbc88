"""The page of ``fdd inspect --html``: a table of signals with a drawn course each; no script."""

from __future__ import annotations

import numpy as np

from fdd.logs.inspection import SignalView
from fdd.report.page import template

_WIDTH, _HEIGHT, _POINTS = 320, 48, 240


def inspection_page(name: str, kind: str, views: list[SignalView]) -> str:
    """The page of a log of that name and format, as HTML."""
    return template("inspection.html").render(
        name=name, kind=kind, views=views, lines={v.name: course(v) for v in views}, width=_WIDTH,
        height=_HEIGHT,
    )  # fmt: skip


def course(view: SignalView) -> str:
    """Points of an SVG line: the least and greatest value of each part of the signal."""
    values = view.values
    if values.size < 2 or not np.isfinite(values).any() or view.high == view.low:
        return f"0,{_HEIGHT / 2} {_WIDTH},{_HEIGHT / 2}" if values.size else ""
    points = []
    parts = np.array_split(values, min(_POINTS // 2, values.size))
    for k, part in enumerate(parts):
        there = part[np.isfinite(part)]
        if there.size:
            x = _WIDTH * k / (len(parts) - 1)
            for v in dict.fromkeys((float(there.min()), float(there.max()))):
                points.append(f"{x:.1f},{_HEIGHT * (1 - (v - view.low) / (view.high - view.low)):.1f}")
    return " ".join(points)
