"""Everything that ``python -m evidence plant`` measures, in one run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from threadpoolctl import threadpool_limits

from evidence.plant.cases import Case, Cases
from evidence.plant.convergence import Difference, against_half_steps, against_radau
from evidence.plant.robustness import Outcome, try_many
from evidence.plant.speed import RealTime, Work, real_time, work_precision

Progress = Callable[[float], None]
Job = tuple[float, Callable[[], None]]


@dataclass(frozen=True)
class Plan:
    """How much is measured.

    Attributes
    ----------
    speed_duration, repeats : s of each run that is timed, and how often it is.
    work_duration : s of the run that peers solve.
    halving_duration : s of the runs with steps half as long; 0 leaves them out.
    radau_duration : s of the runs beside Radau; 0 leaves them out.
    wild : number of random scenarios; 0 leaves them out.
    """

    speed_duration: float = 30.0
    repeats: int = 5
    work_duration: float = 2.0
    halving_duration: float = 60.0
    radau_duration: float = 2.0
    wild: int = 2000


@dataclass
class Measured:
    """What was found.

    Attributes
    ----------
    plan : how much was measured.
    real_time : of each case.
    work, trust : see `evidence.plant.speed.work_precision`.
    halved, halved_alone : with the loop's encoder as it is, and without its steps.
    radau : beside the reference solver.
    wild : outcomes of the random scenarios.
    """

    plan: Plan
    real_time: list[RealTime] = field(default_factory=list)
    work: list[Work] = field(default_factory=list)
    trust: float = float("nan")
    halved: list[Difference] = field(default_factory=list)
    halved_alone: list[Difference] = field(default_factory=list)
    radau: list[Difference] = field(default_factory=list)
    wild: list[Outcome] = field(default_factory=list)


def measure(plan: Plan, progress: Progress = lambda share: None) -> Measured:
    """Measure speed, work, convergence and robustness on one core.

    Parameters
    ----------
    plan : how much.
    progress : is told the share that is done.
    """
    cases, found = Cases(), Measured(plan)
    jobs: list[Job] = [(2.0, partial(_time, case, found)) for case in cases.speed]
    jobs.append((15.0 * plan.work_duration, partial(_work, cases.work, found)))
    for case in cases.numerics:
        if plan.halving_duration > 0.0:
            jobs.append((3.0, partial(_halve, case, found)))
        if plan.radau_duration > 0.0:
            jobs.append((8.0 * plan.radau_duration, partial(_radau, case, found)))
    total = sum(cost for cost, _ in jobs) + 0.1 * plan.wild
    done = 0.0
    with threadpool_limits(1):
        for cost, job in jobs:
            job()
            done += cost
            progress(done / total)
        if plan.wild:
            found.wild = try_many(plan.wild, progress=lambda n: progress((done + 0.1 * n) / total))
    return found


def _time(case: Case, found: Measured) -> None:
    found.real_time.append(real_time(case, found.plan.speed_duration, found.plan.repeats))


def _work(case: Case, found: Measured) -> None:
    found.work, found.trust = work_precision(case, found.plan.work_duration, found.plan.repeats)


def _halve(case: Case, found: Measured) -> None:
    found.halved.append(against_half_steps(case, found.plan.halving_duration))
    found.halved_alone.append(against_half_steps(case.without_encoder_steps(), found.plan.halving_duration))


def _radau(case: Case, found: Measured) -> None:
    found.radau.append(against_radau(case, found.plan.radau_duration))
