"""A diagnosis as one figure of matplotlib, for papers and notebooks."""

from __future__ import annotations

from importlib.util import find_spec
from itertools import cycle
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from fdd.diagnosis.findings import DISPLAY_SCALE, ESTIMATED, Diagnosis, Trajectories
from fdd.errors import InputError
from fdd.report import traces as tr
from fdd.report.plots import ESTIMATOR_TITLES, MEASURED, y_range
from fdd.report.words import fault_title, headline
from fdd.samples import Samples

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_INCHES, PANEL_INCHES, MARGIN_INCHES = 7.2, 1.3, 1.1
"""Two columns of a journal are 180 mm wide."""
PANELS = ("Position", "Pressures")
"""What of `MEASURED` is drawn."""
BUCKETS = 1500
SEVERAL = 10.0
"""Times the threshold from which on the statistic has a logarithmic axis."""
TITLE_WIDTH = 85
"""Characters in a line of the title."""
STYLE = {
    "font.size": 10, "axes.grid": True, "grid.color": "0.9", "axes.axisbelow": True, "axes.spines.top": False,
    "axes.spines.right": False, "legend.frameon": True, "legend.edgecolor": "none", "legend.framealpha": 0.9,
    "legend.fontsize": 9, "lines.markersize": 5,
}  # fmt: skip
"""Of all pictures, for `matplotlib.rc_context`."""


def require_matplotlib() -> None:
    """Refuse where matplotlib, an extra of the package, is missing, and say what to install."""
    if find_spec("matplotlib") is None:
        problem = "matplotlib, which draws the pictures, is not installed"
        raise InputError(problem, mend="install fdd[reports]")


def draw_diagnosis(diagnosis: Diagnosis, trajectories: Trajectories, samples: Samples) -> Figure:
    """Draw signals, estimates with their 95 % bands and the test statistic over one time axis.

    Onsets (with their 80 % interval) and alarms of what was found go through all panels. Stretches in which
    a quantity could not be known are shaded. An InputError where matplotlib is missing.
    """
    require_matplotlib()
    import matplotlib
    from matplotlib import pyplot

    names = [n for n in ESTIMATED if trajectories.time.size and trajectories.observable[n].any()]
    rows = len(PANELS) + len(names) + 1
    size = (WIDTH_INCHES, PANEL_INCHES * rows + MARGIN_INCHES)
    with matplotlib.rc_context({**STYLE, "font.size": 8.5, "legend.fontsize": 8}):
        figure = pyplot.figure(figsize=size, dpi=150, layout="constrained")
        panels = figure.subplots(rows, 1, sharex=True, squeeze=False).ravel()
        for axes, title in zip(panels, PANELS, strict=False):
            _signals(axes, title, samples)
        for axes, name in zip(panels[len(PANELS) :], names, strict=False):
            _estimate(axes, name, diagnosis, trajectories)
        _statistic(panels[-1], trajectories)
        for axes in panels:
            _mark_faults(axes, diagnosis)
        if len(samples):
            panels[-1].set_xlim(samples.time[0], samples.time[-1])
        panels[-1].set_xlabel("time (s)")
        figure.align_ylabels(panels)
        title = f"{diagnosis.log}: {headline(diagnosis)}" if diagnosis.log else headline(diagnosis)
        figure.suptitle(fill(title, TITLE_WIDTH))
        # One legend for what the panels have in common, each kind once.
        known = {name: handle for axes in panels[len(PANELS) :]
                 for handle, name in zip(*axes.get_legend_handles_labels(), strict=True)}  # fmt: skip
        if known:
            figure.legend(known.values(), known.keys(), loc="outside lower center", ncols=4)
    return figure


def _line(axes: Any, time: tr.Column, values: tr.Column, **style: Any) -> None:
    axes.plot(*tr.decimate(*tr.break_at_gaps(time, values), BUCKETS), **{"linewidth": 1.0, **style})


