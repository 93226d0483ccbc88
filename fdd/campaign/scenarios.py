"""Drawing a log's scenario: faults, and the load and duty that its unit can bear, within stroke, drive and
relief valve; missions of several duties, and loads that change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fdd.campaign import population
from fdd.campaign.drawing import Rig, stream
from fdd.campaign.population import Rng, chosen, drawn, log_uniform, spread, uniform
from fdd.campaign.recipe import Recipe
from fdd.campaign.sizes import NEUTRAL, Scale
from fdd.campaign.structures import EQUAL
from fdd.faults import CATALOGUE
from fdd.plant import Programme
from fdd.plant.duty import DUTIES, ConstantSpeed, Duty, Mission
from fdd.plant.faults import STATE_BORNE, FaultScales, FaultSpec
from fdd.plant.rig import LOADS, ChangingLoad, Load, PressLoad
from fdd.plant.scenario import Control, Scenario
from fdd.unit import Unit

POSITION_ONLY = ("standstill", "strokes", "flight", "resting", "mission")
"""Duties that make no sense without a position loop: at a commanded speed they would drift away."""
USED_STROKE = 0.8
"""Of half the stroke: most of it that a set-point uses; the rest is for overshoot and drift."""
USED_SPEED = 0.85
"""Of the drive's largest speed that a set-point may ask for, before load and leakage."""
ONE_WAY_S: dict[str, Callable[[dict[str, Any]], float]] = {
    "sines": lambda drawn: 1.0 / (np.pi * drawn["low_hz"]),
    "sweep": lambda drawn: 1.0 / (np.pi * 0.1),
    "sawtooth": lambda drawn: 0.25 * drawn["period"],
    "prbs": lambda drawn: 4.0 * drawn["bit"],
}
"""Duty to the seconds of full speed that it spends in one direction, in speed control; else as it holds."""
SHORTEST_S, STAGES = 15.0, (3, 6)
"""s of a stage of a mission at least, and how many a log has where there is time for them."""
GREATEST_FORCE = 0.65
"""Of relief pressure times area: most that a drawn load asks for, so that no valve relieves for long."""
ONE_SIDED_PRESSURE = 0.15e6
"""Pa, mean pressure by a load from which on friction no longer brings both chambers to pressure in turn."""


def draw_scenario(recipe: Recipe, rig: Rig, rng: Rng, faults: tuple[str, ...] = ()) -> Scenario:
    """Draw one log's scenario: load, duty, conditions and the given faults.

    The rig bounds amplitude by its stroke, speed by its drive and force by its relief valve.
    """
    duration = round(float(rng.uniform(*recipe.duration)), 3)
    load_name, duty_name = chosen(rng, recipe.loads), chosen(rng, recipe.duties)
    gain = log_uniform(rng, recipe.position_gain) * rig.scale.position_gain
    # A throttled partner is a rig for measuring: it is mostly driven by speed.
    share = max(recipe.speed_control_share, 0.7) if load_name == "throttle" else recipe.speed_control_share
    cylinder = rig.unit.cylinder
    by_speed = bool(rng.random() < share)
    duty: Duty
    if duty_name == "mission":
        duty, control = drawn_mission(recipe, rig.unit, rng, duration, gain, rig.scale)
    else:
        # With unequal areas a speed to and fro does not come back.
        returns = cylinder.area_2 > EQUAL * cylinder.area_1
        ranges = recipe.ranges.get(duty_name, {})
        duty, control = fitting_duty(
            duty_name, rig.unit, rng, ranges, speed=by_speed and returns, gain=gain, scale=rig.scale
        )
    load = _load(load_name, recipe, rig, rng, duty, control, duration)
    specs = [_fault(name, recipe, rig, duration, rng) for name in faults]
    if recipe.stuck_valve == "loaded":
        specs = [_on_loaded_side(spec, load, duty.offset, rig.unit) for spec in specs]
    stated = recipe.population == "stated"
    usually = population.central if stated else uniform
    temperature = usually(rng, recipe.oil_temperature)
    warming, charge = uniform(rng, recipe.warming), usually(rng, recipe.charge_factor)
    if stated:
        charge = population.charge_factor(rig.unit, charge * population.CHARGE.factor(rng), temperature)
    seed = int(rng.integers(0, 2**62))
    # Last: what is drawn above does not depend on how many scales there are.
    scales = rig.scale.fault_scales(drawn(rng, recipe.fault_scales))
    specs = [_by_law(spec, recipe, rng) for spec in specs]  # so that logs differ by their laws alone
    return Scenario(
        unit=rig.unit.name, duration=duration, duty=duty, control=control, load=load, faults=specs,
        recording=rig.recording, details=rig.details, fault_scales=FaultScales(**scales),
        oil_temperature=temperature, warming=warming, charge_factor=charge, seed=seed,
    )  # fmt: skip


