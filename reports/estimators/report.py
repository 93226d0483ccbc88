"""``python -m reports estimators``: how well they do, beside the bound; speed beside filterpy's."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, NamedTuple, cast

import numpy as np
import pandas as pd
import typer
from scipy.stats import chi2

from fdd.cli.console import progress
from fdd.errors import InputError
from fdd.residuals.tracking import METHODS
from reports.estimators.cases import QUANTITIES, TRACKED
from reports.estimators.runs import GRID, PEER, WORLDS, Measured, Plan, measure, measure_speed
from reports.writing import FOLDER, OutOption, Panel, draw, made_by, render, require_folder, write_report

WITHIN_BOUND, COVERED, HALF_WITHIN = 1.5, 0.9, 2.0
"""Goals: RMSE over the bound; share of runs inside the 95 % bands; s until half of a change is followed."""
LEAST_FLAGGED = 0.05
"""Share of flagged estimates below which a quantity counts as not observable in a case."""
ABSOLUTE = "viscous_friction"
"""Its errors are given as they are and not in percent of the truth: healthy values may be nought."""


def estimators(
    out: OutOption = FOLDER,
    runs: Annotated[int, typer.Option(min=2, max=10_000, help="Runs of each case.")] = 100,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Fixes everything random.")] = 0,
    speed: Annotated[bool, typer.Option(help="Measure speed too.")] = True,
) -> None:
    """Measure how well the EHA estimators do: errors, consistency, speed of response (7 min)."""
    require_folder(out, pictures=True)
    if speed and find_spec("filterpy") is None:
        raise InputError("filterpy, the peer, is not installed", mend="install fdd[test], or give --no-speed")
    with progress("measuring speed"):  # first, while nothing of this command runs beside it
        timed = {"speed": measure_speed()} if speed else {}
    plan = Plan(runs=runs, seed=seed)
    with progress("measuring the estimators", 1.0) as advance:
        found = measure(plan, workers, advance) | timed
    draw_pictures(found, out / "estimators")
    for world in WORLDS:
        for goal in goals(found, world):
            print(f"{world}: {goal.name}: {goal.met} of {goal.total}")
    write_report(out / "estimators.md", report_text(plan, found))


def report_text(plan: Plan, found: Measured) -> str:
    """The whole report."""
    return render(
        Path(__file__).with_name("estimators.md.j2"), made_by=made_by("estimators"), plan=plan, worlds=WORLDS,
        found=found, goals={world: goals(found, world) for world in WORLDS},
        errors=lambda world: _within(accuracy(found["errors"]), world), words=_words, late_half=late_half,
        coverage=lambda world: _within(coverage(found["consistency"]), world), methods=METHODS,
        quantities=QUANTITIES, peer=PEER,
    )  # fmt: skip


def _within(frame: pd.DataFrame, world: str) -> pd.DataFrame:
    return cast(pd.DataFrame, frame.loc[world])


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _words(name: str) -> str:
    return name.upper() if name in METHODS else name.replace("_", " ")


def accuracy(errors: pd.DataFrame) -> pd.DataFrame:
    """Of each world, case, quantity and method, in percent of the truth, viscous friction in N·s/m.

    flagged: share of the checks at which the filter calls it observable; counted: 1 where that is often
    enough (the rest is over those checks, else over all); claimed, bound: rms of the standard deviations.
    """

    def figures(rows: pd.DataFrame) -> pd.Series:
        flagged = rows["flag"].mean()
        counted = flagged >= LEAST_FLAGGED
        used = rows[(rows["flag"] | (not counted)) & np.isfinite(rows["error"]) & np.isfinite(rows["std"])]
        error = used["error"]
        return pd.Series({
            "flagged": flagged, "counted": float(counted and len(used) > 0), "rmse": _rms(error),
            "bias": error.mean(), "spread": error.std(ddof=0), "claimed": _rms(used["std"]),
            "bound": _rms(used["bound"]),
        })  # fmt: skip

    sizes = ["error", "std", "bound"]
    scale = np.where(errors["quantity"] == ABSOLUTE, 1.0, 0.01 * errors["truth"].abs())
    shares = errors.assign(**errors[sizes].div(scale, axis=0))
    groups = shares.groupby(["world", "case", "quantity", "method"], sort=False)
    return cast(pd.DataFrame, groups[["flag", *sizes]].apply(figures))


def coverage(consistency: pd.DataFrame) -> pd.DataFrame:
    """Of each world, case and method, shares of runs inside the 95 % bands: of nees (too_sure: above it), of
    each quantity's error (1.96 standard deviations); lost: ended without a covariance."""
    (low, high), nees = chi2.interval(0.95, len(TRACKED)), consistency["nees"]
    inside = consistency[["world", "case", "method"]].assign(
        nees=nees.between(low, high), too_sure=~(nees <= high),
        **{q: consistency[q].abs() <= 1.96 for q in QUANTITIES}, lost=~np.isfinite(nees),
    )  # fmt: skip
    return inside.groupby(["world", "case", "method"], sort=False).mean()


