"""``python -m reports plant``: how fast, exact and robust the plant is, measured beside SciPy's solvers.

SciPy's solvers get the plant's own compiled right-hand side through a thin wrapper, with commands and
conditions held as there; a solver starts anew wherever a command arrives, as any solver must.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from threadpoolctl import threadpool_limits

from fdd.cli.console import progress
from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.integrator import PERIOD, STEPS
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import raw_blocks, simulate
from fdd.plant.steps import tolerances
from fdd.unit import Unit
from reports.plant.wild import Outcome, try_wild
from reports.writing import FOLDER, OutOption, load_now, made_by, render, require_folder, write_report

Array = NDArray[np.float64]

GOAL = 300.0
"""Times real time that one axis with everything on is to run at."""
METHODS = ("RK45", "LSODA", "Radau")
REFERENCE_REFINEMENT = 64.0
REFINEMENTS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
PEER_TOLERANCES = ((1e-3, 1e4), (1e-5, 1e2), (1e-7, 1.0), (1e-9, 1e-2))
"""Relative tolerance, and absolute ones over the plant's own."""
_STAGES = 6
"""Evaluations of the right-hand side in a step: the seventh is the next one's first."""


@dataclass(frozen=True)
class Case:
    """A run of a shipped axis that is measured, alone or, with a partner in its `settings`, beside axis B."""

    name: str
    settings: dict[str, Any]
    unit: Unit

    @classmethod
    def of(cls, name: str, **settings: Any) -> Case:
        """A case of axis A; `settings` are the scenario's, beside its duration."""
        return cls(name, settings, Unit.load("axis_a"))

    @property
    def partner(self) -> Unit | None:
        """The second axis."""
        return Unit.load("axis_b") if "partner" in self.settings else None

    def scenario(self, duration: float, *, whole: bool = True) -> Scenario:
        """The run of `duration` s; `whole` keeps every sample at its millisecond."""
        recording = {"recording": Recording.perfect()} if whole else {}
        return Scenario(
            **{"unit": self.unit.name, "seed": 4, **self.settings, **recording, "duration": duration}
        )

    def prepared(self, duration: float, refine: float = 1.0) -> Prepared:
        """The run, ready."""
        return prepare(self.unit, self.scenario(duration), partner=self.partner, refine=refine)

    def states(self, duration: float, refine: float = 1.0) -> tuple[Array, Array]:
        """States (n, …) and commands (n, 2) of the run, at every millisecond."""
        rows = self.scenario(duration).rows
        block = next(iter(raw_blocks(self.prepared(duration, refine), block=rows)))
        return block.states, block.commands


_FAULT = [{"fault": "internal_leakage", "severity": 0.5, "onset": 2.0}]
SPEED = (
    Case.of("steps", faults=_FAULT, duty={"name": "steps"}, load={"name": "constant"}),
    Case.of("sines", faults=_FAULT, duty={"name": "sines"}, load={"name": "spring"}),
    Case.of("sawtooth", faults=_FAULT, duty={"name": "sawtooth"}, load={"name": "inertia"}),
    Case.of("strokes", faults=_FAULT, duty={"name": "strokes"}, load={"name": "throttle"}),
    Case.of("flight, gust", faults=_FAULT, duty={"name": "flight"}, load={"name": "gust"}),
    Case.of("prbs", faults=_FAULT, duty={"name": "prbs", "amplitude": 0.01}),
    Case.of("two axes, steps", faults=_FAULT, duty={"name": "steps"}, partner={}),
    Case.of("two axes, sines", faults=_FAULT, duty={"name": "sines"}, load={"name": "spring"}, partner={}),
)
"""For the real-time factor: everything on, one fault injected."""
WORK = Case.of(
    "prbs of speed, throttle", control={"mode": "speed"}, load={"name": "throttle"},
    duty={"name": "prbs", "bit": 0.1, "speed": 60.0, "lead_in": 0.05},
)  # fmt: skip
"""For error over work: open-loop speeds, the same commands for every solver."""


def integrate(
    case: Case, commands: Array, method: str, rtol: float, atol_factor: float, duration: float
) -> tuple[Array, int]:
    """Run a case by a `method` of `scipy.integrate.solve_ivp`, absolute tolerances over the plant's own.

    `commands`: (n, 2) rad/s, what the controllers asked for each millisecond; they act one later.

    Gives states (n, …) at the start of every millisecond, fewer where the solver gave up, and evaluations of
    the right-hand side.
    """
    ready = case.prepared(duration)
    assert all(unit.drive.delay == PERIOD for unit in ready.units)
    conditions = ready.conditions(0, commands.shape[0])
    first, second = ready.parameters[0], ready.parameters[-1]
    atol = tolerances(ready.axes) * atol_factor
    found = np.empty(ready.axes * s.FINDINGS)
    y = ready.state.copy()
    states = np.empty((commands.shape[0], y.size))
    evaluations = 0

    def rate(_time: float, at: Array, asked: Array, now: Array) -> Array:
        dy = np.empty(at.size)
        right_hand_side(at, asked[0], asked[1], now, first, second, dy, found)
        return dy

    for t in range(commands.shape[0]):
        states[t] = y
        asked = commands[t - 1] if t else np.zeros(2)
        given = (asked, ready.row(y, t, conditions))
        solved = solve_ivp(rate, (0.0, PERIOD), y, method, rtol=rtol, atol=atol, args=given)
        evaluations += solved.nfev
        if not solved.success:
            return states[:t], evaluations
        y = solved.y[:, -1]
    return states, evaluations


def timed(run: Callable[[], object]) -> float:
    """s of processor time."""
    began = time.process_time()
    run()
    return time.process_time() - began


