"""How fast the plant runs: over real time, and error over work beside peers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from evidence.plant.cases import Case
from evidence.plant.peers import METHODS, integrate
from fdd.plant import state as s
from fdd.plant.integrator import STEPS
from fdd.plant.simulate import raw_blocks, simulate

Array = NDArray[np.float64]

REFERENCE_REFINEMENT = 64.0
REFINEMENTS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
PEER_TOLERANCES = ((1e-3, 1e4), (1e-5, 1e2), (1e-7, 1.0), (1e-9, 1e-2))
"""Relative tolerance, and absolute ones over the plant's own."""
_STAGES = 6
"""Evaluations of the right-hand side in a step: the seventh is the next one's first."""


@dataclass(frozen=True)
class RealTime:
    """Simulated over processor time of a case.

    Attributes
    ----------
    case : its name.
    whole : of `simulate`, sensors and truth included.
    integration : of the compiled loop and its conditions alone.
    steps : of the integrator for each millisecond.
    """

    case: str
    whole: float
    integration: float
    steps: float


@dataclass(frozen=True)
class Work:
    """One point of error over work.

    Attributes
    ----------
    solver, setting : who, and how tight.
    position, pressure : rms error (m, Pa) against the reference.
    cpu : s of processor time for each second simulated.
    evaluations : of the right-hand side for each second simulated.
    """

    solver: str
    setting: str
    position: float
    pressure: float
    cpu: float
    evaluations: float


def real_time(case: Case, duration: float, repeats: int) -> RealTime:
    """Measure a case: medians of repeated runs, on one core, after everything is compiled.

    Parameters
    ----------
    case : sensors with noise, recording and all.
    duration : s.
    repeats : runs of each kind.
    """
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

    Parameters
    ----------
    case : whose commands do not hang on its states, so that all solve the same problem.
    duration : s.
    repeats : runs, of which the median counts; of the peers three at most.

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
    return Work(
        solver,
        setting,
        float(np.sqrt(np.mean(difference[:, s.X] ** 2))),
        float(np.sqrt(np.mean(pressure**2))),
        cpu / duration,
        evaluations / duration,
    )


def _median_cpu(run: Callable[[], object], repeats: int) -> float:
    costs = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        costs.append(time.process_time() - began)
    return median(costs)