def late_half(half: pd.Series) -> float:
    """s within which half of a change is followed in 90 % of the runs."""
    return float(np.quantile(half, 0.9, method="higher"))


class Goal(NamedTuple):
    """One goal over many cases: how many meet it, and those that do not, with their figure."""

    name: str
    met: int
    total: int
    short: tuple[str, ...]


def goals(found: Measured, world: str) -> list[Goal]:
    """The goals of the benchmark in one world, judged by both methods' figures; none where it was not run."""
    if "errors" not in found or world not in set(found["errors"]["world"]):
        return []
    errors = _within(accuracy(found["errors"]), world)
    errors = errors[errors["counted"] > 0.0].swaplevel("quantity", "method")
    nees = _within(coverage(found["consistency"]), world)["nees"]
    ratio = errors["rmse"] / errors["bound"]
    judged = [
        (f"RMSE within {WITHIN_BOUND:g} times the bound where observable",
         ratio, ratio <= WITHIN_BOUND, "{:.2f} times"),
        (f"NEES inside its 95 % band in {COVERED:.0%} of runs", nees, nees >= COVERED, "{:.0%}"),
    ]  # fmt: skip
    if "steps" in found:
        steps = found["steps"][found["steps"]["world"] == world]
        half = steps.groupby(["case", "method"], sort=False)["half"].apply(late_half)
        name = f"half of a change followed within {HALF_WITHIN:g} s in 90 % of runs"
        judged.append((name, half, half <= HALF_WITHIN, "{:.2f} s"))
    out = []
    for name, figures, met, form in judged:
        told = figures.notna()
        short = figures[told & ~met].sort_values(ascending=False, kind="stable")
        labels = [", ".join(map(_words, cast(tuple[str, ...], key))) for key in short.index]
        each = (f"{label}: {form.format(value)}" for label, value in zip(labels, short, strict=True))
        out.append(Goal(name, int((told & met).sum()), int(told.sum()), tuple(each)))
    return out


def draw_pictures(found: Measured, folder: Path) -> None:
    """Draw runs inside the bands, and responses to a change (median, 80 % of runs)."""
    covered, names = coverage(found["consistency"]), list(found["consistency"]["case"].unique())
    panels = []
    for world in WORLDS:
        shares = _within(covered, world)["nees"].unstack("method").loc[names]
        curves = [
            (shares[method], np.arange(float(len(names))), style, f"NEES, {_words(method)}")
            for method, style in zip(METHODS, ("C0o", "C3x"), strict=True)
        ]
        settings = {"title": f"{world} world", "yticks": range(len(names)), "ylim": (len(names) - 0.5, -0.5),
                    "yticklabels": names if world == WORLDS[0] else [],
                    "xlabel": "runs inside the 95 % band", "xlim": (-0.03, 1.03)}  # fmt: skip
        panels.append(Panel(curves, settings, at_x={COVERED: "goal"}))
    draw(folder / "coverage.png", panels, columns=2, height=1.6 + 0.35 * len(names))
    if "steps" not in found:
        return
    panels = []
    for key, runs in found["steps"].groupby(["world", "case"], sort=False):
        responses, (world, quantity) = [], cast(tuple[str, str], key)
        for m, method in enumerate(METHODS):
            each = np.stack(list(runs.loc[runs["method"] == method, "response"]))
            responses += [
                (GRID, np.nanquantile(each, share, axis=0), f"C{m}{style}", label)
                for share, style, label in ((0.1, ":", None), (0.5, "-", method.upper()), (0.9, ":", None))
            ]
        settings = {"title": f"{_words(quantity)}, {world}", "xlabel": "s after the change",
                    "ylabel": "share of the change", "ylim": (-0.5, 1.7)}  # fmt: skip
        panels.append(Panel(responses, settings, at_y={0.5: "half"}))
    draw(folder / "steps.png", panels, columns=len(panels) // len(WORLDS), height=5.0)
