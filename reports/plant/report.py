"""``python -m reports plant``: speed, numerics and robustness of the plant, measured beside peers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from fdd.cli.console import progress
from reports.plant.cases import Cases
from reports.plant.numerics import Difference, RealTime, against_half_steps, against_radau, real_time
from reports.plant.wild import Outcome, try_wild
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

GOAL = 300.0
"""Times real time that one axis with everything on is to run at."""


@dataclass(frozen=True)
class Plan:
    """How much is measured: s of each run that is timed and how often; s of the runs with steps half as long,
    and of those beside Radau; the number of random scenarios."""

    speed_duration: float = 30.0
    repeats: int = 5
    halving_duration: float = 60.0
    radau_duration: float = 2.0
    wild: int = 2000


@dataclass
class Measured:
    """What was found; `halved` is without the encoder's steps in the loop: the numerics alone."""

    plan: Plan
    real_time: list[RealTime] = field(default_factory=list)
    halved: list[Difference] = field(default_factory=list)
    radau: list[Difference] = field(default_factory=list)
    wild: list[Outcome] = field(default_factory=list)


def plant(
    out: OutOption = FOLDER,
    wild: Annotated[int, typer.Option(min=0, max=100_000, help="Random scenarios, or none.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="A minute: rough figures.")] = False,
) -> None:
    """Measure how fast, exact and robust the plant is, beside SciPy's Radau (half an hour)."""
    require_folder(out)
    plan = Plan(5.0, 2, 3.0, 0.05, min(wild, 20)) if quick else Plan(wild=wild)
    with progress("measuring the plant", 1.0) as advance:
        found = measure(plan, advance)
    slowest = min(found.real_time, key=lambda each: each.whole)
    print(f"Slowest case, {slowest.case}: {slowest.whole:.0f} times real time")
    print(f"{sum(bool(o.failures) for o in found.wild)} of {len(found.wild)} random runs left physics")
    write_report(out / "performance.md", report_text(found))


def measure(plan: Plan, progress: Callable[[float], None]) -> Measured:
    """Measure speed, convergence and robustness on one core; `progress` is told what share is done."""
    cases, found = Cases(), Measured(plan)
    numerics = cases.numerics
    with threadpool_limits(1):
        for case in cases.speed:
            found.real_time.append(real_time(case, plan.speed_duration, plan.repeats))
        for number, case in enumerate(numerics, 1):
            found.halved.append(against_half_steps(case.without_encoder_steps(), plan.halving_duration))
            found.radau.append(against_radau(case, plan.radau_duration))
            progress(0.4 * number / len(numerics))
        for seed in range(plan.wild):
            found.wild.append(try_wild(seed))
            progress(0.4 + 0.6 * (seed + 1) / plan.wild)
    return found


def report_text(found: Measured) -> str:
    """The whole report."""
    one_axis = [r for r in found.real_time if not r.case.startswith("two axes")]

    def most(name: str, form: str, *shares: float) -> str:
        """Percentiles of all random runs."""
        values = [getattr(outcome, name) for outcome in found.wild]
        return " / ".join(format(q, form) for q in np.nanpercentile(values, shares))

    return render(
        Path(__file__).with_name("performance.md.j2"), made_by=made_by("plant"), load_now=load_now(),
        plan=found.plan, found=found, goal=GOAL, slowest=min(one_axis, key=lambda r: r.whole), most=most,
    )  # fmt: skip
