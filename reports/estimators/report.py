"""``python -m reports estimators``: how well they do, beside the bound, least squares and filterpy."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from fdd.cli.console import progress
from fdd.errors import InputError
from fdd.residuals.tracking import METHODS
from reports.estimators.cases import QUANTITIES
from reports.estimators.measure import Measured, Plan, measure
from reports.estimators.runs import GRID, WORLDS, StepOutcome
from reports.estimators.speed import measure as measure_speed
from reports.estimators.summary import (
    COVERED,
    WITHIN_BOUND,
    Accuracy,
    accuracy,
    beside_peers,
    coverage,
    goals,
)
from reports.writing import (
    FOLDER,
    Curve,
    OutOption,
    Panel,
    draw,
    made_by,
    require_folder,
    template,
    write_report,
)


def estimators(
    out: OutOption = FOLDER,
    runs: Annotated[int, typer.Option(min=2, max=10_000, help="Runs of each case.")] = 100,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Fixes everything random.")] = 0,
    still: Annotated[int, typer.Option(min=0, max=1000, help="Runs of an hour at standstill, or none.")] = 10,
    peers: Annotated[int, typer.Option(min=0, max=1000, help="Runs of each case beside filterpy.")] = 3,
    speed: Annotated[bool, typer.Option(help="Measure speed too.")] = True,
) -> None:
    """Measure how well the EHA estimators do: errors, consistency, speed of response, standstill (7 min)."""
    require_folder(out, pictures=True)
    if peers and find_spec("filterpy") is None:
        raise InputError("filterpy, the peer, is not installed", mend="install fdd[test], or give --peers 0")
    # First, while nothing of this command runs beside it.
    with progress("measuring speed"):
        table = measure_speed() if speed else None
    with progress("measuring the estimators", 1.0) as advance:
        found = measure(Plan(runs=runs, still=still, peers=peers, seed=seed), workers, advance)
    found.speed = table
    draw_pictures(found, out / "estimators")
    for world in WORLDS:
        for goal in goals(found, world):
            print(f"{world}: {goal.name}: {goal.met} of {goal.total}")
    write_report(out / "estimators.md", report_lines(found))


def report_lines(found: Measured) -> list[str]:
    """The whole report."""

    def figure(a: Accuracy, value: float) -> str:
        text = f"{value:.3g}" if a.counted else f"({value:.3g})"
        return text if np.isfinite(value) else "lost"

    def half(steps: Sequence[StepOutcome], method: int, share: float) -> str:
        times = [s.half[method] for s in steps]
        value = float(np.median(times) if share == 0.5 else np.quantile(times, share, method="higher"))
        return f"{value:.2f}" if np.isfinite(value) else "never"

    page = template(
        Path(__file__).with_name("estimators.md.j2"), words=lambda name: name.replace("_", " "),
        item=lambda values, *at: values[at],
    )  # fmt: skip
    text = page.render(
        made_by=made_by("estimators"), plan=found.plan, found=found, quantities=QUANTITIES,
        worlds=[w for w in WORLDS if any(at == w for at, _ in found.runs)],
        goals={world: goals(found, world) for world in WORLDS}, methods=[m.upper() for m in METHODS],
        accuracy=accuracy, coverage=coverage, beside_peers=beside_peers, figure=figure, half=half,
    )  # fmt: skip
    return text.splitlines()


def draw_pictures(found: Measured, folder: Path) -> None:
    """Draw errors over the bound, runs inside the bands, and responses to a change (median, 80 % of runs)."""
    names = [name for name in found.plan.cases if any(name == case for _, case in found.runs)]
    errors, covered = [], []
    for world in WORLDS:
        curves: list[Curve] = []
        shares: list[Curve] = []
        for m, (method, marker) in enumerate(zip(METHODS, "ox", strict=True)):
            for i, quantity in enumerate(QUANTITIES):
                points = [(accuracy(found.runs[world, n], m, i), row) for row, n in enumerate(names)]
                shown = [(a.over_bound, row + 0.12 * (i - 1.5)) for a, row in points if a.counted]
                x, y = np.array(shown).reshape(-1, 2).T
                curves.append((x, y, f"C{i}{marker}", f"{quantity.replace('_', ' ')}, {method.upper()}"))
            each = [coverage(found.runs[world, n], m) for n in names]
            rows = np.arange(len(names))
            shares.append(([c.nees for c in each], rows, f"C0{marker}", f"NEES, {method.upper()}"))
            shares.append(([c.nis for c in each], rows + 0.15, f"C3{marker}", f"NIS, {method.upper()}"))
        cases = {"title": f"{world} world", "yticks": range(len(names)), "ylim": (len(names) - 0.5, -0.5),
                 "yticklabels": names if world == WORLDS[0] else []}  # fmt: skip
        over = {**cases, "xlabel": "RMSE over the bound", "xscale": "log"}
        errors.append(Panel(curves, over, at_x={WITHIN_BOUND: "goal"}))
        inside = {**cases, "xlabel": "runs inside the 95 % band", "xlim": (-0.03, 1.03)}
        covered.append(Panel(shares, inside, at_x={COVERED: "goal"}))
    for name, each_world in (("bound", errors), ("coverage", covered)):
        draw(folder / f"{name}.png", each_world, columns=2, height=1.6 + 0.35 * len(names))
    panels = []
    for (world, quantity), steps in found.steps.items():
        responses: list[Curve] = [
            (GRID, np.nanquantile([s.response[m] for s in steps], share, axis=0), f"C{m}{style}", label)
            for m, method in enumerate(METHODS)
            for share, style, label in ((0.1, ":", None), (0.5, "-", method.upper()), (0.9, ":", None))
        ]
        settings = {"title": f"{quantity.replace('_', ' ')}, {world}", "xlabel": "s after the change",
                    "ylabel": "share of the change", "ylim": (-0.5, 1.7)}  # fmt: skip
        panels.append(Panel(responses, settings, at_y={0.5: "half"}))
    if panels:
        draw(folder / "steps.png", panels, columns=len(panels) // len(WORLDS), height=5.0)
