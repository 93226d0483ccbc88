"""Drawing units, faults and scenarios from a recipe.

Everything is a pure function of the recipe and of indices: each unit, log and attempt has a random
stream of its own, so that neither the number of workers nor the order of work changes anything.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from fdd.campaign import population
from fdd.campaign.motion import changing, drawn_mission, fitting_duty
from fdd.campaign.population import BETWEEN_UNITS, Spread
from fdd.campaign.ranges import Rng, apportioned, chosen, drawn, log_uniform, uniform
from fdd.campaign.recipe import Recipe
from fdd.campaign.sizes import NEUTRAL, Scale
from fdd.campaign.structures import EQUAL, Condition, Departure, Structure
from fdd.faults import CATALOGUE
from fdd.plant.details import Details
from fdd.plant.duty import ConstantSpeed, Duty
from fdd.plant.faults import STATE_BORNE, FaultScales, FaultSpec
from fdd.plant.rig import LOADS, Load
from fdd.plant.scenario import Control, Scenario
from fdd.plant.sensors.recording import Recording
from fdd.unit import Cylinder, Section, Unit

S = TypeVar("S", bound=Section)

COUNTED = ("pump_angle", "pump_speed", "position", "command")
"""Channels of incremental encoders and set-points: their gain is exact."""

GREATEST_FORCE = 0.65
"""Of relief pressure times area: most that a drawn load asks for, so that no valve relieves for long."""

LEAST_ROOM = 1.2
"""Volume of a drawn machine's chamber at mid-stroke, at least, over what half a stroke displaces."""

ONE_SIDED_PRESSURE = 0.15e6
"""Pa, mean pressure by a load from which on friction no longer brings both chambers to pressure in turn."""


@dataclass(frozen=True)
class Rig:
    """A drawn unit, by its true profile, with what no profile knows of it.

    Attributes
    ----------
    base, sheet : name of the profile that it was varied from, and that profile: all that anybody who
        identifies the unit may know.
    structure : None without structures in the recipe.
    scale : of a machine drawn as a whole, against those that the recipe's ranges are made for.
    """

    unit: Unit
    details: Details
    base: str
    sheet: Unit
    recording: Recording
    structure: Structure | None
    scale: Scale


def stream(recipe: Recipe, purpose: str, *indices: int) -> Rng:
    """The random stream of one purpose, unit, log and attempt."""
    return np.random.default_rng(
        np.random.SeedSequence([recipe.seed, zlib.crc32(purpose.encode()), *indices])
    )


def draw_unit(recipe: Recipe, rng: Rng, index: int) -> Rig:
    """Draw unit `index`: its base's parameters, each varied on its own, and its plant's details."""
    base = recipe.bases[index % len(recipe.bases)]
    structure, scale, recording = structure_of(recipe, index), NEUTRAL, recipe.recording
    if structure is None:
        unit = Unit.load(base)
    else:
        unit = structure.data_sheet(base, stream(recipe, "structure", index), recipe.oil_temperatures)
        base = structure.base or (base if structure.size is None else structure.name)
        scale = scale if structure.size is None else Scale(unit)
        recording = structure.recording(recording)
    sheet, stated = unit, recipe.population == "stated"

    def varied(section: S, spreads: Mapping[str, Spread], level: float = 1.0) -> S:
        """The section with these numbers drawn anew; dry friction goes by a level that all of it shares."""
        changed = {}
        for name, spread in spreads.items():
            factor = (spread if stated else spread.alike(recipe.variation)).factor(rng)
            shared = level if name in ("coulomb", "static") else 1.0
            changed[name] = float(getattr(section, name) * (factor * shared))
        provenance = {n: p for n, p in section.provenance.items() if n not in changed}
        return section.model_copy(update={**changed, "provenance": provenance})

    cylinder = varied(unit.cylinder, BETWEEN_UNITS["cylinder"])
    ratio = unit.cylinder.area_2 / unit.cylinder.area_1
    areas = population.AREA_RATIO if stated else population.AREA_RATIO.alike(recipe.area_mismatch)
    cylinder = cylinder.model_copy(update={"area_2": float(cylinder.area_1 * ratio * areas.factor(rng))})
    branches = {}
    level = population.FRICTION_LEVEL.factor(rng) if stated else 1.0
    for name in ("forward", "reverse"):
        branch = varied(getattr(unit.friction, name), population.FRICTION, level)
        branches[name] = branch.model_copy(update={"static": max(branch.static, branch.coulomb)})
    parts: dict[str, Any] = {
        "cylinder": cylinder if scale.unit is None else _with_room(cylinder),
        "friction": unit.friction.model_copy(update=branches),
        "sensors": _sensors(recipe, unit, rng, scale),
    }
    for name in ("pump", "oil", "accumulator", "drive"):
        parts[name] = varied(getattr(unit, name), BETWEEN_UNITS[name])
    if stated:
        parts["oil"] = population.with_its_air(parts["oil"], unit.oil)
    details = drawn(rng, Details.usual)
    details["pump_teeth"] = round(details["pump_teeth"])
    if unit.accumulator.oil_volume is not None:  # after all that every profile has
        parts["accumulator"] = varied(parts["accumulator"], population.OIL_VOLUME)
    by = "as stated in fdd.campaign.population" if stated else f"by ±{recipe.variation:.0%}"
    parts |= {"description": f"{base} varied {by}, drawn for {recipe.name}.", "baseline": None}
    made = unit.model_copy(update={**parts, "name": f"unit_{index:03d}"})
    details = scale.details(details)
    if structure is not None:
        details = structure.drawn_details(details, stream(recipe, "details", index))
    return Rig(Unit.from_yaml(made.to_yaml()), Details(**details), base, sheet, recording, structure, scale)