def _signals(axes: Any, wanted: str, samples: Samples) -> None:
    title, unit, channels, factor = next(m for m in MEASURED if m[0] == wanted)
    shown = [(channel, name) for channel, name in channels if channel in samples]
    for number, (channel, name) in enumerate(shown):
        style = ":" if channel == "position_setpoint" else "-"
        _line(axes, samples.time, factor * samples[channel], label=name, color=tr.LINE_COLOURS[number],
              linestyle=style, linewidth=0.8)  # fmt: skip
    axes.set_ylabel(f"{title.lower()}\n({unit})")
    if shown:  # above the panel, where no signal is
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), borderaxespad=0.0, ncols=len(shown))


def _estimate(axes: Any, name: str, diagnosis: Diagnosis, trajectories: Trajectories) -> None:
    _, unit, title = ESTIMATED[name]
    scale, time, seen = DISPLAY_SCALE[name], trajectories.time, trajectories.observable[name]
    lines, bands = [], []
    for number, (key, values) in enumerate(trajectories.estimates.items()):
        if name not in values:  # not every installed tracker has all of them
            continue
        colour, called = tr.LINE_COLOURS[number], ESTIMATOR_TITLES.get(key, key.upper())
        shown = np.where(seen, scale * values[name], np.nan)
        half = 2.0 * scale * trajectories.stds[key][name]
        band = tr.envelope(time, shown - half, shown + half, BUCKETS)
        axes.fill_between(*band, color=colour, alpha=0.2, linewidth=0.0, label=f"{called}, 95 %")
        # The filters are often one on the other: the first is solid.
        _line(axes, time, shown, color=colour, linestyle=(0, (3, 3)) if number else "-", label=called)
        lines.append(shown)
        bands += [shown - half, shown + half]
    found = diagnosis.estimates.get(name)
    baseline = None if found is None or found.baseline is None else scale * found.baseline
    if baseline is not None:
        axes.axhline(baseline, color=tr.GREEN, linestyle="--", linewidth=1.0, label="healthy")
    for start, stop in tr.intervals(time, ~seen):
        axes.axvspan(start, stop, color="0.93", linewidth=0.0, zorder=0, label="not observable")
    span = y_range(lines, bands, baseline)
    if span is not None:
        axes.set_ylim(*span)
    short = title.removesuffix(" coefficient").removeprefix("Effective ")
    short = short if short.startswith("Coulomb") else short.lower()
    axes.set_ylabel(f"{short}\n({unit.replace('1e-12', '10⁻¹²')})")


def _statistic(axes: Any, trajectories: Trajectories) -> None:
    time, statistic, threshold = trajectories.window_time, trajectories.statistic, trajectories.threshold
    axes.plot(time, statistic, color=tr.BLUE, linewidth=1.0, drawstyle="steps-post")
    axes.axhline(threshold, color=tr.GREY, linestyle="-.", linewidth=1.0, label="threshold of an alarm")
    if np.isfinite(trajectories.even):
        axes.axhline(trajectories.even, color=tr.GREY, linestyle=":", linewidth=1.0, label="this log, faulty")
    if statistic.size and threshold > 0.0 and np.nanmax(statistic) > SEVERAL * threshold:
        axes.set_yscale("log")
        axes.set_ylim(bottom=threshold / SEVERAL)
    axes.set_ylabel("test statistic\n(–)")


def _mark_faults(axes: Any, diagnosis: Diagnosis) -> None:
    for fault, colour in zip(
        diagnosis.faults, cycle(("black", tr.VERMILLION, tr.SKY, tr.ORANGE)), strict=False
    ):
        title = fault_title(fault.fault)
        if fault.onset_interval is not None:
            axes.axvspan(*fault.onset_interval, color="black", alpha=0.12, linewidth=0.0, label="onset, 80 %")
        axes.axvline(fault.onset_s, color=colour, linestyle="--", linewidth=1.0, label=f"onset: {title}")
        axes.axvline(fault.detected_s, color=colour, linewidth=1.2, label=f"alarm: {title}")
