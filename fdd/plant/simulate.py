"""Run a scenario on a unit: samples as its log would show them, and the truth behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.plant import conditions as c
from fdd.plant import equations as e
from fdd.plant.duty import ConstantSpeed
from fdd.plant.faults.injection import inject
from fdd.plant.integrator import POSITION, SHUTTLE, SPEED_COMMAND, Controller, run
from fdd.plant.oil import bulk_modulus, viscosity_ratio
from fdd.plant.parameters import Parameters, plant_parameters
from fdd.plant.scenario import Scenario
from fdd.plant.sensors import Lateness, Recorder, generator
from fdd.plant.truth import Truth
from fdd.samples import Samples
from fdd.unit import Unit

Array = NDArray[np.float64]

SUBSTEPS = 10
"""Integration steps per millisecond: 0.1 ms each."""
_LEAST_SUBSTEPS, _MOST_SUBSTEPS = 8, 1000


@dataclass(frozen=True)
class Simulation:
    """What one scenario gave.

    Attributes
    ----------
    samples : the log.
    truth : what really was, aligned with the samples' rows.
    labels : one per fault: fault, family, severity, onset_s, profile, side, variant.
    unit, scenario : what it was made from.
    """

    samples: Samples
    truth: Truth
    labels: list[dict[str, str | float | int | None]]
    unit: Unit
    scenario: Scenario


@dataclass(frozen=True)
class Prepared:
    """A scenario ready to run: what the compiled loop takes."""

    state: Array
    conditions: Array
    parameters: Parameters
    controller: Controller
    temperature: Array


def prepare(unit: Unit, scenario: Scenario, *, substeps: int = SUBSTEPS) -> Prepared:
    """Turn unit and scenario into the compiled loop's arguments.

    Raises
    ------
    InputError : the duty leaves the stroke, or the unit cannot be simulated.
    """
    if not _LEAST_SUBSTEPS <= substeps <= _MOST_SUBSTEPS:
        raise InputError(
            f"substeps {substeps} is out of range", mend=f"use {_LEAST_SUBSTEPS} to {_MOST_SUBSTEPS}"
        )
    _fits(unit, scenario)
    n, seed = scenario.rows, scenario.seed
    time = np.arange(n, dtype=np.float64) * 1e-3
    position = scenario.control.mode == "position"
    setpoint = scenario.duty.setpoint(n, position, generator(seed, "duty"))
    temperature = scenario.oil_temperature + scenario.warming * time
    force = scenario.load.force(n, generator(seed, "load"))
    rows = c.healthy_conditions(unit, setpoint, temperature, force)
    inject(rows, time, scenario.faults, viscosity_ratio(unit.oil, temperature), scenario.details)
    spread = np.clip(generator(seed, "friction").standard_normal(2), -3.0, 3.0) * unit.friction.trial_spread
    draw = np.maximum(1.0 + spread, 0.1)
    parameters = plant_parameters(
        unit,
        scenario.details,
        scenario.load,
        charge_factor=scenario.charge_factor,
        ambient=scenario.ambient,
        friction_draw=(float(draw[0]), float(draw[1])),
    )
    return Prepared(
        state=_at_rest(unit, scenario, parameters, float(force[0])),
        conditions=rows,
        parameters=parameters,
        controller=_controller(unit, scenario, substeps),
        temperature=temperature,
    )


def simulate(unit: Unit, scenario: Scenario, *, substeps: int = SUBSTEPS) -> Simulation:
    """Simulate one run. The same unit, scenario and substeps give the same bits.

    Parameters
    ----------
    unit : the actuator; all physics follow it.
    scenario : the run.
    substeps : integration steps per millisecond, 8 to 1000.

    Returns
    -------
    samples, truth and labels; n = duration in ms, less the rows that the recording lost.

    Raises
    ------
    InputError : the scenario does not fit the unit, or the run left the range of the model.

    Examples
    --------
    >>> out = simulate(Unit.load("axis_a"), Scenario(duration=0.1, seed=7))
    >>> len(out.truth) == len(out.samples), out.labels
    (True, [])
    """
    ready = prepare(unit, scenario, substeps=substeps)
    late = Lateness(scenario.recording, substeps, scenario.seed).steps(scenario.rows)
    states, found, commands = run(
        ready.state, ready.conditions, ready.parameters, ready.controller, late, substeps
    )
    if not np.isfinite(states[-1]).all():
        second = float(np.flatnonzero(~np.isfinite(states).all(axis=1))[0]) * 1e-3
        raise InputError(
            f"the simulation left the range of the model at {second:.3f} s",
            where=f"unit {unit.name}",
            mend="check the unit's masses, volumes and drive poles",
        )
    time = (np.arange(scenario.rows) + late / substeps) * 1e-3
    everything = _truth_columns(unit, scenario, ready, states, found)
    seen = {**everything, "command": commands}
    if scenario.control.mode == "position":
        seen["position_setpoint"] = ready.conditions[:, c.SETPOINT]
    recorder = Recorder(unit, scenario.faults, scenario.recording, scenario.seed)
    rows = recorder.measure(seen, time)
    samples, kept = rows.samples(), rows.kept
    truth = Truth(
        time=samples.time,
        columns={name: values[kept] for name, values in everything.items()},
        severity={spec.fault: spec.over(time[kept]) for spec in scenario.faults},
    )
    labels = [spec.label() for spec in scenario.faults]
    return Simulation(samples, truth, labels, unit, scenario)


def _fits(unit: Unit, scenario: Scenario) -> None:
    """Whether the duty stays within the stroke."""
    duty, half = scenario.duty, 0.5 * unit.cylinder.stroke
    moves = duty.amplitude if scenario.control.mode == "position" or isinstance(duty, ConstantSpeed) else 0.0
    if abs(duty.offset) + moves > 0.95 * half:
        raise InputError(
            f"amplitude {moves:g} m around offset {duty.offset:g} m leaves the stroke of ±{half:g} m",
            where="scenario duty",
            mend=f"keep |offset| + amplitude within {0.95 * half:.3f} m",
        )


def _controller(unit: Unit, scenario: Scenario, substeps: int) -> Controller:
    duty, encoder = scenario.duty, unit.sensor("position")
    shuttle = isinstance(duty, ConstantSpeed)
    if scenario.control.mode == "position":
        mode = POSITION
    else:
        mode = SHUTTLE if shuttle else SPEED_COMMAND
    return Controller(
        mode=mode,
        gain=scenario.control.gain,
        max_speed=unit.drive.max_speed,
        limit=0.45 * unit.cylinder.stroke,
        low=duty.offset - duty.amplitude,
        high=duty.offset + duty.amplitude,
        dwell=round(duty.dwell * 1000.0) if isinstance(duty, ConstantSpeed) else 0,
        encoder_gain=encoder.gain,
        encoder_zero=encoder.zero,
        encoder_resolution=encoder.resolution,
        delay=round(unit.drive.delay * 1000.0 * substeps),
    )


def _at_rest(unit: Unit, scenario: Scenario, par: Parameters, force: float) -> Array:
    """The state at which nothing moves: chambers at charge pressure, the loaded one above it."""
    y = np.zeros(e.STATES)
    y[e.X] = scenario.duty.offset
    charge = unit.accumulator.charge_pressure * scenario.charge_factor
    area_1, area_2 = unit.cylinder.area_1, unit.cylinder.area_2
    # The rod carries the load and, with unequal areas, the charge pressure's own push.
    push = force + par.spring * (y[e.X] - par.spring_centre) - charge * (area_1 - area_2)
    y[e.P1] = charge + max(push, 0.0) / area_1
    y[e.P2] = charge + max(-push, 0.0) / area_2
    return y


def _truth_columns(
    unit: Unit, scenario: Scenario, ready: Prepared, states: Array, found: Array
) -> dict[str, Array]:
    rows, par = ready.conditions, ready.parameters
    oil, air = unit.oil, rows[:, c.AIR]
    coulomb = 0.5 * (par.coulomb_forward + par.coulomb_reverse)
    viscous = 0.5 * (par.viscous_forward + par.viscous_reverse)
    p1, p2 = states[:, e.P1], states[:, e.P2]
    return {
        "leakage": rows[:, c.CROSS_LEAKAGE] + 0.5 * rows[:, c.CASE_LEAKAGE],
        "bulk_modulus": bulk_modulus(oil, np.full(air.size, oil.reference_pressure), air),
        "bulk_modulus_1": bulk_modulus(oil, p1, air, scenario.ambient),
        "bulk_modulus_2": bulk_modulus(oil, p2, air, scenario.ambient),
        "coulomb_friction": coulomb * rows[:, c.FRICTION],
        "viscous_friction": viscous * rows[:, c.VISCOUS],
        "position": states[:, e.X],
        "velocity": states[:, e.V],
        "pressure_1": p1,
        "pressure_2": p2,
        "pressure_difference": p1 - p2,
        "pressure_accumulator": found[:, e.ACCUMULATOR],
        "pump_angle": states[:, e.ANGLE],
        "pump_speed": states[:, e.SPEED],
        "motor_current": found[:, e.CURRENT],
        "oil_temperature": ready.temperature,
        "friction_force": found[:, e.FRICTION_FORCE],
        "load_force": found[:, e.LOAD_FORCE],
        "stop_force": found[:, e.STOP_FORCE],
        "pump_flow": found[:, e.PUMP_FLOW],
        "cross_flow": found[:, e.CROSS_FLOW],
        "refeed_flow_1": found[:, e.REFEED_1],
        "refeed_flow_2": found[:, e.REFEED_2],
        "drain_flow": found[:, e.DRAIN_FLOW],
        "relief_flow": found[:, e.RELIEF_FLOW],
        "stuck_relief_flow": found[:, e.STUCK_RELIEF_FLOW],
        "oil_mass": found[:, e.OIL_MASS],
    }
