"""How fast and how exact the plant is: over real time, and beside SciPy's solvers.

SciPy's solvers get the plant's own compiled right-hand side through a thin wrapper, with commands and
conditions held as there; a solver starts anew wherever a command arrives, as any solver must.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fdd.plant import PERIOD
from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.integrator import STEPS
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import raw_blocks, simulate
from fdd.plant.steps import tolerances
from fdd.unit import Unit
from reports.writing import timed

Array = NDArray[np.float64]

METHODS = ("RK45", "LSODA", "Radau")
REFERENCE_REFINEMENT = 64.0
REFINEMENTS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
PEER_TOLERANCES = ((1e-3, 1e4), (1e-5, 1e2), (1e-7, 1.0), (1e-9, 1e-2))
"""Relative tolerance, and absolute ones over the plant's own."""
_STAGES = 6
"""Evaluations of the right-hand side in a step: the seventh is the next one's first."""


@dataclass(frozen=True)
class Case:
    """A run of axis A that is measured, with axis B where the scenario's `settings` have a partner."""

    name: str
    settings: dict[str, Any]
    unit: Unit = field(default_factory=lambda: Unit.load("axis_a"))

    @property
    def partner(self) -> Unit | None:
        """The second axis."""
        return Unit.load("axis_b") if "partner" in self.settings else None

    def scenario(self, duration: float, **more: Any) -> Scenario:
        """The run of `duration` s."""
        return Scenario(**{"unit": self.unit.name, "seed": 4, **self.settings, **more, "duration": duration})

    def prepared(self, duration: float, refine: float = 1.0) -> Prepared:
        """The run, ready, with every sample at its millisecond."""
        whole = self.scenario(duration, recording=Recording.perfect())
        return prepare(self.unit, whole, partner=self.partner, refine=refine)

    def states(self, duration: float, refine: float = 1.0) -> tuple[Array, Array]:
        """States (n, …) and commands (n, 2) of the run, at every millisecond."""
        rows = self.scenario(duration).rows
        block = next(iter(raw_blocks(self.prepared(duration, refine), block=rows)))
        return block.states, block.commands


_FAULT = {"faults": [{"fault": "internal_leakage", "severity": 0.5, "onset": 2.0}]}
SPEED = (
    Case("steps", {"duty": {"name": "steps"}, "load": {"name": "constant"}, **_FAULT}),
    Case("sines", {"duty": {"name": "sines"}, "load": {"name": "spring"}, **_FAULT}),
    Case("sawtooth", {"duty": {"name": "sawtooth"}, "load": {"name": "inertia"}, **_FAULT}),
    Case("strokes", {"duty": {"name": "strokes"}, "load": {"name": "throttle"}, **_FAULT}),
    Case("flight, gust", {"duty": {"name": "flight"}, "load": {"name": "gust"}, **_FAULT}),
    Case("prbs", {"duty": {"name": "prbs", "amplitude": 0.01}, **_FAULT}),
    Case("two axes, steps", {"duty": {"name": "steps"}, "partner": {}, **_FAULT}),
    Case("two axes, sines", {"duty": {"name": "sines"}, "load": {"name": "spring"}, "partner": {}, **_FAULT}),
)
"""For the real-time factor: everything on."""
WORK = Case("prbs of speed, throttle", {
    "duty": {"name": "prbs", "bit": 0.1, "speed": 60.0, "lead_in": 0.05},
    "control": {"mode": "speed"}, "load": {"name": "throttle"},
})  # fmt: skip
"""For error over work: open-loop speeds, the same commands for every solver."""


def integrate(
    case: Case, commands: Array, method: str, rtol: float, atol_factor: float, duration: float
) -> tuple[Array, int]:
    """Run a case by a `method` of `scipy.integrate.solve_ivp`, absolute tolerances over the plant's own, with
    `commands` (n, 2) rad/s, which act a millisecond later.

    Gives states (n, …) at the start of every millisecond, fewer where the solver gave up, and evaluations of
    the right-hand side.
    """
    ready = case.prepared(duration)
    assert all(unit.drive.delay == PERIOD for unit in ready.units)
    conditions = ready.conditions(0, commands.shape[0])
    first, second = ready.parameters[0], ready.parameters[-1]
    atol = tolerances(len(ready.units)) * atol_factor
    found = np.empty(len(ready.units) * s.FINDINGS)
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


class RealTime(NamedTuple):
    """Simulated over processor time of a case, sensors and truth included, and steps for each millisecond."""

    case: str
    whole: float
    steps: float


def real_time(case: Case, duration: float, repeats: int) -> RealTime:
    """Measure a case of `duration` s: medians of repeated runs, on one core, after everything is compiled."""
    scenario, ready = case.scenario(duration), case.prepared(duration)
    for _ in raw_blocks(ready):
        pass
    # The first run loads what is loaded late.
    took = [timed(lambda: simulate(case.unit, scenario, partner=case.partner)) for _ in range(repeats + 1)]
    return RealTime(case.name, duration / median(took[1:]), float(ready.memory[STEPS]) / scenario.rows)


class Work(NamedTuple):
    """One point of error over work: rms errors (m, Pa) against the reference, and for each second simulated
    the processor time (s) and evaluations of the right-hand side."""

    solver: str
    setting: str
    position: float
    pressure: float
    cpu: float
    evaluations: float


def work_precision(case: Case, duration: float, repeats: int) -> tuple[list[Work], float]:
    """Error over work of the plant and of peers, medians of the repeats (three at most for peers).

    Gives also the rms of the pressure difference (Pa) between the reference and the tightest Radau: how far
    the reference is to be trusted.
    """
    reference, commands = case.states(duration, REFERENCE_REFINEMENT)
    points = []

    def add(solver: str, setting: str, times: int, run: Callable[[], tuple[Array, float]]) -> None:
        costs, found = [], []
        for _ in range(times):
            costs.append(timed(lambda: found.append(run())))
        states, evaluations = found[-1]
        if states.shape[0] == commands.shape[0]:  # the solver did not give up
            off = states - reference
            drop = off[:, s.SHARED + s.P1] - off[:, s.SHARED + s.P2]
            position, pressure = (float(np.sqrt(np.mean(x**2))) for x in (off[:, s.X], drop))
            cost = (median(costs) / duration, evaluations / duration)
            points.append(Work(solver, setting, position, pressure, *cost))

    for refine in REFINEMENTS:

        def own(refine: float = refine) -> tuple[Array, float]:
            ready = case.prepared(duration, refine)
            states = next(iter(raw_blocks(ready, block=reference.shape[0]))).states
            return states, float(ready.memory[STEPS]) * _STAGES

        add("this plant", f"refine {refine:g}", repeats, own)
    for method in METHODS:
        integrate(case, commands[:20], method, 1e-3, 1.0, 0.02)  # what is loaded late is not its work
        for rtol, factor in PEER_TOLERANCES:
            run = partial(integrate, case, commands, method, rtol, factor, duration)
            add(f"SciPy {method}", f"rtol {rtol:g}", min(repeats, 3), run)
    return points, next((p.pressure for p in reversed(points) if p.solver == "SciPy Radau"), np.nan)
