"""Traces and shapes of plotly figures, as plain dictionaries with compact arrays.

Nothing here imports plotly: its classes check every value in Python, which costs
more than the diagnosis itself.
"""

from __future__ import annotations

import base64
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.report.decimate import BUCKETS, break_at_gaps, decimate, envelope

Column = NDArray[np.float64]
Trace = dict[str, Any]

# Okabe and Ito's palette, told apart by all common kinds of colour vision.
BLUE, VERMILLION, GREEN, ORANGE = "#0072B2", "#D55E00", "#009E73", "#E69F00"
SKY, PURPLE, YELLOW, GREY = "#56B4E9", "#CC79A7", "#F0E442", "#8A8F98"
MARK = "mark"
"""Name of the shapes and labels that the page paints in its text colour, light or dark."""
LINE_COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, GREY)


def packed(values: NDArray[Any]) -> dict[str, str]:
    """An array as plotly.js reads it compactly: base64 of single precision.

    Six digits are more than a plot shows; the bits of single precision beyond them are 0 and pack well.
    Times far from zero (epoch seconds) keep double precision.
    """
    flat = np.ascontiguousarray(values, dtype=np.float64)
    finite = flat[np.isfinite(flat)]
    kind = "f4"
    if finite.size:
        reach, extent = float(np.abs(finite).max()), float(np.ptp(finite))
        if reach > 1e30 or (extent > 0.0 and reach > 200.0 * extent):
            kind = "f8"
    raw = flat.astype(f"<{kind}")
    if kind == "f4":
        bits = raw.view("<u4")
        bits += 4  # rounded, not cut
        bits &= 0xFFFFFFF8
    return {"dtype": kind, "bdata": base64.b64encode(raw.tobytes()).decode("ascii")}


def on_grid(time: Column) -> Column:
    """Times to a hundred-thousandth of what they span, which no plot shows: the bits below do not pack.

    Examples
    --------
    >>> on_grid(np.array([0.0, 0.001, np.nan, 60.0])).tolist()
    [0.0, 0.0009765625, nan, 60.0]
    """
    finite = time[np.isfinite(time)]
    span = float(np.ptp(finite)) if finite.size else 0.0
    if span <= 0.0:
        return time
    step = 2.0 ** (np.ceil(np.log2(span)) - 17.0)
    return np.asarray(np.round(time / step) * step)


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
    return scatter(
        packed(on_grid(t)), packed(y), name, line=style, showlegend=legend, legendgroup=label(name)
    )


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
    x, y = packed(on_grid(np.concatenate(xs))), packed(np.concatenate(ys))
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


def upright_label(at: float, text: str, *, left: bool) -> dict[str, Any]:
    """The name of a vertical line, above the plot, to its left or right."""
    return {
        "x": round(at, 4), "y": 1, "xref": "x", "yref": "paper", "yanchor": "bottom",
        "xanchor": "right" if left else "left", "text": label(text), "showarrow": False,
        "font": {"size": 11}, "name": MARK,
    }  # fmt: skip
