"""``python -m reports estimators``: how well they do, beside the bound, least squares and filterpy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer

from estimators.consistency import nees_band
from fdd.cli.console import progress
from fdd.errors import InputError
from fdd.markdown import table
from fdd.residuals.tracking import METHODS
from reports.estimators.cases import QUANTITIES, TRACKED
from reports.estimators.measure import Measured, Plan, measure, measure_speed
from reports.estimators.peers import PEERS
from reports.estimators.runs import GRID, WORLDS
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

WITHIN_BOUND, COVERED, HALF_WITHIN = 1.5, 0.9, 2.0
"""Goals: RMSE over the bound; share of runs inside the 95 % bands; s until half of a change is followed."""
MOST_MICROSECONDS, LEAST_PEER = 2.0, 25.0
"""Goals: µs of a sample for EKF and SVSF; times slower that filterpy is."""
LEAST_FLAGGED = 0.05
"""Share of flagged estimates below which a quantity counts as not observable in a case."""
ABSOLUTE = "viscous_friction"
"""Its errors are given as they are and not in percent of the truth: healthy values may be nought."""


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


# Figures


def _relative(errors: pd.DataFrame, columns: list[str]) -> pd.DataFrame:
    """Those columns in percent of the truth, `ABSOLUTE`'s as they are."""
    scale = np.where(errors["quantity"] == ABSOLUTE, 1.0, 0.01 * errors["truth"].abs())
    return errors.assign(**errors[columns].div(scale, axis=0))


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def accuracy(errors: pd.DataFrame) -> pd.DataFrame:
    """Of each world, case, quantity and method, in percent of the truth, viscous friction in N·s/m.

    Columns: flagged (share of the checks at which the filter calls it observable), counted (whether that is
    often enough: the rest is over those checks, else over all), rmse, bias and spread of the errors, claimed
    and bound (rms of the standard deviations), fitted (rmse of least squares, NaN for friction).
    """

    def figures(rows: pd.DataFrame) -> pd.Series:
        flagged = rows["flag"].mean()
        counted = flagged >= LEAST_FLAGGED
        used = rows[(rows["flag"] | (not counted)) & np.isfinite(rows["error"]) & np.isfinite(rows["std"])]
        error, fitted = used["error"], used["fitted"]
        return pd.Series({
            "flagged": flagged, "counted": counted and len(used) > 0, "rmse": _rms(error),
            "bias": error.mean(), "spread": error.std(ddof=0), "claimed": _rms(used["std"]),
            "bound": _rms(used["bound"]), "fitted": _rms(fitted[np.isfinite(fitted)]),
        })  # fmt: skip

    relative = _relative(errors, ["error", "std", "bound", "fitted"])
    return relative.groupby(["world", "case", "quantity", "method"], sort=False)[relative.columns].apply(
        figures
    )


def coverage(consistency: pd.DataFrame) -> pd.DataFrame:
    """Of each world, case and method, shares of runs inside the 95 % bands.

    Columns: nees, too_sure (share above its band), each quantity's error within 1.96 standard deviations,
    nis and mean_nis (over its expectation; NaN where no channel can be tested), lost (ended without a
    covariance).
    """
    low, high = nees_band(len(TRACKED))

    def figures(rows: pd.DataFrame) -> pd.Series:
        nees, tested = rows["nees"], rows[np.isfinite(rows["nis_low"])]
        return pd.Series({
            "nees": nees.between(low, high).mean(), "too_sure": (~(nees <= high)).mean(),
            **{q: (rows[q].abs() <= 1.96).mean() for q in QUANTITIES},
            "nis": tested["nis"].between(tested["nis_low"], tested["nis_high"]).mean(),
            "mean_nis": rows.loc[np.isfinite(rows["nis"]), "nis"].mean(),
            "lost": (~np.isfinite(nees)).mean(),
        })  # fmt: skip

    return consistency.groupby(["world", "case", "method"], sort=False)[consistency.columns].apply(figures)


def late_half(half: pd.Series) -> float:
    """s within which half of a change is followed in 90 % of the runs."""
    return float(np.quantile(half, 0.9, method="higher"))


@dataclass(frozen=True)
class Goal:
    """One goal over many cases: how many meet it, and those that do not, with their figure."""

    name: str
    met: int
    total: int
    short: tuple[str, ...]


Judged = Iterator[tuple[str, float, bool]]
"""Label, figure, and whether it meets the goal."""


