"""Traces and shapes of plotly figures, as plain dictionaries with compact arrays of fewer points.

Nothing here imports plotly: its classes check every value in Python, which costs
more than the diagnosis itself.
"""

from __future__ import annotations

import base64
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.float64]
Trace = dict[str, Any]

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW, GREY = "#56B4E9", "#CC79A7", "#F0E442", "#8A8F98"
MARK = "mark"
"""Name of the shapes and labels that the page paints in its text colour, light or dark."""
LINE_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, GREY)
BUCKETS = 500
"""Buckets per signal: about one per pixel of a plot; those over the whole page have twice as many pixels."""
KEPT_PER_BUCKET = 6
"""First, last, lowest, highest, and the first and last missing value."""


def packed(values: NDArray[Any]) -> dict[str, str]:
    """An array as plotly.js reads it compactly: base64 of single precision, whose seven digits are more than
    a plot shows; of double where the values are far from zero beside what they span (epoch seconds)."""
    flat = np.ascontiguousarray(values, dtype=np.float64)
    finite = flat[np.isfinite(flat)]
    kind = "f4"
    if finite.size:
        reach, extent = float(np.abs(finite).max()), float(np.ptp(finite))
        if reach > 1e30 or (extent > 0.0 and reach > 200.0 * extent):
            kind = "f8"
    return {"dtype": kind, "bdata": base64.b64encode(flat.astype(f"<{kind}").tobytes()).decode("ascii")}


def label(text: str) -> str:
    """Text for a figure: plotly reads a little HTML in labels, so angle brackets are escaped."""
    return escape(text, quote=False)


def scatter(x: Any, y: Any, name: str | None = None, *, mode: str = "lines", **more: Any) -> Trace:
    """A trace of lines or markers; x and y as plotly reads them."""
    named = {} if name is None else {"name": label(name)}
    return {"type": "scatter", "mode": mode, **named, "x": x, "y": y, **more}


def layout(x: str = "time (s)", **y_axis: Any) -> dict[str, Any]:
    """The layout that all figures have; `y_axis` beside or instead of what is usual."""
    return {
        "xaxis": {"title": {"text": x}, "hoverformat": ".2f", "exponentformat": "none"},
        "yaxis": {"hoverformat": ".4~g", **y_axis},
        "shapes": [],
        "annotations": [],
    }


def line(
    time: Column, values: Column, name: str, colour: str, *, dash: str = "solid", width: float = 1.6,
    legend: bool = True, buckets: int = BUCKETS,
) -> Trace:  # fmt: skip
    """A signal over time, decimated; breaks where values or samples are missing."""
    t, y = decimate(*break_at_gaps(time, values), buckets)
    style = {"color": colour, "width": width, "dash": dash, "shape": "linear"}
    return scatter(packed(t), packed(y), name, line=style, showlegend=legend, legendgroup=label(name))


def band(time: Column, low: Column, high: Column, group: str, colour: str) -> Trace:
    """A filled band, one polygon per stretch without gaps."""
    t, a, b = envelope(time, low, high, BUCKETS // 2)
    good = np.isfinite(a) & np.isfinite(b)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], good.astype(np.int8), [0]))))
    xs, ys, gap = [np.empty(0)], [np.empty(0)], np.array([np.nan])
    for start, stop in edges.reshape(-1, 2):
        # There and back, then a break before the next polygon.
        xs += [t[start:stop], t[start:stop][::-1], gap]
        ys += [b[start:stop], a[start:stop][::-1], gap]
    x, y = packed(np.concatenate(xs)), packed(np.concatenate(ys))
    return {**outline(x, y, colour), "legendgroup": label(group)}


def outline(x: Any, y: Any, colour: str) -> Trace:
    """A closed outline, filled faintly."""
    return scatter(
        x, y, fill="toself", fillcolor=_faded(colour, 0.16), line={"width": 0}, hoverinfo="skip",
        showlegend=False,
    )  # fmt: skip


def level(time: Column, value: float, name: str, *, colour: str, dash: str = "dash") -> Trace:
    """A horizontal line from the first to the last time, e.g. a threshold."""
    ends = np.array([time[0], time[-1]]) if time.size else np.empty(0)
    return scatter(
        packed(ends), packed(np.full(ends.size, value)), name,
        line={"color": colour, "width": 1.6, "dash": dash}, hoverinfo="skip",
    )  # fmt: skip


def _faded(colour: str, opacity: float) -> str:
    """``#rrggbb`` as ``rgba(…)``."""
    r, g, b = bytes.fromhex(colour[1:])
    return f"rgba({r},{g},{b},{opacity})"


def shade(start: float, stop: float) -> dict[str, Any]:
    """A grey stretch of time behind the lines, from the bottom of the plot to its top."""
    ends = {"x0": round(start, 4), "x1": round(stop, 4), "y0": 0, "y1": 1}
    style = {"fillcolor": _faded(GREY, 0.17), "line": {"width": 0}, "layer": "below"}
    return {"type": "rect", "xref": "x", "yref": "paper", **ends, **style}


def upright(at: float, *, dash: str) -> dict[str, Any]:
    """A vertical line through the whole plot."""
    ends = {"x0": round(at, 4), "x1": round(at, 4), "y0": 0, "y1": 1}
    style = {"line": {"width": 1.5, "dash": dash}, "name": MARK}
    return {"type": "line", "xref": "x", "yref": "paper", **ends, **style}


