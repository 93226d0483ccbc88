"""The benchmark's pictures."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evidence.estimators.measure import Measured
from evidence.estimators.run import WORLDS
from evidence.estimators.steps import GRID, STEPPED
from evidence.estimators.summary import COVERED, WITHIN_BOUND, accuracy, coverage
from evidence.estimators.trajectory import QUANTITIES
from evidence.thesis.findings import Picture
from evidence.thesis.pictures import draw_picture
from fdd.residuals.tracking import METHODS

PICTURES = {
    "bound": "bound.png",
    "coverage": "coverage.png",
    "steps": "steps.png",
    "standstill": "standstill.png",
}
"""Names of the pictures' files."""
_COLOURS = ("C0", "C1", "C2", "C3")
_MARKERS = {"ekf": "o", "svsf": "x"}


def draw_pictures(found: Measured, folder: Path) -> list[Path]:
    """Draw what there are figures for, as PNG files in a folder that is there.

    Raises
    ------
    InputError : they cannot be written, or matplotlib is missing.
    """
    wanted: list[tuple[str, float, Callable[..., None]]] = []
    if found.runs:
        height = 1.6 + 0.27 * len(found.plan.cases)
        wanted += [("bound", height, _bound), ("coverage", height, _coverage)]
    if found.steps:
        wanted.append(("steps", 5.0, _steps))
    if found.still:
        wanted.append(("standstill", 5.0, _standstill))
    made = []
    for name, height, draw in wanted:
        path = folder / PICTURES[name]
        draw_picture(Picture(path.stem, "", partial(draw, found=found), height), path)
        made.append(path)
    return made


def _bound(figure: Any, found: Measured) -> None:
    panels = figure.subplots(1, len(WORLDS), sharey=True, squeeze=False)[0]
    names = list(found.plan.cases)
    for axes, world in zip(panels, WORLDS, strict=True):
        for row, name in enumerate(names):
            for m, method in enumerate(METHODS):
                for i in range(len(QUANTITIES)):
                    outcomes = found.runs.get((world, name))
                    a = accuracy(outcomes, m, i) if outcomes else None
                    if a is None or not a.counted:
                        continue
                    axes.plot(a.over_bound, row + 0.12 * (i - 1.5), marker=_MARKERS[method],
                    color=_COLOURS[i],
                              fillstyle="none", linestyle="none")  # fmt: skip
        axes.axvline(1.0, color="0.5", linewidth=1.0)
        axes.axvline(WITHIN_BOUND, color="0.5", linewidth=1.0, linestyle="--")
        axes.set_xscale("log")
        axes.set_title(f"{world} world")
        axes.set_xlabel("RMSE over the bound (dashed: goal)")
    _case_axis(panels[0], names)
    for i, quantity in enumerate(QUANTITIES):
        panels[0].plot(
            [], [], marker="s", linestyle="none", color=_COLOURS[i], label=quantity.replace("_", " ")
        )
    for method in METHODS:
        panels[0].plot([], [], marker=_MARKERS[method], linestyle="none", color="0.3", fillstyle="none",
                       label=method.upper())  # fmt: skip
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)


def _coverage(figure: Any, found: Measured) -> None:
    panels = figure.subplots(1, len(WORLDS), sharey=True, squeeze=False)[0]
    names = list(found.plan.cases)
    for axes, world in zip(panels, WORLDS, strict=True):
        for m, method in enumerate(METHODS):
            for which, colour in (("nees", "C0"), ("nis", "C3")):
                shares = [
                    getattr(coverage(found.runs[world, name], m), which)
                    if (world, name) in found.runs
                    else np.nan
                    for name in names
                ]
                axes.plot(shares, np.arange(len(names)) + 0.15 * (which == "nis"), marker=_MARKERS[method],
                          color=colour, linestyle="none", fillstyle="none",
                          label=f"{which.upper()}, {method.upper()}")  # fmt: skip
        axes.axvline(COVERED, color="0.5", linewidth=1.0, linestyle="--")
        axes.set_xlim(-0.03, 1.03)
        axes.set_title(f"{world} world")
        axes.set_xlabel("runs inside the 95 % band (dashed: goal)")
    _case_axis(panels[0], names)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)


def _case_axis(axes: Any, names: list[str]) -> None:
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)


def _steps(figure: Any, found: Measured) -> None:
    panels = figure.subplots(len(WORLDS), len(STEPPED), sharex=True, sharey=True, squeeze=False)
    for row, world in enumerate(WORLDS):
        for axes, quantity in zip(panels[row], STEPPED, strict=True):
            steps = found.steps.get((world, quantity))
            if steps:
                for m, colour in ((0, "C0"), (1, "C1")):
                    curves = np.array([s.response[m] for s in steps])
                    low, middle, high = np.nanquantile(curves, [0.1, 0.5, 0.9], axis=0)
                    axes.fill_between(GRID, low, high, color=colour, alpha=0.2, linewidth=0.0)
                    axes.plot(GRID, middle, color=colour, label=METHODS[m].upper())
            axes.axhline(0.5, color="0.5", linewidth=1.0, linestyle="--")
            axes.set_ylim(-0.5, 1.7)
            axes.set_title(f"{quantity.replace('_', ' ')}, {world}")
        panels[row][0].set_ylabel("share of the change")
    for axes in panels[-1]:
        axes.set_xlabel("s after the change")
    panels[0][0].legend(title="median, 80 % of runs", loc="lower right")


def _standstill(figure: Any, found: Measured) -> None:
    panels = figure.subplots(2, 2, sharex=True, squeeze=False).ravel()
    for i, (axes, quantity) in enumerate(zip(panels, QUANTITIES, strict=True)):
        for outcome in found.still:
            colour = "C3" if "minimum" in outcome.case else "C0"
            style = "-" if "none" in outcome.case else ":"
            axes.plot(outcome.time / 60.0, outcome.moved[0, i], color=colour, linestyle=style, linewidth=0.8)
        axes.axhspan(-1.0, 1.0, color="0.9", zorder=0)
        axes.set_title(quantity.replace("_", " "))
        axes.set_ylabel("EKF moved (std)")
    for axes in panels[2:]:
        axes.set_xlabel("minutes")
    figure.suptitle("blue: all sensors, red: minimum; dotted: constant load", fontsize=9)
