"""How fast and how exact the plant is: over real time, beside SciPy's solvers, and with shorter steps.

SciPy's solvers get the plant's own compiled right-hand side through a thin wrapper, with commands and
conditions held as there; a solver starts anew wherever a command arrives, as any solver must.

A difference of two runs counts against what a sensor cannot see: the root mean square of its white noise and
of its rounding, LSB/√12. For the encoders, which have no noise, that is LSB/√12 alone. Differences are those
of the true quantities, before any sensor.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.integrator import PERIOD, STEPS
from fdd.plant.prepare import Prepared
from fdd.plant.simulate import raw_blocks, simulate
from fdd.plant.steps import tolerances
from fdd.unit import Unit
from reports.plant.cases import Case

Array = NDArray[np.float64]

METHODS = ("RK45", "LSODA", "Radau")


@dataclass(frozen=True)
class PeerRun:
    """What a peer made of a run: states (n, …) at the start of every millisecond, evaluations of the
    right-hand side, and processor time (s)."""

    states: Array
    evaluations: int
    cpu: float


def integrate(
    case: Case, commands: Array, method: str, rtol: float, atol_factor: float, duration: float
) -> PeerRun:
    """Run a case by a `method` of `scipy.integrate.solve_ivp`.

    Parameters
    ----------
    commands : (n, 2) rad/s, what the controllers asked for each millisecond.
    atol_factor : absolute tolerances over `fdd.plant.steps.tolerances`.
    duration : s.
    """
    ready = case.prepared(duration)
    conditions = ready.conditions(0, commands.shape[0])
    first, second = ready.parameters[0], ready.parameters[-1]
    atol = tolerances(ready.axes) * atol_factor
    found = np.empty(ready.axes * s.FINDINGS)
    y = ready.state.copy()
    states = np.empty((commands.shape[0], y.size))
    evaluations = 0

    def rate(_time: float, at: Array, command_1: float, command_2: float, now: Array) -> Array:
        dy = np.empty(at.size)
        right_hand_side(at, command_1, command_2, now, first, second, dy, found)
        return dy

    began = time.process_time()
    for t in range(commands.shape[0]):
        states[t] = y
        now = ready.row(y, t, conditions)
        for start, stop, command_1, command_2 in _held(ready, commands, t):
            solved = solve_ivp(
                rate, (start, stop), y, method, rtol=rtol, atol=atol, args=(command_1, command_2, now)
            )
            evaluations += solved.nfev
            if not solved.success:
                return PeerRun(states[:t], evaluations, time.process_time() - began)
            y = solved.y[:, -1]
    return PeerRun(states, evaluations, time.process_time() - began)


def _held(ready: Prepared, commands: Array, t: int) -> Iterator[tuple[float, float, float, float]]:
    """Parts of millisecond `t` with the commands that hold in each: a drive's delay may end within it."""
    whole = [0, 0]
    part = [0.0, 0.0]
    for axis, unit in enumerate(ready.units):
        whole[axis] = int(unit.drive.delay / PERIOD + 1e-9)
        rest = unit.drive.delay - whole[axis] * PERIOD
        part[axis] = rest if rest > 1e-9 else 0.0
    edges = sorted({0.0, PERIOD, *(p for p in part if p > 0.0)})
    for start, stop in pairwise(edges):
        rows = [t - whole[axis] - (1 if start < part[axis] else 0) for axis in range(2)]
        yield start, stop, *(float(commands[row, axis]) if row >= 0 else 0.0 for axis, row in enumerate(rows))  # type: ignore[misc]


REFERENCE_REFINEMENT = 64.0
REFINEMENTS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
PEER_TOLERANCES = ((1e-3, 1e4), (1e-5, 1e2), (1e-7, 1.0), (1e-9, 1e-2))
"""Relative tolerance, and absolute ones over the plant's own."""
_STAGES = 6
"""Evaluations of the right-hand side in a step: the seventh is the next one's first."""


@dataclass(frozen=True)
class RealTime:
    """Simulated over processor time of a case: of `simulate`, sensors and truth included; of the compiled
    loop and its conditions alone; and the integrator's steps for each millisecond."""

    case: str
    whole: float
    integration: float
    steps: float


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


def real_time(case: Case, duration: float, repeats: int) -> RealTime:
    """Measure a case of `duration` s: medians of repeated runs, on one core, after everything is compiled."""
    scenario = case.scenario(duration, whole=False)
    simulate(case.unit, scenario, partner=case.partner)
    whole = _median_cpu(lambda: simulate(case.unit, scenario, partner=case.partner), repeats)

    steps = 0.0

    def integrated() -> None:
        nonlocal steps
        ready = case.prepared(duration)
        for _ in raw_blocks(ready):
            pass
        steps = float(ready.memory[STEPS]) / scenario.rows

    alone = _median_cpu(integrated, repeats)
    return RealTime(case.name, duration / whole, duration / alone, steps)


def work_precision(case: Case, duration: float, repeats: int) -> tuple[list[Work], float]:
    """Error over work of the plant's integrator and of peers on the same equations.

    The case's commands do not hang on its states, so that all solve the same problem. The median of the
    repeats counts; the peers have three at most.

    Returns
    -------
    points, and the rms of the pressure difference (Pa) between the reference and the tightest Radau: how far
    the reference is to be trusted.
    """
    reference, _, commands = case.states(duration, REFERENCE_REFINEMENT)
    points = [_own(case, refine, duration, repeats, reference) for refine in REFINEMENTS]
    trust = np.nan
    for method in METHODS:
        integrate(case, commands[:20], method, 1e-3, 1.0, 0.02)  # what is loaded late is not its work
        for rtol, factor in PEER_TOLERANCES:
            peers = [
                integrate(case, commands, method, rtol, factor, duration) for _ in range(min(repeats, 3))
            ]
            peer = peers[0]
            if peer.states.shape[0] < commands.shape[0]:
                continue
            cpu = median(each.cpu for each in peers)
            name, setting = f"SciPy {method}", f"rtol {rtol:g}"
            point = _point(name, setting, peer.states, reference, cpu, peer.evaluations, duration)
            points.append(point)
            if method == "Radau":
                trust = point.pressure
    return points, trust