def bar_at_top(start: float, stop: float) -> dict[str, Any]:
    """A horizontal bar along the plot's upper edge."""
    ends = {"x0": round(start, 4), "x1": round(stop, 4), "y0": 1, "y1": 1}
    return {"type": "line", "xref": "x", "yref": "paper", **ends, "line": {"width": 5}, "name": MARK}


def upright_label(at: float, text: str, *, left: bool) -> dict[str, Any]:
    """The name of a vertical line, above the plot, to its left or right."""
    return {
        "x": round(at, 4), "y": 1, "xref": "x", "yref": "paper", "yanchor": "bottom",
        "xanchor": "right" if left else "left", "text": label(text), "showarrow": False,
        "font": {"size": 11}, "name": MARK,
    }  # fmt: skip


def decimate(time: Column, values: Column, buckets: int = BUCKETS) -> tuple[Column, Column]:
    """Keep each bucket's first, lowest, highest and last value, and its gaps; all where n is small already.

    The line drawn through what is kept (k,) covers the same pixels as the line through everything: M4 of
    Jugel et al., doi:10.14778/2732951.2732953, with missing values kept as breaks. Of increasing `time` (n,)
    and `values` (n,), NaN where missing, each of `buckets` of equal length keeps at most `KEPT_PER_BUCKET`
    points, four where none is missing.
    """
    n = values.size
    if n <= 4 * buckets:
        return time, values
    size = -(-n // buckets)
    table = np.pad(values, (0, -n % size), constant_values=np.nan).reshape(-1, size)
    missing = np.isnan(table)
    start = np.arange(len(table)) * size
    # Padding must not count as a gap: the last bucket ends at the last sample.
    last_of = np.minimum(start + size, n) - 1
    real_gap = missing & (start[:, None] + np.arange(size) < n)
    has_gap = real_gap.any(axis=1)
    keep = np.zeros(n, dtype=bool)
    keep[start] = keep[last_of] = True
    keep[np.minimum(start + np.where(missing, np.inf, table).argmin(axis=1), last_of)] = True
    keep[np.minimum(start + np.where(missing, -np.inf, table).argmax(axis=1), last_of)] = True
    keep[(start + real_gap.argmax(axis=1))[has_gap]] = True
    keep[(start + size - 1 - real_gap[:, ::-1].argmax(axis=1))[has_gap]] = True
    return time[keep], values[keep]


def envelope(
    time: Column, low: Column, high: Column, buckets: int = BUCKETS
) -> tuple[Column, Column, Column]:
    """Bucket-wise outline of a band (n,), NaN where there is none: lowest `low` and highest `high` at the mid
    times of at most so many `buckets`; NaN where a bucket has no band at all."""
    n = time.size
    if n <= buckets:
        return time, low, high
    start = np.arange(0, n, -(-n // buckets))
    stop = np.append(start[1:], n) - 1
    missing = np.isnan(low) | np.isnan(high)
    lowest = np.minimum.reduceat(np.where(missing, np.inf, low), start)
    highest = np.maximum.reduceat(np.where(missing, -np.inf, high), start)
    empty = np.isinf(lowest) | np.isinf(highest)
    mid = 0.5 * (time[start] + time[stop])
    # The outline reaches to both ends of the log.
    mid[0], mid[-1] = time[0], time[-1]
    return mid, np.where(empty, np.nan, lowest), np.where(empty, np.nan, highest)


def bucket_means(values: NDArray[np.float64], buckets: int = BUCKETS) -> NDArray[np.float64]:
    """Means over buckets of consecutive rows: (m, k) to at most (buckets, k), (m,) likewise; m > 0."""
    parts = np.array_split(values, min(buckets, len(values)))
    return np.array([part.mean(axis=0) for part in parts])


def break_at_gaps(time: Column, values: Column) -> tuple[Column, Column]:
    """Put a NaN into every hole in time, so that no line is drawn across dropped samples.

    A hole is longer than ten usual steps and long enough to be seen (1/500 of the log).
    """
    if time.size < 3:
        return time, values
    steps = np.diff(time)
    limit = max(10.0 * float(np.median(steps)), float(time[-1] - time[0]) / 500.0)
    holes = np.flatnonzero(steps > limit)
    if not holes.size:
        return time, values
    middle = 0.5 * (time[holes] + time[holes + 1])
    return np.insert(time, holes + 1, middle), np.insert(values, holes + 1, np.nan)


def intervals(time: Column, mask: NDArray[np.bool_], at_most: int = 150) -> list[tuple[float, float]]:
    """Stretches of `time` (n,) where `mask` (n,) holds, close neighbours joined until there are so few."""
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    begin, end = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    if not begin.size:
        return []
    starts, stops = time[begin], time[np.minimum(end, time.size - 1)]
    if starts.size > at_most:
        widths = starts[1:] - stops[:-1]
        widest = np.sort(np.argpartition(widths, -(at_most - 1))[-(at_most - 1) :])
        starts = np.concatenate((starts[:1], starts[widest + 1]))
        stops = np.concatenate((stops[widest], stops[-1:]))
    return [(float(a), float(b)) for a, b in zip(starts, stops, strict=True)]