D = TypeVar("D", bound=Departure)


def _drawn_kind(recipe: Recipe, kinds: Sequence[D], purpose: str, number: int, place: int) -> D | None:
    """The one of `kinds` at a place of `number`: numbers follow the weights, their order is random."""
    if not kinds:
        return None
    total = sum(each.weight for each in kinds)
    shares = {each.name: each.weight / total for each in kinds}
    order = stream(recipe, purpose).permutation(apportioned(shares, number))
    return next(each for each in kinds if each.name == str(order[place]))


def structure_of(recipe: Recipe, index: int) -> Structure | None:
    """The structure of unit `index`."""
    return _drawn_kind(recipe, recipe.structures, "structures", recipe.units, index)


def condition_of(recipe: Recipe, index: int, log: int) -> Condition | None:
    """The condition of a unit's log."""
    place = index * recipe.logs_per_unit + log
    return _drawn_kind(recipe, recipe.conditions, "conditions", recipe.number, place)


def assign_faults(recipe: Recipe) -> list[tuple[str, ...]]:
    """Which faults each log carries, (recipe.number,); () for a healthy one.

    Numbers follow the shares exactly (largest remainders), their order is random.
    """
    weights = {n: f.weight for n, f in recipe.faults.items() if f.weight > 0.0}
    total = sum(weights.values())
    shares = {"": recipe.healthy_share}
    if recipe.healthy_share < 1.0:
        shares |= {n: (1.0 - recipe.healthy_share) * w / total for n, w in weights.items()}
    rng = stream(recipe, "assignment")
    order = rng.permutation(apportioned(shares, recipe.number))
    seconds = rng.random(recipe.number) < recipe.second_fault_share
    assigned: list[tuple[str, ...]] = []
    for first, second in zip(order.tolist(), seconds.tolist(), strict=True):
        faults: tuple[str, ...] = (first,) if first else ()
        if first and second:
            faults += (chosen(rng, {n: w for n, w in weights.items() if n != first}),)
        assigned.append(faults)
    return assigned


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
    left = duration - onset
    return FaultSpec(
        fault=name,
        severity=round(uniform(rng, recipe.faults[name].severity or recipe.severity), 3),
        onset=round(onset, 3),
        profile=profile,
        ramp=round(uniform(rng, (0.15, 0.5)) * left, 3),
        period=round(uniform(rng, (4.0, 10.0)), 3),
        duty=round(uniform(rng, (0.4, 0.7)), 3),
        side=int(rng.choice(entry.sides)) if entry.sides else None,
        variant=str(rng.choice(variants)) if variants else None,
    )


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
    spring = load.stiffness * (offset - load.centre)
    level = getattr(load, "level", 0.0)
    force = (level if isinstance(level, float) else 0.0) + (max(spring, 0.0) if load.one_sided else spring)
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


def _sensors(recipe: Recipe, unit: Unit, rng: Rng, scale: Scale) -> dict[str, Any]:
    errors, zeros = recipe.sensors, scale.zero_errors(recipe.sensors.zero_error)
    varied = {}
    for channel, sensor in unit.sensors.items():
        factor = log_uniform(rng, errors.noise_factor)
        gain = 1.0 + errors.gain_error * rng.uniform(-1.0, 1.0)
        zero = zeros.get(channel, 0.0) * rng.uniform(-1.0, 1.0)
        # An encoder's reading is rounded, not noisy: a position sensor with noise is an analogue one.
        counted = channel in COUNTED and not (channel == "position" and sensor.noise > 0.0)
        gain = sensor.gain if counted else sensor.gain * gain
        errs = {"noise": sensor.noise * factor, "gain": gain, "zero": sensor.zero + zero}
        varied[channel] = sensor.model_copy(update=errs)
    return varied


def _with_room(cylinder: Cylinder) -> Cylinder:
    """The cylinder with some oil left in either chamber at the stroke's end."""
    half = 0.5 * cylinder.stroke * LEAST_ROOM
    areas = {"volume_1": cylinder.area_1, "volume_2": cylinder.area_2}
    least = {name: max(getattr(cylinder, name), half * area) for name, area in areas.items()}
    return cylinder.model_copy(update=least)