def _own(case: Case, refine: float, duration: float, repeats: int, reference: Array) -> Work:
    costs = []
    for _ in range(repeats):
        ready = case.prepared(duration, refine)
        began = time.process_time()
        states = next(iter(raw_blocks(ready, block=reference.shape[0]))).states
        costs.append(time.process_time() - began)
    evaluations = float(ready.memory[STEPS]) * _STAGES
    return _point("this plant", f"refine {refine:g}", states, reference, median(costs), evaluations, duration)


def _point(
    solver: str,
    setting: str,
    states: Array,
    reference: Array,
    cpu: float,
    evaluations: float,
    duration: float,
) -> Work:
    difference = states - reference
    pressure = difference[:, s.SHARED + s.P1] - difference[:, s.SHARED + s.P2]
    off, off_pressure = (float(np.sqrt(np.mean(x**2))) for x in (difference[:, s.X], pressure))
    return Work(solver, setting, off, off_pressure, cpu / duration, evaluations / duration)


def _median_cpu(run: Callable[[], object], repeats: int) -> float:
    costs = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        costs.append(time.process_time() - began)
    return median(costs)


GAINED = "pump_angle in 1 s"
"""The angle gained in a second: accumulated, the angle is an integral that no loop closes, and errors of each
corner that a step runs over add up like a random walk."""


def unseen(unit: Unit, channel: str) -> float:
    """What a sensor cannot see (SI): rms of its noise and of its rounding.

    Examples
    --------
    >>> round(unseen(Unit.load("axis_a"), "position") * 1e9)
    289
    """
    sensor = unit.sensor(channel)
    return float(np.hypot(sensor.noise, sensor.resolution / np.sqrt(12.0)))


@dataclass(frozen=True)
class Difference:
    """How far two runs of a case lie apart, for each channel over `unseen`.

    Attributes
    ----------
    case : its name.
    rms, most : channel to root mean square and largest difference.
    first_count : s at which the loop's encoder first showed another count; NaN where it never did.
    """

    case: str
    rms: dict[str, float]
    most: dict[str, float]
    first_count: float = np.nan

    @property
    def worst(self) -> float:
        """Largest of the root mean squares, but for the angle's, which see."""
        return max(value for channel, value in self.rms.items() if channel not in ("pump_angle", GAINED))


def sensed(states: Array, found: Array | None, axis: int = 0) -> dict[str, Array]:
    """The quantities behind the sensors of an axis, from states (n, …) and findings."""
    own = states[:, s.SHARED + axis * s.AXIS_STATES :]
    out = {
        "position": states[:, s.X],
        "pump_angle": own[:, s.ANGLE],
        "pump_speed": own[:, s.SPEED],
        "pressure_difference": own[:, s.P1] - own[:, s.P2],
        "motor_current": own[:, s.CURRENT],
    }
    if states.shape[0] > 1000:
        out[GAINED] = own[1000:, s.ANGLE] - own[:-1000, s.ANGLE]
    if found is not None:
        out["pressure_accumulator"] = found[:, axis * s.FINDINGS + s.ACCUMULATOR]
    return out


def against_half_steps(case: Case, duration: float) -> Difference:
    """The case's usual run against steps half as long."""
    usual, halved = (case.states(duration, refine) for refine in (1.0, 2.0))
    changed = np.flatnonzero(np.abs(usual[2] - halved[2]).max(axis=1) > 1e-3)
    first = changed[0] * 1e-3 if changed.size else np.nan
    return _difference(case, usual[0], usual[1], halved[0], halved[1], first)


def against_radau(case: Case, duration: float, rtol: float = 1e-10) -> Difference:
    """The case's usual run against SciPy's Radau with tight tolerances, fed the same commands."""
    states, _, commands = case.states(duration)
    peer = integrate(case, commands, "Radau", rtol, 1e-2, duration)
    return _difference(case, states[: peer.states.shape[0]], None, peer.states, None, np.nan)


def _difference(
    case: Case, one: Array, found_one: Array | None, other: Array, found_other: Array | None, first: float
) -> Difference:
    rms: dict[str, float] = {}
    most: dict[str, float] = {}
    units = [case.unit, *([case.partner] if case.partner else [])]
    for axis, unit in enumerate(units):
        a, b = sensed(one, found_one, axis), sensed(other, found_other, axis)
        for channel in a:
            error = (a[channel] - b[channel]) / _scale(unit, channel)
            rms[channel] = max(rms.get(channel, 0.0), float(np.sqrt(np.mean(error**2))))
            most[channel] = max(most.get(channel, 0.0), float(np.abs(error).max()))
    return Difference(case.name, rms, most, first)


def _scale(unit: Unit, channel: str) -> float:
    """`unseen`, also where the loop's encoder was given no steps."""
    name = "pump_angle" if channel == GAINED else channel
    rounds = unit.sensor(name).resolution > 0.0
    return unseen(unit if rounds else Unit.load(unit.name), name)
