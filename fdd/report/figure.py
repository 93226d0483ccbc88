"""A diagnosis as one figure of matplotlib, for papers and notebooks: some of the report's plots, stacked."""

from __future__ import annotations

import base64
import html
import re
from itertools import cycle
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fdd.diagnosis.findings import ESTIMATED, Diagnosis, Trajectories
from fdd.pictures import STYLE, require_matplotlib
from fdd.report.plots import Figure as Plot
from fdd.report.plots import sections
from fdd.report.traces import ORANGE, SKY, VERMILLION
from fdd.report.words import fault_title, headline
from fdd.samples import Samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_INCHES, PANEL_INCHES, MARGIN_INCHES = 7.2, 1.3, 1.1
"""Two columns of a journal are 180 mm wide."""
SIGNALS = ("measured-position", "measured-pressures")
PANELS = (*SIGNALS, *(f"estimate-{name}" for name in ESTIMATED), "statistic")
"""What of the report's plots is drawn."""
DASHES = {"solid": "-", "dash": "--", "dot": ":"}
TITLE_WIDTH = 85
"""Characters in a line of the title."""


def draw_diagnosis(diagnosis: Diagnosis, trajectories: Trajectories, samples: Samples) -> Figure:
    """Draw signals, estimates with their 95 % bands and the test statistic over one time axis.

    Onsets (with their 80 % interval) and alarms of what was found go through all panels. Stretches in which
    a quantity could not be known are shaded.

    Raises
    ------
    InputError : matplotlib is missing.
    """
    require_matplotlib()
    import matplotlib
    from matplotlib import pyplot

    found = {plot.id: plot for part in sections(diagnosis, trajectories, samples) for plot in part.figures}
    # A plot has a note where its quantity was never observable.
    shown = [found[name] for name in PANELS if name in found and not found[name].note]
    size = (WIDTH_INCHES, PANEL_INCHES * len(shown) + MARGIN_INCHES)
    with matplotlib.rc_context({**STYLE, "font.size": 8.5, "legend.fontsize": 8}):
        figure = pyplot.figure(figsize=size, dpi=150, layout="constrained")
        panels = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False).ravel()
        known: dict[str, Any] = {}
        for axes, plot in zip(panels, shown, strict=False):
            _panel(axes, plot)
            if plot.id in SIGNALS:  # above the panel, where no signal is
                axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), borderaxespad=0.0, ncols=4)
            _mark_faults(axes, diagnosis)
            if plot.id not in SIGNALS:
                known |= {
                    name: handle for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)
                }
        panels[-1].set_xlabel("time (s)")
        figure.align_ylabels(panels)
        title = f"{diagnosis.log}: {headline(diagnosis)}" if diagnosis.log else headline(diagnosis)
        figure.suptitle(fill(title, TITLE_WIDTH))
        # One legend for what the other panels have in common, each kind once.
        if known:
            figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=4)
    return figure


def _panel(axes: Any, plot: Plot) -> None:
    """One of the report's plots, from what plotly.js is given."""
    for trace in plot.data:
        curve = np.column_stack([
            np.frombuffer(base64.b64decode(trace[k]["bdata"]), f"<{trace[k]['dtype']}") for k in ("x", "y")
        ])  # fmt: skip
        style, name = trace["line"], html.unescape(trace.get("name", trace.get("legendgroup", "")))
        if "fill" in trace:
            *rgb, opacity = map(float, re.findall(r"[\d.]+", trace["fillcolor"]))
            tint = (*np.array(rgb) / 255.0, opacity)
            for part in np.split(curve, np.flatnonzero(np.isnan(curve[:, 0]))):
                if (outline := part[np.isfinite(part).all(axis=1)]).size:
                    axes.fill(*outline.T, color=tint, linewidth=0.0, label=f"{name}, 95 %")
        else:
            label = name if trace.get("showlegend", True) else None
            axes.plot(*curve.T, DASHES[style["dash"]], color=style["color"], linewidth=0.7 * style["width"],
                      label=label)  # fmt: skip
    for shape in (s for s in plot.layout["shapes"] if s["type"] == "rect"):
        axes.axvspan(shape["x0"], shape["x1"], color="0.93", linewidth=0.0, zorder=0, label="not observable")
    axes.set_xlim(plot.layout["xaxis"]["range"])
    if "range" in plot.layout["yaxis"]:
        axes.set_ylim(plot.layout["yaxis"]["range"])
    axes.set_yscale(plot.layout["yaxis"].get("type", "linear"))
    short = plot.title.removesuffix(" coefficient").removeprefix("Effective ")
    unit = f"\n({plot.unit.replace('1e-12', '10⁻¹²')})" if plot.unit else ""
    axes.set_ylabel((short if short.startswith("Coulomb") else short.lower()) + unit)


def _mark_faults(axes: Any, diagnosis: Diagnosis) -> None:
    for fault, colour in zip(diagnosis.faults, cycle(("black", VERMILLION, SKY, ORANGE)), strict=False):
        title = fault_title(fault.fault)
        if fault.onset_interval is not None:
            axes.axvspan(*fault.onset_interval, color="black", alpha=0.12, linewidth=0.0, label="onset, 80 %")
        axes.axvline(fault.onset_s, color=colour, linestyle="--", linewidth=1.0, label=f"onset: {title}")
        axes.axvline(fault.detected_s, color=colour, linewidth=1.2, label=f"alarm: {title}")
