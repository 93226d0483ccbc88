"""``python -m reports plant``: speed, numerics and robustness of the plant, measured beside peers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from threadpoolctl import threadpool_limits

from fdd.cli.console import progress
from fdd.markdown import table
from reports.plant import numerics
from reports.plant.cases import Cases
from reports.plant.wild import Outcome, try_wild
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

GOAL = 300.0
"""Times real time that one axis with everything on is to run at."""


@dataclass(frozen=True)
class Plan:
    """How much is measured: s of each run that is timed and how often; s of the runs that peers solve, with
    steps half as long and beside Radau; the number of random scenarios."""

    speed_duration: float = 30.0
    repeats: int = 5
    work_duration: float = 2.0
    halving_duration: float = 60.0
    radau_duration: float = 2.0
    wild: int = 2000


@dataclass
class Measured:
    """What was found; `halved` is without the encoder's steps in the loop: the numerics alone."""

    plan: Plan
    real_time: list[numerics.RealTime] = field(default_factory=list)
    work: list[numerics.Work] = field(default_factory=list)
    trust: float = float("nan")
    halved: list[numerics.Difference] = field(default_factory=list)
    radau: list[numerics.Difference] = field(default_factory=list)
    wild: list[Outcome] = field(default_factory=list)


def plant(
    out: OutOption = FOLDER,
    wild: Annotated[int, typer.Option(min=0, max=100_000, help="Random scenarios, or none.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="A minute: rough figures.")] = False,
) -> None:
    """Measure how fast, exact and robust the plant is, beside SciPy's solvers (half an hour)."""
    require_folder(out)
    plan = Plan(5.0, 2, 0.1, 3.0, 0.05, min(wild, 20)) if quick else Plan(wild=wild)
    with progress("measuring the plant", 1.0) as advance:
        found = measure(plan, advance)
    slowest = min(found.real_time, key=lambda each: each.whole)
    print(f"Slowest case, {slowest.case}: {slowest.whole:.0f} times real time")
    print(f"{sum(bool(o.failures) for o in found.wild)} of {len(found.wild)} random runs left physics")
    write_report(out / "performance.md", report_text(found))


def measure(plan: Plan, progress: Callable[[float], None]) -> Measured:
    """Measure speed, work, convergence and robustness on one core; `progress` is told what share is done."""
    cases, found = Cases(), Measured(plan)
    exact = cases.numerics
    with threadpool_limits(1):
        for case in cases.speed:
            found.real_time.append(numerics.real_time(case, plan.speed_duration, plan.repeats))
        found.work, found.trust = numerics.work_precision(cases.work, plan.work_duration, plan.repeats)
        for number, case in enumerate(exact, 1):
            alone = case.without_encoder_steps()
            found.halved.append(numerics.against_half_steps(alone, plan.halving_duration))
            found.radau.append(numerics.against_radau(case, plan.radau_duration))
            progress(0.4 * number / len(exact))
        for seed in range(plan.wild):
            found.wild.append(try_wild(seed))
            progress(0.4 + 0.6 * (seed + 1) / plan.wild)
    return found


def report_text(found: Measured) -> str:
    """The whole report."""
    ours = next(point for point in found.work if point.setting == "refine 1")
    # Each peer's cheapest setting that is no worse than the plant's usual one.
    tight = [p for p in found.work if p.pressure <= ours.pressure and p.position <= ours.position]
    equal = {
        solver: min((p for p in tight if p.solver == solver), key=lambda p: p.cpu, default=None)
        for solver in dict.fromkeys(p.solver for p in found.work if p.solver != ours.solver)
    }
    one_axis = [r for r in found.real_time if not r.case.startswith("two axes")]
    return render(
        Path(__file__).with_name("performance.md.j2"), made_by=made_by("plant"), load_now=load_now(),
        plan=found.plan, found=found, ours=ours, equal=equal, goal=GOAL,
        slowest=min(one_axis, key=lambda r: r.whole), differences=_differences, wild=_wild(found.wild),
    )  # fmt: skip


def _differences(found: Sequence[numerics.Difference]) -> str:
    rows = [[d.case, *(f"{value:.1e}" for value in d.rms.values())] for d in found]
    return "\n".join(table(["case", *found[0].rms], rows, "lr"))


def _wild(outcomes: Sequence[Outcome]) -> dict[str, str]:
    """What all random runs came to."""

    def most(name: str, *shares: float, form: str = ".1e") -> str:
        values = [getattr(outcome, name) for outcome in outcomes]
        return " / ".join(format(q, form) for q in np.nanpercentile(values, shares))

    if not outcomes:
        return {}
    beyond = max(float(np.nanmax([o.beyond_stop for o in outcomes])), 0.0)
    return {
        "outside physics": str(sum(bool(o.failures) for o in outcomes)),
        "lowest absolute pressure": f"{np.nanmin([o.lowest_pressure for o in outcomes]):.0f} Pa",
        "oil made or lost, 99 %, most": most("oil", 99, 100),
        "energy made or lost, 99 %, most": most("energy", 99, 100),
        "farthest into a stop": f"{1e3 * beyond:.2f} mm",
        "steps per ms, median, 99 %, most": most("steps", 50, 99, 100, form=".1f"),
    }
