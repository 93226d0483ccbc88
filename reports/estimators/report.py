"""``python -m reports estimators``: how well they do, beside the bound, least squares and filterpy."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer

from fdd.cli.console import progress
from fdd.errors import InputError
from fdd.markdown import table
from fdd.residuals.tracking import METHODS
from reports.estimators.cases import QUANTITIES
from reports.estimators.measure import Measured, Plan, measure, measure_speed
from reports.estimators.peers import PEERS
from reports.estimators.runs import GRID, WORLDS
from reports.estimators.summary import (
    COVERED,
    accuracy,
    coverage,
    goals,
    grouped,
    late_half,
    relative,
    rms,
    rows_of,
    within,
    words,
)
from reports.writing import (
    FOLDER,
    OutOption,
    Panel,
    draw,
    made_by,
    require_folder,
    template,
    write_report,
)

MOST_MICROSECONDS, LEAST_PEER = 2.0, 25.0
"""Goals: µs of a sample for EKF and SVSF; times slower that filterpy is."""


def estimators(
    out: OutOption = FOLDER,
    runs: Annotated[int, typer.Option(min=2, max=10_000, help="Runs of each case.")] = 100,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Fixes everything random.")] = 0,
    peers: Annotated[int, typer.Option(min=0, max=1000, help="Runs of each case beside filterpy.")] = 3,
    speed: Annotated[bool, typer.Option(help="Measure speed too.")] = True,
) -> None:
    """Measure how well the EHA estimators do: errors, consistency, speed of response (7 min)."""
    require_folder(out, pictures=True)
    if peers and find_spec("filterpy") is None:
        raise InputError("filterpy, the peer, is not installed", mend="install fdd[test], or give --peers 0")
    # First, while nothing of this command runs beside it.
    with progress("measuring speed"):
        timed = {"speed": measure_speed()} if speed else {}
    with progress("measuring the estimators", 1.0) as advance:
        plan = Plan(runs=runs, peers=peers, seed=seed)
        found = measure(plan, workers, advance) | timed
    draw_pictures(found, out / "estimators")
    for world in WORLDS:
        for goal in goals(found, world):
            print(f"{world}: {goal.name}: {goal.met} of {goal.total}")
    write_report(out / "estimators.md", report_lines(plan, found))


def _maybe(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else ""


def report_lines(plan: Plan, found: Measured) -> list[str]:
    """The whole report."""
    page = template(Path(__file__).with_name("estimators.md.j2"))
    text = page.render(
        made_by=made_by("estimators"), plan=plan, worlds=WORLDS if "errors" in found else (), found=found,
        goals={world: goals(found, world) for world in WORLDS if "errors" in found},
        error_table=partial(_error_table, found), coverage_table=partial(_coverage_table, found),
        step_table=partial(_step_table, found), peer_table=partial(_peer_table, found),
        speed=_speed(found["speed"]) if "speed" in found else None,
    )  # fmt: skip
    return text.splitlines()


def _error_table(found: Measured, world: str) -> str:
    rows, before = [], ""
    each = within(accuracy(found["errors"]), world)
    for (case, quantity), pair in grouped(each, "case", "quantity"):
        a, b = (pair.xs(method, level="method").iloc[0] for method in METHODS)

        def shown(value: float, of: pd.Series = a) -> str:
            text = f"{value:.3g}" if of["counted"] else f"({value:.3g})"
            return text if np.isfinite(value) else "lost"

        rows.append([
            case if case != before else "", words(quantity), f"{a['flagged']:.0%} / {b['flagged']:.0%}",
            shown(a["rmse"]), shown(b["rmse"], b), shown(a["bound"]),
            *(f"{x['rmse'] / x['bound']:.2f}" if x["counted"] else "" for x in (a, b)),
            shown(a["fitted"]) if np.isfinite(a["fitted"]) else "",
            *(shown(a[which]) for which in ("claimed", "bias", "spread")),
        ])  # fmt: skip
        before = case
    head = ["case", "quantity", "flagged EKF / SVSF", "EKF", "SVSF", "bound", "EKF/bound", "SVSF/bound",
            "least squares", "claimed", "bias", "spread"]  # fmt: skip
    return "\n".join(table(head, rows, "llr"))


def _coverage_table(found: Measured, world: str) -> str:
    rows = [
        [case if method == METHODS[0] else "", method.upper(),
         *(f"{c[which]:.0%}" for which in ("nees", "too_sure", *QUANTITIES)),
         _maybe(c["nis"], ".0%"), _maybe(c["mean_nis"], ".2f"), f"{c['lost']:.0%}"]
        for (case, method), c in rows_of(within(coverage(found["consistency"]), world))
    ]  # fmt: skip
    head = ["case", "method", "NEES", "above", *map(words, QUANTITIES), "NIS", "mean NIS", "lost"]
    return "\n".join(table(head, rows, "llr"))


def _step_table(found: Measured) -> str:
    rows = []
    for (world, quantity), runs in grouped(found["steps"], "world", "case"):
        halves = [runs.loc[runs["method"] == method, "half"] for method in METHODS]
        times = [t for half in halves for t in (float(np.median(half)), late_half(half))]
        rows.append([world, words(quantity), *(_maybe(t, ".2f") or "never" for t in times)])
    head = ["world", "quantity", *(f"{m.upper()}, {share}" for m in METHODS for share in ("median", "90 %"))]
    return "\n".join(table(head, rows, "llr"))


def _peer_table(found: Measured) -> str:
    rows, before = [], ("", "")
    shares = relative(found["peers"], ["error", "bound"])
    for (world, case, quantity), runs in grouped(shares, "world", "case", "quantity"):
        cells = []
        for name in (*PEERS, *METHODS):
            mine = runs[runs["method"] == name]
            lost = int(mine["error"].isna().groupby(mine["run"]).any().sum())
            cells.append(_maybe(rms(mine["error"].dropna()), ".3g") + (f" ({lost} lost)" if lost else ""))
        first = ["", ""] if (world, case) == before else [world, case]
        rows.append([*first, words(quantity), *cells, f"{rms(runs['bound']):.3g}"])
        before = world, case
    head = ["world", "case", "quantity", *PEERS, *(f"our {m.upper()}" for m in METHODS), "bound"]
    return "\n".join(table(head, rows, "lllr"))


def _speed(timed: pd.DataFrame) -> dict[str, object]:
    """Verdicts on speed, the table, and on what it was measured."""
    took = timed["median"]
    verdicts = [(f"{m} within {MOST_MICROSECONDS:g} µs a sample", took[m], "µs", took[m] <= MOST_MICROSECONDS)
                for m in ("EKF", "SVSF")]  # fmt: skip
    if PEERS[0] in took:
        ratio = took[PEERS[0]] / took["EKF"]
        verdicts.append((f"{LEAST_PEER:g} times filterpy's speed", ratio, "times", ratio >= LEAST_PEER))
    rows = [[str(n), f"{r['median']:.2f}", f"{r['best']:.2f}", f"{r['median'] / took['EKF']:.2f}"]
            for n, r in timed.iterrows()]  # fmt: skip
    shown = table(["filter", "µs per sample, median", "best", "over our EKF"], rows, "lr")
    return {"verdicts": verdicts, "table": "\n".join(shown), "samples": int(timed["samples"].iloc[0]),
            "hour": 3.6 * took}  # fmt: skip


def draw_pictures(found: Measured, folder: Path) -> None:
    """Draw runs inside the bands, and responses to a change (median, 80 % of runs)."""
    covered, markers = coverage(found["consistency"]), dict(zip(METHODS, "ox", strict=True))
    names = list(found["consistency"]["case"].unique())
    panels, rows = [], np.arange(float(len(names)))
    for world in WORLDS:
        curves = []
        for method, marker in markers.items():
            c = within(covered, world).xs(method, level="method").loc[names]
            curves.append((c["nees"], rows, f"C0{marker}", f"NEES, {method.upper()}"))
            curves.append((c["nis"], rows + 0.15, f"C3{marker}", f"NIS, {method.upper()}"))
        settings = {"title": f"{world} world", "yticks": range(len(names)), "ylim": (len(names) - 0.5, -0.5),
                    "yticklabels": names if world == WORLDS[0] else [],
                    "xlabel": "runs inside the 95 % band", "xlim": (-0.03, 1.03)}  # fmt: skip
        panels.append(Panel(curves, settings, at_x={COVERED: "goal"}))
    draw(folder / "coverage.png", panels, columns=2, height=1.6 + 0.35 * len(names))
    if "steps" not in found:
        return
    panels = []
    for (world, quantity), runs in grouped(found["steps"], "world", "case"):
        responses = []
        for m, method in enumerate(METHODS):
            each = np.stack(list(runs.loc[runs["method"] == method, "response"]))
            responses += [
                (GRID, np.nanquantile(each, share, axis=0), f"C{m}{style}", label)
                for share, style, label in ((0.1, ":", None), (0.5, "-", method.upper()), (0.9, ":", None))
            ]
        settings = {"title": f"{words(quantity)}, {world}", "xlabel": "s after the change",
                    "ylabel": "share of the change", "ylim": (-0.5, 1.7)}  # fmt: skip
        panels.append(Panel(responses, settings, at_y={0.5: "half"}))
    draw(folder / "steps.png", panels, columns=len(panels) // len(WORLDS), height=5.0)