def as_it_runs(
    recipe: Recipe, rig: Rig, unit: Unit, scenario: Scenario, purpose: tuple[str, int, int]
) -> tuple[Unit, Scenario]:
    """Unit and scenario with what differs from run to run beside the scenario's draw, of a stated population.

    `purpose` : kind of run, indices of unit and run.
    """
    if recipe.population == "uniform":
        return unit, scenario
    rng = stream(recipe, f"{purpose[0]} as it runs", *purpose[1:])
    zeros = population.warm_zeros(unit, rig.scale.zero_errors(recipe.sensors.zero_error), rng)
    wander = round(uniform(rng, population.WANDER), 4)
    return zeros, scenario.model_copy(update={"friction_wander": wander})


def _fault(name: str, recipe: Recipe, rig: Rig, duration: float, rng: Rng) -> FaultSpec:
    entry = CATALOGUE[name]
    variants = recipe.faults[name].variants or entry.variants
    if not rig.recording.has("pressure_difference"):
        # Chamber 1's transducer is struck instead, and has no current loop.
        variants = tuple(v for v in variants if v != "broken_loop")
    onset = uniform(rng, recipe.onset) * duration
    if rng.random() < recipe.at_start_share:
        onset = 0.0
    profiles = recipe.profiles
    if entry.in_measurement:  # a sensor knows neither load nor heat
        profiles = {n: w for n, w in profiles.items() if n not in STATE_BORNE}
    # A drift grows by itself: ramped or interrupted it would be another fault.
    steps = name == "pressure_sensor_drift" or not sum(profiles.values()) > 0.0
    profile: Any = "step" if steps else chosen(rng, profiles)
    severities = recipe.faults[name].severity or recipe.severity
    return FaultSpec(
        fault=name, severity=round(uniform(rng, severities), 3), onset=round(onset, 3), profile=profile,
        ramp=round(uniform(rng, (0.15, 0.5)) * (duration - onset), 3),
        period=round(uniform(rng, (4.0, 10.0)), 3), duty=round(uniform(rng, (0.4, 0.7)), 3),
        side=int(rng.choice(entry.sides)) if entry.sides else None,
        variant=str(rng.choice(variants)) if variants else None,
    )  # fmt: skip


def _by_law(spec: FaultSpec, recipe: Recipe, rng: Rng) -> FaultSpec:
    """The fault by one of the recipe's laws, at random times of its own if it comes at random."""
    laws, changed = recipe.laws_of(spec.fault), dict[str, Any]()
    if laws:
        changed["law"] = laws[0] if len(laws) == 1 else str(rng.choice(laws))
    if spec.profile == "random":
        changed["seed"] = int(rng.integers(0, 2**31))
    return FaultSpec(**{**spec.model_dump(), **changed}) if changed else spec


def _on_loaded_side(spec: FaultSpec, load: Load, offset: float, unit: Unit) -> FaultSpec:
    """A stuck check valve moved to the chamber that the load's mean force presses on, if it does."""
    if spec.fault != "check_valve_stuck_open":
        return spec
    rate, slack, level = (getattr(load, name, 0.0) for name in ("rate", "slack", "level"))
    spring = max(rate * (offset - slack), 0.0) if isinstance(load, PressLoad) else rate * (offset - slack)
    force = (level if isinstance(level, float) else 0.0) + spring
    if abs(force) < ONE_SIDED_PRESSURE * unit.cylinder.area_1:
        return spec
    return spec.model_copy(update={"side": 1 if force > 0.0 else 2})