def goals(found: Measured, world: str) -> list[Goal]:
    """The goals of the benchmark in one world, judged by both methods' figures."""
    errors, covered = accuracy(found["errors"]).loc[world], coverage(found["consistency"]).loc[world]
    counted = errors[errors["counted"].astype(bool)]

    def against(reference: str, most: float) -> Judged:
        for (case, quantity, method), a in counted.iterrows():
            if np.isfinite(a[reference]):
                ratio = a["rmse"] / a[reference]
                yield f"{case}, {method.upper()}, {_words(quantity)}", ratio, ratio <= most

    def inside(which: str) -> Judged:
        for (case, method), share in covered[which].items():
            if np.isfinite(share):
                yield f"{case}, {method.upper()}", share, share >= COVERED

    def halves() -> Judged:
        if "steps" in found:
            steps = found["steps"][found["steps"]["world"] == world]
            for (quantity, method), half in steps.groupby(["case", "method"], sort=False)["half"]:
                late = late_half(half)
                yield f"{_words(quantity)}, {method.upper()}", late, late <= HALF_WITHIN

    return [
        _goal(f"RMSE within {WITHIN_BOUND:g} times the bound where observable",
              against("bound", WITHIN_BOUND), "{:.2f} times"),
        _goal("never worse than least squares over the same window", against("fitted", 1.0),
              "{:.2f} times its RMSE"),
        _goal(f"NEES inside its 95 % band in {COVERED:.0%} of runs", inside("nees"), "{:.0%}"),
        _goal(f"NIS inside its 95 % band in {COVERED:.0%} of runs", inside("nis"), "{:.0%}"),
        _goal(f"half of a change followed within {HALF_WITHIN:g} s in 90 % of runs", halves(), "{:.2f} s"),
    ]  # fmt: skip


def _goal(name: str, judged: Judged, form: str) -> Goal:
    each = list(judged)
    short = sorted(((label, value) for label, value, met in each if not met), key=lambda item: -item[1])
    return Goal(
        name,
        len(each) - len(short),
        len(each),
        tuple(f"{label}: {form.format(value)}" for label, value in short),
    )


# What is said


def _words(name: str) -> str:
    return name.replace("_", " ")


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
    each = accuracy(found["errors"]).loc[world]
    for (case, quantity), pair in each.groupby(["case", "quantity"], sort=False):
        a, b = (pair.xs(method, level="method").iloc[0] for method in METHODS)

        def shown(value: float, of: pd.Series = a) -> str:
            text = f"{value:.3g}" if of["counted"] else f"({value:.3g})"
            return text if np.isfinite(value) else "lost"

        rows.append([
            case if case != before else "", _words(quantity), f"{a['flagged']:.0%} / {b['flagged']:.0%}",
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
        for (case, method), c in coverage(found["consistency"]).loc[world].iterrows()
    ]  # fmt: skip
    head = ["case", "method", "NEES", "above", *map(_words, QUANTITIES), "NIS", "mean NIS", "lost"]
    return "\n".join(table(head, rows, "llr"))


def _step_table(found: Measured) -> str:
    rows = []
    for (world, quantity), runs in found["steps"].groupby(["world", "case"], sort=False):
        halves = [runs.loc[runs["method"] == method, "half"] for method in METHODS]
        times = [t for half in halves for t in (float(np.median(half)), late_half(half))]
        rows.append([world, _words(quantity), *(_maybe(t, ".2f") or "never" for t in times)])
    head = ["world", "quantity", *(f"{m.upper()}, {share}" for m in METHODS for share in ("median", "90 %"))]
    return "\n".join(table(head, rows, "llr"))


def _peer_table(found: Measured) -> str:
    rows, before = [], ("", "")
    for (world, case, quantity), runs in _relative(found["peers"], ["error", "bound"]).groupby(
        ["world", "case", "quantity"], sort=False
    ):
        cells = []
        for name in (*PEERS, *METHODS):
            mine = runs[runs["method"] == name]
            lost = int(mine["error"].isna().groupby(mine["run"]).any().sum())
            cells.append(_maybe(_rms(mine["error"].dropna()), ".3g") + (f" ({lost} lost)" if lost else ""))
        first = ["", ""] if (world, case) == before else [world, case]
        rows.append([*first, _words(quantity), *cells, f"{_rms(runs['bound']):.3g}"])
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
    rows = [[n, f"{r['median']:.2f}", f"{r['best']:.2f}", f"{r['median'] / took['EKF']:.2f}"]
            for n, r in timed.iterrows()]  # fmt: skip
    shown = table(["filter", "µs per sample, median", "best", "over our EKF"], rows, "lr")
    return {"verdicts": verdicts, "table": "\n".join(shown), "samples": int(timed["samples"].iloc[0]),
            "hour": 3.6 * took}  # fmt: skip


def draw_pictures(found: Measured, folder: Path) -> None:
    """Draw runs inside the bands, and responses to a change (median, 80 % of runs)."""
    covered, markers = coverage(found["consistency"]), dict(zip(METHODS, "ox", strict=True))
    names = list(found["consistency"]["case"].unique())
    panels, rows = [], np.arange(len(names))
    for world in WORLDS:
        curves = []
        for method, marker in markers.items():
            c = covered.loc[world].xs(method, level="method").loc[names]
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
    for (world, quantity), runs in found["steps"].groupby(["world", "case"], sort=False):
        responses = [
            (GRID, np.nanquantile(np.stack(runs.loc[runs["method"] == method, "response"]), share, axis=0),
             f"C{m}{style}", label)
            for m, method in enumerate(METHODS)
            for share, style, label in ((0.1, ":", None), (0.5, "-", method.upper()), (0.9, ":", None))
        ]  # fmt: skip
        settings = {"title": f"{_words(quantity)}, {world}", "xlabel": "s after the change",
                    "ylabel": "share of the change", "ylim": (-0.5, 1.7)}  # fmt: skip
        panels.append(Panel(responses, settings, at_y={0.5: "half"}))
    draw(folder / "steps.png", panels, columns=len(panels) // len(WORLDS), height=5.0)
