"""Solvers of SciPy on the plant's own right-hand side, with commands and conditions held as there.

The right-hand side is the compiled one, called through a thin wrapper; a solver starts anew wherever a
command arrives, as any solver must.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from evidence.plant.cases import Case
from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.integrator import PERIOD
from fdd.plant.prepare import Prepared
from fdd.plant.steps import tolerances

Array = NDArray[np.float64]

METHODS = ("RK45", "LSODA", "Radau")


@dataclass(frozen=True)
class PeerRun:
    """What a peer made of a run.

    Attributes
    ----------
    states : (n, …) at the start of every millisecond.
    evaluations : of the right-hand side.
    cpu : s of processor time.
    """

    states: Array
    evaluations: int
    cpu: float


def integrate(
    case: Case, commands: Array, method: str, rtol: float, atol_factor: float, duration: float
) -> PeerRun:
    """Run a case by a solver of SciPy.

    Parameters
    ----------
    case : what is run.
    commands : (n, 2) rad/s, what the controllers asked for each millisecond.
    method : of `scipy.integrate.solve_ivp`.
    rtol : relative tolerance.
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