def _load(
    name: str, recipe: Recipe, rig: Rig, rng: Rng, duty: Duty, control: Control, duration: float
) -> Load:
    """A load of that kind which the unit can carry wherever that duty takes it."""
    kind, unit = LOADS[name], rig.unit
    departs = duty.amplitude if control.mode == "position" else 0.4 * unit.cylinder.stroke
    reach = abs(duty.offset) + departs
    ranges = {**kind.usual, **recipe.ranges.get(name, {})}
    values = drawn(rng, rig.scale.load_ranges(name, ranges))
    most = GREATEST_FORCE * unit.accumulator.relief_pressure * min(unit.cylinder.area_1, unit.cylinder.area_2)
    if name == "changing":
        return changing(values, rng, duration, duty, most)
    if name == "throttle":
        # Its drop goes with the square of speed: bounded where the pump turns at 200 rad/s.
        values["pressure"] = min(values["pressure"], GREATEST_FORCE * unit.accumulator.relief_pressure)
    elif name == "constant":
        values["level"] = float(np.clip(values["level"], -most, most))
    elif name in ("spring", "hinge"):
        values["rate"] = min(values["rate"], most / (reach + abs(values["slack"])))
    elif name == "press":
        # Touched in the upper half of the motion at the latest, or it were no load. A commanded speed moves
        # the rod to both sides, nobody knows how far.
        bounded = control.mode == "position" or isinstance(duty, ConstantSpeed)
        values["slack"] = min(values["slack"], duty.offset + (0.5 * duty.amplitude if bounded else 0.0))
        values["rate"] = min(values["rate"], most / max(duty.offset + departs - values["slack"], 1e-3))
    elif name == "gust":
        values["level"] = float(np.clip(values["level"], -0.3 * most, 0.3 * most))
        values["deviation"] = min(values["deviation"], 0.25 * (most - abs(values["level"])))
        values["rate"] = min(values["rate"], 0.3 * most / reach)
    return kind(**values)


def fitting_duty(
    name: str, unit: Unit, rng: Rng, ranges: Mapping[str, tuple[float, float]], *, speed: bool, gain: float,
    scale: Scale = NEUTRAL,
) -> tuple[Duty, Control]:  # fmt: skip
    """Draw a duty of that kind which the unit's stroke, areas, displacement and drive allow, and its control.

    `ranges` are those of parameters whose usual ones are not wanted, `scale` that of a machine of another
    size than they are made for. Speed control comes where it is wanted and the duty leaves the choice; `gain`
    is the position loop's, (rad/s)/m.
    """
    kind = DUTIES[name]
    drawn: dict[str, Any] = {}
    for key, (low, high) in scale.duty_ranges({**kind.usual, **ranges}).items():
        # Rigs use their stroke and speed: only times and frequencies spread over decades.
        drawn[key] = (uniform if key in ("amplitude", "speed") else spread)(rng, (low, high))
    drawn["lead_in"] = float(rng.uniform(0.3, 2.0))
    room = USED_STROKE * 0.5 * unit.cylinder.stroke
    per_rad = unit.pump.displacement / unit.cylinder.area_1
    fastest = USED_SPEED * unit.drive.max_speed * per_rad
    if name == "constant_speed":
        speeds = np.exp(rng.uniform(np.log(30.0), np.log(240.0), 3))
        drawn["speeds"] = tuple(min(float(s), USED_SPEED * unit.drive.max_speed) for s in speeds)
        drawn["turn"] = float(rng.uniform(5.0, 15.0))
    if name == "sines":
        drawn["count"] = int(rng.integers(2, 7))
        drawn["tilt"] = float(rng.uniform(0.8, 2.0))
    by_speed = name == "constant_speed" or (speed and name not in POSITION_ONLY)
    if "amplitude" in drawn:
        most = room if by_speed else min(room, _reachable(name, drawn, fastest, gain, unit.drive.max_speed))
        drawn["amplitude"] = min(drawn["amplitude"], most)
    if by_speed and "speed" in drawn:
        # Half the room: a sine of speed starts at its end, and steps walk.
        seconds = ONE_WAY_S[name](drawn) if name in ONE_WAY_S else drawn.get("hold", 1.0)
        drawn["speed"] = min(drawn["speed"], 0.5 * room / (per_rad * seconds))
    spare = room - drawn.get("amplitude", 0.0) if not by_speed or name == "constant_speed" else 0.3 * room
    drawn["offset"] = float(rng.uniform(-1.0, 1.0)) * min(spare, 0.06)
    control = Control(mode="speed") if by_speed else Control(mode="position", gain=gain)
    return kind(**drawn), control