@dataclass(frozen=True)
class RealTime:
    """Simulated over processor time of a case, sensors and truth included, and steps for each millisecond."""

    case: str
    whole: float
    steps: float


def real_time(case: Case, duration: float, repeats: int) -> RealTime:
    """Measure a case of `duration` s: medians of repeated runs, on one core, after everything is compiled."""
    scenario, ready, partner = case.scenario(duration, whole=False), case.prepared(duration), case.partner
    for _ in raw_blocks(ready):
        pass
    # The first run loads what is loaded late.
    took = [timed(lambda: simulate(case.unit, scenario, partner=partner)) for _ in range(repeats + 1)]
    return RealTime(case.name, duration / median(took[1:]), float(ready.memory[STEPS]) / scenario.rows)


@dataclass(frozen=True)
class Work:
    """One point of error over work: rms errors (m, Pa) against the reference, and for each second simulated
    the processor time (s) and evaluations of the right-hand side."""

    solver: str
    setting: str
    position: float
    pressure: float
    cpu: float
    evaluations: float


def work_precision(case: Case, duration: float, repeats: int) -> tuple[list[Work], float]:
    """Error over work of the plant's integrator and of peers, of which commands do not hang on states.

    Gives points (medians of the repeats, three at most for peers), and the rms of the pressure difference
    (Pa) between the reference and the tightest Radau: how far the reference is to be trusted.
    """
    reference, commands = case.states(duration, REFERENCE_REFINEMENT)

    def point(solver: str, setting: str, times: int, run: Callable[[], tuple[Array, float]]) -> Work | None:
        costs, found = [], []
        for _ in range(times):
            costs.append(timed(lambda: found.append(run())))
        states, evaluations = found[-1]
        if states.shape[0] < commands.shape[0]:
            return None
        off = states - reference
        drop = off[:, s.SHARED + s.P1] - off[:, s.SHARED + s.P2]
        position, pressure = (float(np.sqrt(np.mean(x**2))) for x in (off[:, s.X], drop))
        return Work(solver, setting, position, pressure, median(costs) / duration, evaluations / duration)

    def own(refine: float) -> tuple[Array, float]:
        ready = case.prepared(duration, refine)
        states = next(iter(raw_blocks(ready, block=reference.shape[0]))).states
        return states, float(ready.memory[STEPS]) * _STAGES

    points = [point("this plant", f"refine {r:g}", repeats, lambda r=r: own(r)) for r in REFINEMENTS]  # type: ignore[misc]
    for method in METHODS:
        integrate(case, commands[:20], method, 1e-3, 1.0, 0.02)  # what is loaded late is not its work
        for rtol, factor in PEER_TOLERANCES:
            run = lambda m=method, r=rtol, f=factor: integrate(case, commands, m, r, f, duration)  # noqa: E731
            points.append(point(f"SciPy {method}", f"rtol {rtol:g}", min(repeats, 3), run))
    done = [p for p in points if p is not None]
    return done, next((p.pressure for p in reversed(done) if p.solver == "SciPy Radau"), np.nan)


@dataclass(frozen=True)
class Plan:
    """How much is measured: s of each run that is timed and how often; s of the run that peers solve; the
    number of random scenarios."""

    speed_duration: float = 30.0
    repeats: int = 5
    work_duration: float = 2.0
    wild: int = 2000


def plant(
    out: OutOption = FOLDER,
    wild: Annotated[int, typer.Option(min=0, max=100_000, help="Random scenarios, or none.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="A minute: rough figures.")] = False,
) -> None:
    """Measure how fast, exact and robust the plant is, beside SciPy's solvers (half an hour)."""
    require_folder(out)
    plan, outcomes = Plan(5.0, 2, 0.1, min(wild, 20)) if quick else Plan(wild=wild), list[Outcome]()
    with progress("measuring the plant", 1.0) as advance, threadpool_limits(1):
        speed = [real_time(case, plan.speed_duration, plan.repeats) for case in SPEED]
        work, trust = work_precision(WORK, plan.work_duration, plan.repeats)
        for seed in range(plan.wild):
            advance(0.2 + 0.8 * seed / plan.wild)
            outcomes.append(try_wild(seed))
    slowest = min(speed, key=lambda each: each.whole)
    print(f"Slowest case, {slowest.case}: {slowest.whole:.0f} times real time")
    print(f"{sum(bool(o.failures) for o in outcomes)} of {len(outcomes)} random runs left physics")
    write_report(out / "performance.md", report_text(plan, speed, work, trust, outcomes))


def report_text(
    plan: Plan, speed: Sequence[RealTime], work: Sequence[Work], trust: float, outcomes: Sequence[Outcome]
) -> str:
    """The whole report."""
    ours = next(point for point in work if point.setting == "refine 1")
    # Each peer's cheapest setting that is no worse than the plant's usual one.
    tight = [p for p in work if p.pressure <= ours.pressure and p.position <= ours.position]
    equal = {
        solver: min((p for p in tight if p.solver == solver), key=lambda p: p.cpu, default=None)
        for solver in dict.fromkeys(p.solver for p in work if p.solver != ours.solver)
    }
    one_axis = [r for r in speed if not r.case.startswith("two axes")]
    return render(
        Path(__file__).with_name("performance.md.j2"), made_by=made_by("plant"), load_now=load_now(),
        plan=plan, speed=speed, work=work, trust=trust, outcomes=outcomes, ours=ours, equal=equal, goal=GOAL,
        slowest=min(one_axis, key=lambda r: r.whole), wild=_wild(outcomes),
    )  # fmt: skip


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
