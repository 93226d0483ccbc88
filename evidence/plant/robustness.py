"""Whether the plant stays within physics, whatever the rig allows: many wild scenarios, each checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evidence.plant.energies import energies
from evidence.plant.fine_runs import fine_run
from evidence.plant.wild import Wild, draw_wild
from fdd.errors import InputError
from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.integrator import PERIOD, STEPS
from fdd.plant.prepare import Prepared
from fdd.plant.simulate import RawBlock, raw_blocks
from fdd.unit import Unit

Array = NDArray[np.float64]

ENERGY = 1e-5
"""Most energy that may be made or lost, over all that went through."""


@dataclass(frozen=True)
class Outcome:
    """What one wild run came to.

    Attributes
    ----------
    seed : of `draw_wild`.
    failures : a sentence for everything outside physics; empty is well.
    lowest_pressure : Pa, absolute, of any chamber or line.
    highest_share : highest gauge pressure over the bound of `pressure_bound`.
    beyond_stop : m that the piston went past its stroke.
    oil, energy : most that oil and energy departed from what came and went, over all oil and over all energy
        that went through.
    steps : of the integrator for each millisecond.
    refused : draws that the rig's rules refused before.
    """

    seed: int
    failures: list[str] = field(default_factory=list)
    lowest_pressure: float = np.nan
    highest_share: float = np.nan
    beyond_stop: float = np.nan
    oil: float = np.nan
    energy: float = np.nan
    steps: float = np.nan
    refused: int = 0


def try_wild(seed: int, duration: float = 4.0) -> Outcome:
    """Run one wild scenario and check it.

    Parameters
    ----------
    seed : of `draw_wild`.
    duration : s.

    Examples
    --------
    >>> try_wild(1, duration=0.5).failures
    []
    """
    wild = draw_wild(seed, duration)
    ready = wild.prepared()
    try:
        raw = next(iter(raw_blocks(ready, block=wild.scenario.rows)))
    except InputError as error:
        return Outcome(seed, [str(error)], refused=wild.refused)
    return _checked(seed, wild, ready, raw)


def try_many(
    number: int, duration: float = 4.0, progress: Callable[[int], None] = lambda done: None
) -> list[Outcome]:
    """`try_wild` for seeds 0 to number - 1."""
    outcomes = []
    for seed in range(number):
        outcomes.append(try_wild(seed, duration))
        progress(seed + 1)
    return outcomes


def _checked(seed: int, wild: Wild, ready: Prepared, raw: RawBlock) -> Outcome:
    failures = []
    if not (np.isfinite(raw.states).all() and np.isfinite(raw.found).all()):
        return Outcome(seed, ["NaN"], refused=wild.refused)
    par, ambient = ready.parameters[0], ready.parameters[0].ambient
    pressures = np.stack(
        [
            raw.states[:, s.SHARED + axis * s.AXIS_STATES + p]
            for axis in range(ready.axes)
            for p in (s.P1, s.P2, s.LINE_1, s.LINE_2)
        ]
    )
    lowest = float(pressures.min() + ambient)
    if lowest <= 0.0:
        failures.append(f"absolute pressure {lowest:.0f} Pa")
    bound = pressure_bound(ready, raw)
    share = float(pressures.max() / bound)
    if share > 1.0:
        failures.append(f"pressure {pressures.max() / 1e6:.2f} MPa, explained {bound / 1e6:.2f} MPa")
    beyond = float(np.abs(raw.states[:, s.X]).max() - par.half_stroke)
    give = _greatest_push(ready, raw, bound) / par.stop_stiffness
    if beyond > give:
        failures.append(f"{beyond * 1e3:.2f} mm beyond the stop, explained {give * 1e3:.2f} mm")
    mass = sum(raw.found[:, axis * s.FINDINGS + s.OIL_MASS] for axis in range(ready.axes))
    drift = float(np.abs(mass / np.asarray(mass)[0] - 1.0).max())
    if drift > 1e-6:
        failures.append(f"oil changed by {drift:.1e}")
    gap = energy_gap(wild)
    if gap > ENERGY:
        failures.append(f"energy changed by {gap:.1e}")
    speed, most = _motor_speed(ready, raw)
    if speed > most:
        failures.append(f"motor at {speed:.0f} rad/s, explained {most:.0f} rad/s")
    steps = float(ready.memory[STEPS]) / raw.states.shape[0]
    return Outcome(seed, failures, lowest, share, beyond, drift, gap, steps, wild.refused)


def energy_gap(wild: Wild, duration: float = 0.4) -> float:
    """Energy made or lost in the run's first part, over all that went through (`evidence.plant.energies`)."""
    units = [each and _with_whole_delay(each) for each in (wild.unit, wild.partner)]
    faults = [spec for spec in wild.scenario.faults if spec.onset < duration]
    scenario = wild.scenario.model_copy(update={"duration": duration, "faults": faults})
    assert units[0] is not None
    share = np.inf
    for nodes in (12, 40):
        # Corners of friction and valves within a millisecond are what the fewer nodes miss.
        run = fine_run(units[0], scenario, partner=units[1], nodes=nodes)
        gap, through = energies(run).gap(run)
        # A run in which hardly anything moves is judged by a joule.
        share = gap / max(through, 1.0)
        if share <= ENERGY:
            break
    return share