def _reachable(name: str, drawn: Mapping[str, Any], fastest: float, gain: float, max_speed: float) -> float:
    """Largest amplitude (m) at which the drive is not saturated most of the time."""
    if name == "sines":
        f = np.geomspace(drawn["low_hz"], max(drawn["high_hz"], drawn["low_hz"]), drawn["count"])
        w = f ** -drawn["tilt"]
        return float(fastest / (2.0 * np.pi * np.sum(w * f) / np.sum(w)))
    if name == "sawtooth":
        return 0.5 * fastest * drawn["period"] * min(drawn["rise"], 1.0 - drawn["rise"])
    if name in ("prbs", "sweep"):
        # The loop cannot follow; its command is about gain times the set-point.
        return 0.8 * max_speed / gain
    return float("inf")


def drawn_mission(
    recipe: Recipe, unit: Unit, rng: Rng, duration: float, gain: float, scale: Scale
) -> tuple[Mission, Control]:
    """A mission of the recipe's other duties, by position."""
    weights = {n: w for n, w in recipe.duties.items() if n not in ("mission", "constant_speed")}
    weights = weights or {"steps": 1.0, "flight": 1.0, "resting": 1.0}
    stages: list[Duty] = []
    for _ in range(_count(rng, duration)):
        name = chosen(rng, weights)
        ranges = recipe.ranges.get(name, {})
        stages.append(fitting_duty(name, unit, rng, ranges, speed=False, gain=gain, scale=scale)[0])
    amplitude = max(abs(s.offset) + s.amplitude for s in stages)
    seconds = tuple(round(float(s), 3) for s in _lengths(rng, len(stages), duration))
    made: dict[str, Any] = {"stages": [s.model_dump() for s in stages], "seconds": seconds}
    return Mission(**made, amplitude=amplitude), Control(mode="position", gain=gain)


def changing(values: dict[str, float], rng: Rng, duration: float, duty: Duty, most: float) -> ChangingLoad:
    """A load of that size which changes where the duty does, or at times of its own.

    `values` : of `ChangingLoad.usual`, drawn. `most` : N that the unit can carry.
    """
    lengths = duty.seconds if isinstance(duty, Mission) else _lengths(rng, _count(rng, duration), duration)
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    levels = np.clip(values["level"] * rng.uniform(-1.0, 1.0, starts.size), -0.3 * most, 0.3 * most)
    gusty = rng.random(starts.size) < 0.4
    deviations = np.where(gusty, min(values["deviation"], 0.15 * most), 0.0)
    level, deviation = _held(starts, levels), _held(starts, deviations)
    return ChangingLoad(level=level, deviation=deviation, bandwidth_hz=values["bandwidth_hz"])


def _count(rng: Rng, duration: float) -> int:
    wanted = int(rng.integers(STAGES[0], STAGES[1] + 1))
    return max(min(wanted, int(duration // SHORTEST_S)), 1)


def _lengths(rng: Rng, count: int, duration: float) -> np.ndarray:
    """s of stages that fill a log, none much shorter than another."""
    shares = rng.uniform(0.5, 1.5, count)
    return np.asarray(duration * shares / shares.sum())


def _held(starts: np.ndarray, values: np.ndarray) -> Programme:
    """A value that is held, and moves to the next one within a second."""
    times = [t for start in starts[1:].tolist() for t in (start - 0.5, start + 0.5)]
    held = np.repeat(values, 2)[1:-1] if values.size > 1 else np.array([])
    points = [(0.0, float(values[0])), *zip(times, held.tolist(), strict=True)]
    return Programme(points=tuple((round(t, 3), round(v, 3)) for t, v in points))
