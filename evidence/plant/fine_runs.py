"""A run of the plant sampled many times a millisecond, at the nodes of Lobatto's quadrature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from fdd.plant import state as s
from fdd.plant.equations import right_hand_side
from fdd.plant.integrator import PERIOD
from fdd.plant.prepare import Prepared, prepare
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import raw_blocks
from fdd.plant.steps import STAGES, advance
from fdd.unit import Unit

Array = NDArray[np.float64]


def lobatto(n: int) -> tuple[Array, Array]:
    """Nodes on 0 to 1, both ends included, and their weights: exact up to degree 2n - 3."""
    inner = legendre.Legendre.basis(n - 1)
    nodes = np.concatenate([[-1.0], np.sort(inner.deriv().roots().real), [1.0]])
    weights = 2.0 / (n * (n - 1) * inner(nodes) ** 2)
    return 0.5 * (nodes + 1.0), 0.5 * weights


@dataclass(frozen=True)
class FineRun:
    """What the plant went through: m milliseconds of k nodes.

    Attributes
    ----------
    ready : the prepared scenario (its state is not touched).
    states, slopes, found : (m, k, …) as the right-hand side takes and gives them.
    rows : (m, axes, COLUMNS) conditions as the loop held them: at the present temperature, faults included.
    weights : (k,) s.
    """

    ready: Prepared
    states: Array
    slopes: Array
    found: Array
    rows: Array
    weights: Array

    def integral(self, power: Array) -> Array:
        """Running integral of (m, k) over time at the end of each millisecond, (m,)."""
        return np.cumsum(power @ self.weights)

    def at(self, state: int, axis: int = 0) -> Array:
        """One state of an axis, (m, k)."""
        return self.states[:, :, s.SHARED + axis * s.AXIS_STATES + state]

    def slope(self, state: int, axis: int = 0) -> Array:
        """Rate of one state of an axis, (m, k)."""
        return self.slopes[:, :, s.SHARED + axis * s.AXIS_STATES + state]

    def finding(self, which: int, axis: int = 0) -> Array:
        """One finding of an axis, (m, k)."""
        return self.found[:, :, axis * s.FINDINGS + which]


def fine_run(
    unit: Unit, scenario: Scenario, *, partner: Unit | None = None, nodes: int = 12, refine: float = 4.0
) -> FineRun:
    """Run the plant's own integrator from node to node, with the commands of the whole run.

    The commands are those that `raw_blocks` gave, a whole millisecond late as both drives are.
    """
    assert all(each.drive.delay == PERIOD for each in (unit, partner or unit))
    commands = next(iter(raw_blocks(prepare(unit, scenario, partner=partner, refine=refine)))).commands
    ready = prepare(unit, scenario, partner=partner, refine=refine)
    conditions = ready.conditions(0, scenario.rows)
    rows = np.empty_like(conditions[0])
    first, second = ready.parameters[0], ready.parameters[-1]
    points, weights = lobatto(nodes)
    y = ready.state.copy()
    k, stage = np.empty((STAGES, y.size)), np.empty(y.size)
    found = np.empty(ready.axes * s.FINDINGS)
    states = np.empty((scenario.rows, nodes, y.size))
    slopes = np.empty_like(states)
    findings = np.empty((scenario.rows, nodes, found.size))
    length = 1e-4
    for t in range(scenario.rows):
        before = commands[t - 1] if t else np.zeros(2)
        rows[t] = ready.row(y, t, conditions)
        for i in range(nodes):
            right_hand_side(y, before[0], before[1], rows[t], first, second, k[0], found)
            states[t, i], slopes[t, i], findings[t, i] = y, k[0], found
            if i + 1 < nodes:
                span = (points[i + 1] - points[i]) * PERIOD
                length, _ = advance(
                    y, span, length, ready.longest, before[0], before[1], rows[t], first, second,
                    1.0 / ready.allowed, k, stage, found,
                )  # fmt: skip
    return FineRun(ready, states, slopes, findings, rows, weights * PERIOD)
