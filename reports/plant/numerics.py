"""How fast and how exact the plant is: over real time, beside SciPy's solvers, and with shorter steps.

SciPy's solvers get the plant's own compiled right-hand side through a thin wrapper, with commands and
conditions held as there; a solver starts anew wherever a command arrives, as any solver must.

A difference of two runs counts against what a sensor cannot see: the root mean square of its white noise and
of its rounding, LSB/√12. For the encoders, which have no noise, that is LSB/√12 alone. Differences are those
of the true quantities, before any sensor.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.integrator import PERIOD, STEPS
from fdd.plant.simulate import raw_blocks, simulate
from fdd.plant.steps import tolerances
from fdd.unit import Unit
from reports.plant.cases import Case

Array = NDArray[np.float64]

METHODS = ("RK45", "LSODA", "Radau")
REFERENCE_REFINEMENT = 64.0
REFINEMENTS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
PEER_TOLERANCES = ((1e-3, 1e4), (1e-5, 1e2), (1e-7, 1.0), (1e-9, 1e-2))
"""Relative tolerance, and absolute ones over the plant's own."""
_STAGES = 6
"""Evaluations of the right-hand side in a step: the seventh is the next one's first."""


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
    scenario, ready = case.scenario(duration, whole=False), case.prepared(duration)
    for _ in raw_blocks(ready):
        pass
    # The first run loads what is loaded late.
    took = [timed(lambda: simulate(case.unit, scenario, partner=case.partner)) for _ in range(repeats + 1)]
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
class Difference:
    """How far two runs of a case lie apart: for each channel the rms over what its sensor cannot see."""

    case: str
    rms: dict[str, float]

    @property
    def worst(self) -> float:
        """Largest but for the angle's: accumulated, it is an integral that no loop closes, and errors of each
        corner that a step runs over add up like a random walk."""
        return max(value for channel, value in self.rms.items() if channel != "pump_angle")


def against_half_steps(case: Case, duration: float) -> Difference:
    """The case's usual run against steps half as long."""
    return _difference(case, case.states(duration)[0], case.states(duration, 2.0)[0])


def against_radau(case: Case, duration: float, rtol: float = 1e-10) -> Difference:
    """The case's usual run against SciPy's Radau with tight tolerances, fed the same commands."""
    states, commands = case.states(duration)
    peer, _ = integrate(case, commands, "Radau", rtol, 1e-2, duration)
    return _difference(case, states[: peer.shape[0]], peer)


def _difference(case: Case, one: Array, other: Array) -> Difference:
    rms: dict[str, float] = {}
    for axis, unit in enumerate(filter(None, (case.unit, case.partner))):
        # As shipped: also where the loop's encoder was given no steps.
        shipped, off = Unit.load(unit.name), one - other
        own = off[:, s.SHARED + axis * s.AXIS_STATES :]
        for channel, error in (
            ("position", off[:, s.X]), ("pump_speed", own[:, s.SPEED]),
            ("pressure_difference", own[:, s.P1] - own[:, s.P2]), ("motor_current", own[:, s.CURRENT]),
            ("pump_angle", own[:, s.ANGLE]),
        ):  # fmt: skip
            sensor = shipped.sensor(channel)
            unseen = np.hypot(sensor.noise, sensor.resolution / np.sqrt(12.0))
            rms[channel] = max(rms.get(channel, 0.0), float(np.sqrt(np.mean(error**2)) / unseen))
    return Difference(case.name, rms)
