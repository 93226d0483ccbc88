"""``python -m reports plant``: speed, error and robustness of the plant, measured beside peers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import pandas as pd
import typer
from threadpoolctl import threadpool_limits

from fdd.cli.console import progress
from reports.plant.numerics import SPEED, WORK, RealTime, Work, real_time, work_precision
from reports.plant.wild import Outcome, try_wild
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

GOAL = 300.0
"""Times real time that one axis with everything on is to run at."""


class Plan(NamedTuple):
    """How much is measured: s of each run that is timed and how often; s of the run that peers solve; the
    number of random scenarios."""

    speed_duration: float = 30.0
    repeats: int = 5
    work_duration: float = 2.0
    wild: int = 2000


class Measured(NamedTuple):
    """What was found; `trust` as `work_precision` gives it."""

    plan: Plan
    real_time: Sequence[RealTime]
    work: Sequence[Work]
    trust: float
    wild: Sequence[Outcome] = ()


def plant(
    out: OutOption = FOLDER,
    wild: Annotated[int, typer.Option(min=0, max=100_000, help="Random scenarios, or none.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="A minute: rough figures.")] = False,
) -> None:
    """Measure how fast, exact and robust the plant is, beside SciPy's solvers (half an hour)."""
    require_folder(out)
    plan = Plan(5.0, 2, 0.1, min(wild, 20)) if quick else Plan(wild=wild)
    with progress("measuring the plant", float(plan.wild)) as advance, threadpool_limits(1):
        timed = [real_time(case, plan.speed_duration, plan.repeats) for case in SPEED]
        work, trust = work_precision(WORK, plan.work_duration, plan.repeats)
        outcomes = []
        for seed in range(plan.wild):
            outcomes.append(try_wild(seed))
            advance(float(seed + 1))
    found = Measured(plan, timed, work, trust, outcomes)
    slowest = min(found.real_time, key=lambda each: each.whole)
    print(f"Slowest case, {slowest.case}: {slowest.whole:.0f} times real time")
    print(f"{sum(bool(o.failures) for o in found.wild)} of {len(found.wild)} random runs left physics")
    write_report(out / "performance.md", report_text(found))


def report_text(found: Measured) -> str:
    """The whole report."""
    ours = next(point for point in found.work if point.setting == "refine 1")
    one_axis = [r for r in found.real_time if not r.case.startswith("two axes")]
    return render(
        Path(__file__).with_name("performance.md.j2"), made_by=made_by("plant"), load_now=load_now(),
        plan=found.plan, found=found, ours=ours, goal=GOAL,
        slowest=min(one_axis, key=lambda r: r.whole), wild=pd.DataFrame([vars(o) for o in found.wild]),
    )  # fmt: skip
