"""Run a scenario on a unit: samples as its log would show them, and the truth behind them.

A run is made block by block, so that an hour fits into the memory of a minute; the blocks together are the
same bits however the run is cut.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fdd.errors import InputError
from fdd.plant import PERIOD, Array
from fdd.plant import conditions as c
from fdd.plant.faults import FaultSpec
from fdd.plant.integrator import LATE_PARTS, run
from fdd.plant.prepare import Prepared, prepare, stream_of
from fdd.plant.scenario import Scenario
from fdd.plant.sensors import Recorder
from fdd.plant.sensors.recording import Lateness
from fdd.plant.state import Truth, truth_columns
from fdd.samples import Samples
from fdd.unit import Unit

_ACTING = {"load": c.BY_LOAD, "heat": c.BY_HEAT}

BLOCK = 20_000
"""Rows that are simulated at a time; about 20 MB for one axis."""

AxisBlock = tuple[Samples, Truth]
"""Some rows of one axis: its log and the truth beside it."""


@dataclass(frozen=True)
class Simulation:
    """What one scenario gave on one axis.

    Attributes
    ----------
    samples, truth : the log, and what really was, aligned with its rows.
    labels : of each fault of this axis, see `FaultSpec.label`.
    unit, scenario : what it was made from.
    partner : the same of the second axis, where there is one.
    """

    samples: Samples
    truth: Truth
    labels: list[dict[str, str | float | int | None]]
    unit: Unit
    scenario: Scenario
    partner: Simulation | None = None


@dataclass(frozen=True)
class RawBlock:
    """Some milliseconds as the compiled loop gave them.

    `time` (n,) s is when each sample was taken, `rows` (n, axes, COLUMNS) the conditions; the others are of
    `fdd.plant.integrator.run`.
    """

    time: Array
    rows: Array
    states: Array
    found: Array
    commands: Array


def raw_blocks(ready: Prepared, block: int = BLOCK) -> Iterator[RawBlock]:
    """Run what was prepared, `block` milliseconds at a time; an `InputError` where the model's range ends."""
    scenario = ready.scenario
    lateness = Lateness(scenario.recording, LATE_PARTS, scenario.seed)
    each, period = scenario.recording.each, scenario.recording.period
    for start in range(0, scenario.rows, block):
        stop = min(start + block, scenario.rows)
        rows, by_load, by_heat = ready.conditions(start, stop)
        late = lateness.steps((stop - start) * each)
        states, found, commands = run(
            ready.state, ready.memory, ready.past, rows, by_load, by_heat, ready.viscosity,
            ready.parameters[0], ready.parameters[-1], ready.controller, late, 1.0 / ready.allowed,
            ready.longest,
        )  # fmt: skip
        if not np.isfinite(states[-1]).all():
            lost = float(np.flatnonzero(~np.isfinite(states).all(axis=1))[0])
            raise InputError(
                f"the simulation left the range of the model at {start * PERIOD + lost * period:.3f} s",
                where=f"unit {ready.units[0].name}",
                mend="check the unit's masses, volumes and drive poles",
            )
        time = (np.arange(start * each, stop * each) + late / LATE_PARTS) * period
        if each > 1:
            rows, commands = np.repeat(rows, each, axis=0), np.repeat(commands, each, axis=0)
        yield RawBlock(time, rows, states, found, commands)


def stream(
    unit: Unit, scenario: Scenario, *, partner: Unit | None = None, refine: float = 1.0, block: int = BLOCK
) -> Iterator[tuple[AxisBlock, ...]]:
    """Simulate one run `block` milliseconds at a time, log and truth of each axis; else as `simulate`."""
    return _measured(prepare(unit, scenario, partner=partner, refine=refine), block)


def _measured(ready: Prepared, block: int = BLOCK) -> Iterator[tuple[AxisBlock, ...]]:
    scenario = ready.scenario
    recording, scales = scenario.recording, scenario.fault_scales
    recorders = [
        Recorder(each, _own(scenario, i), recording, scenario.seed, stream_of(i), scales)
        for i, each in enumerate(ready.units)
    ]
    for raw in raw_blocks(ready, block):
        yield tuple(_axis_block(ready, raw, i, recorder) for i, recorder in enumerate(recorders))


def simulate(
    unit: Unit | str | Path, scenario: Scenario, *, partner: Unit | None = None, refine: float = 1.0
) -> Simulation:
    """Simulate one run. The same units, scenario and refinement give the same bits. An `InputError` where the
    scenario does not fit the unit, or the run leaves the range of the model.

    Parameters
    ----------
    unit : the actuator, or the first axis of a dual one; all physics follow it. A `Unit`, a shipped one's
        name (axis_a, axis_b) or a YAML file.
    scenario : the run.
    partner : unit of the second axis where the scenario has one; None loads the one that it names.
    refine : 2 halves the integrator's steps, 0.25 to 64.

    Returns
    -------
    samples, truth and labels; as many rows as the recording's rate gives, less those that it lost.

    Examples
    --------
    >>> out = simulate("axis_a", Scenario(duration=0.1, seed=7))
    >>> len(out.truth) == len(out.samples), out.labels
    (True, [])
    """
    first = unit if isinstance(unit, Unit) else Unit.load(unit)
    ready = prepare(first, scenario, partner=partner, refine=refine)
    blocks = list(_measured(ready))
    found: Simulation | None = None
    for i in reversed(range(len(ready.units))):
        logs, truths = zip(*(axes[i] for axes in blocks), strict=True)
        samples = Samples.concatenate(list(logs))
        columns, severity = _joined([t.columns for t in truths]), _joined([t.severity for t in truths])
        truth, labels = Truth(samples.time, columns, severity), [s.label() for s in _own(scenario, i)]
        found = Simulation(samples, truth, labels, ready.units[i], scenario, found)
    assert found is not None
    return found


def _own(scenario: Scenario, axis: int) -> list[FaultSpec]:
    return [spec for spec in scenario.faults if spec.axis == axis + 1]


def _axis_block(ready: Prepared, raw: RawBlock, axis: int, recorder: Recorder) -> AxisBlock:
    unit, scenario = ready.units[axis], ready.scenario
    rows = raw.rows[:, axis]
    everything = truth_columns(unit, ready.parameters[axis], rows, raw.states, raw.found, axis)
    known = {"command": raw.commands[:, axis]}
    if scenario.control.mode == "position" and axis == 0:
        known["position_setpoint"] = rows[:, c.SETPOINT]
    stamps, columns, kept = recorder.measure({**everything, **known}, raw.time)
    severity = {
        spec.fault: spec.over(raw.time) * (rows[:, _ACTING[spec.profile]] if spec.profile in _ACTING else 1.0)
        for spec in _own(scenario, axis)
    }
    if not kept.all():
        there = np.flatnonzero(kept)  # taken by index: half the time of a mask
        stamps = stamps[there]
        columns, everything, severity = (
            {name: values.take(there) for name, values in each.items()}
            for each in (columns, everything, severity)
        )
    samples = Samples(stamps, columns)
    return samples, Truth(samples.time, everything, severity)


def _joined(parts: list[dict[str, Array]]) -> dict[str, Array]:
    """Columns of all blocks, one after another."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