def _with_whole_delay(unit: Unit) -> Unit:
    return unit.model_copy(update={"drive": unit.drive.model_copy(update={"delay": PERIOD})})


def pressure_bound(ready: Prepared, raw: RawBlock) -> float:
    """Gauge pressure (Pa) that a run can explain, from what it is driven and loaded with.

    The highest accumulator pressure, plus the relief valves' setting, plus the rise over their gain at all
    the flow that pumps and pistons push, plus what external force, springs, friction and the momentum of rod
    and load (v·√(M·k), on the springs of the oil) press on one piston. Relief valves lie across the ports:
    joined by one line, or one axis blocked, a low side stands on the other axis's high one, and the settings
    add up.

    Parameters
    ----------
    ready : the run's parameters.
    raw : the whole run.
    """
    highest = 0.0
    flow = 0.0
    settings: list[float] = []
    v = np.abs(raw.states[:, s.V]).max()
    for axis, par in enumerate(ready.parameters):
        o, f = s.SHARED + axis * s.AXIS_STATES, axis * s.FINDINGS
        highest = max(highest, float(raw.found[:, f + s.ACCUMULATOR].max()), float(raw.states[0, o + s.P1]))
        flow += par.displacement * float(np.abs(raw.states[:, o + s.SPEED]).max()) * 1.1 + par.area_1 * v
        settings.append(par.relief_pressure)
    joined = np.asarray(raw.rows[:, 0, [c.CONNECT_1, c.CONNECT_2]]).any()
    relief = sum(settings) if joined or any(par.blocked for par in ready.parameters) else max(settings)
    gain = min(par.relief_gain for par in ready.parameters)
    area = min(min(par.area_1, par.area_2) for par in ready.parameters)
    return highest + relief + flow / gain + _rod_force(ready, raw) / area


def _motor_speed(ready: Prepared, raw: RawBlock) -> tuple[float, float]:
    """Fastest motor, and the speed that its command or the oil of pistons and the other pump explain."""
    v = float(np.abs(raw.states[:, s.V]).max())
    fastest = [
        float(np.abs(raw.states[:, s.SHARED + axis * s.AXIS_STATES + s.SPEED]).max())
        for axis in range(ready.axes)
    ]
    worst = int(np.argmax(fastest))
    par = ready.parameters[worst]
    flow = par.area_1 * v
    if ready.axes > 1:
        other = 1 - worst
        flow += ready.parameters[other].displacement * fastest[other]
    return fastest[worst], 1.3 * max(par.max_speed, flow / par.displacement)


def _rod_force(ready: Prepared, raw: RawBlock) -> float:
    """External force, friction and momentum on the rod (N), at their largest."""
    first = ready.parameters[0]
    force = float(np.abs(raw.found[:, s.LOAD_FORCE]).max())
    spring = 0.0
    for axis, par in enumerate(ready.parameters):
        force += float(np.abs(raw.found[:, axis * s.FINDINGS + s.FRICTION_FORCE]).max())
        spring += par.area_1**2 * (1.0 / par.volume_1 + 1.0 / par.volume_2) / par.stiff_compliance
    v = float(np.abs(raw.states[:, s.V]).max())
    return force + v * float(np.sqrt(first.mass * spring))


def _greatest_push(ready: Prepared, raw: RawBlock, bound: float) -> float:
    """Force (N) with which pistons and momentum can press on a stop."""
    first = ready.parameters[0]
    v = float(np.abs(raw.states[:, s.V]).max())
    pistons = sum(par.area_1 * bound for par in ready.parameters)
    return _rod_force(ready, raw) + pistons + v * float(np.sqrt(first.mass * first.stop_stiffness))
