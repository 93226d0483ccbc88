"""Drawing units, faults and scenarios from a recipe.

Everything is a pure function of the recipe and of indices: each unit, log and attempt has a random
stream of its own, so that neither the number of workers nor the order of work changes anything.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fdd.campaign.motion import fitting_duty
from fdd.campaign.recipe import Range, Recipe
from fdd.faults import CATALOGUE
from fdd.plant.details import Details
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.load import LOADS, Load
from fdd.plant.scenario import Scenario
from fdd.unit import Section, Unit

Rng = np.random.Generator
S = TypeVar("S", bound=Section)

# Numbers of a profile that describe the rig; what is left out is a definition (reference pressure and
# temperature), a rating (maximum speed, ranges) or hardly varies (polytropic index, density).
VARIED: dict[str, tuple[str, ...]] = {
    "cylinder": ("area_1", "stroke", "moving_mass", "volume_1", "volume_2"),
    "pump": ("displacement", "cross_port_leakage", "case_leakage"),
    "oil": ("bulk_modulus", "air_fraction", "viscosity_40", "viscosity_100"),
    "accumulator": (
        "charge_pressure", "gas_volume", "refeed_cracking_pressure", "refeed_flow_gain",
        "case_cracking_pressure", "relief_pressure", "relief_flow_gain",
    ),
    "drive": (
        "delay", "pole_1", "pole_2", "zero", "torque_constant", "winding_resistance", "inertia",
        "viscous_friction", "current_limit",
    ),
}  # fmt: skip
VARIED_FRICTION = ("coulomb", "static", "stribeck_velocity", "stribeck_exponent", "viscous")

COUNTED = ("pump_angle", "pump_speed", "position", "command")
"""Channels of incremental encoders and set-points: their gain is exact."""

GREATEST_FORCE = 0.65
"""Of relief pressure times area: most that a drawn load asks for, so that no valve relieves for long."""

ONE_SIDED_PRESSURE = 0.15e6
"""Pa, mean pressure by a load from which on friction no longer brings both chambers to pressure in turn."""


@dataclass(frozen=True)
class Rig:
    """A drawn unit with what no profile knows of it.

    Attributes
    ----------
    unit : its true profile.
    details : of its plant.
    base : profile that it was varied from.
    """

    unit: Unit
    details: Details
    base: str


def stream(recipe: Recipe, purpose: str, *indices: int) -> Rng:
    """The random stream of one purpose, unit, log and attempt."""
    return np.random.default_rng(
        np.random.SeedSequence([recipe.seed, zlib.crc32(purpose.encode()), *indices])
    )


def draw_unit(recipe: Recipe, rng: Rng, index: int) -> Rig:
    """Draw unit `index`: its base's parameters, each varied on its own, and its plant's details.

    Parameters
    ----------
    recipe : bases, variation and the sensors' errors.
    rng : the unit's stream.
    index : chooses the base, in turn, and the name.

    Raises
    ------
    InputError : a base that is no profile.

    Examples
    --------
    >>> recipe = Recipe(schema="fdd.recipe/1", healthy_share=1.0)
    >>> draw_unit(recipe, stream(recipe, "unit", 3), 3).unit.name
    'unit_003'
    """
    base = recipe.bases[index % len(recipe.bases)]
    unit = Unit.load(base).model_copy(deep=True)

    def varied(section: S, names: tuple[str, ...], **more: float) -> S:
        factors = 1.0 + recipe.variation * rng.uniform(-1.0, 1.0, len(names))
        changed = {n: float(getattr(section, n) * f) for n, f in zip(names, factors, strict=True)}
        provenance = {n: p for n, p in section.provenance.items() if n not in changed}
        return section.model_copy(update={**changed, **more, "provenance": provenance})

    cylinder = varied(unit.cylinder, VARIED["cylinder"])
    ratio = unit.cylinder.area_2 / unit.cylinder.area_1
    mismatch = 1.0 + recipe.area_mismatch * rng.uniform(-1.0, 1.0)
    area_2 = float(cylinder.area_1 * ratio * mismatch)
    branches = {}
    for name in ("forward", "reverse"):
        branch = varied(getattr(unit.friction, name), VARIED_FRICTION)
        branches[name] = branch.model_copy(update={"static": max(branch.static, branch.coulomb)})
    parts: dict[str, Any] = {
        "cylinder": cylinder.model_copy(update={"area_2": area_2}),
        "friction": unit.friction.model_copy(update=branches),
        "sensors": _sensors(recipe, unit, rng),
    }
    for name in ("pump", "oil", "accumulator", "drive"):
        parts[name] = varied(getattr(unit, name), VARIED[name])
    description = f"{base} varied by ±{recipe.variation:.0%}, drawn for {recipe.name}."
    drawn = unit.model_copy(
        update={**parts, "name": f"unit_{index:03d}", "description": description, "baseline": None}
    )
    details = _drawn(rng, Details.usual)
    details["pump_teeth"] = round(details["pump_teeth"])
    return Rig(Unit.from_yaml(drawn.to_yaml()), Details(**details), base)


def assign_faults(recipe: Recipe) -> list[tuple[str, ...]]:
    """Which faults each log carries, (recipe.number,); () for a healthy one.

    Numbers follow the shares exactly (largest remainders), their order is random.

    Examples
    --------
    >>> recipe = Recipe(schema="fdd.recipe/1", units=2, healthy_share=0.5, faults={"aeration": {}})
    >>> sorted(assign_faults(recipe))[4:6]
    [(), ('aeration',)]
    """
    weights = {n: f.weight for n, f in recipe.faults.items() if f.weight > 0.0}
    total = sum(weights.values())
    shares = {"": recipe.healthy_share}
    if recipe.healthy_share < 1.0:
        shares |= {n: (1.0 - recipe.healthy_share) * w / total for n, w in weights.items()}
    rng = stream(recipe, "assignment")
    order = rng.permutation(_apportioned(shares, recipe.number))
    seconds = rng.random(recipe.number) < recipe.second_fault_share
    assigned: list[tuple[str, ...]] = []
    for first, second in zip(order.tolist(), seconds.tolist(), strict=True):
        if first and second:
            others = {n: w for n, w in weights.items() if n != first}
            assigned.append((first, _chosen(rng, others)))
        else:
            assigned.append((first,) if first else ())
    return assigned


def draw_scenario(recipe: Recipe, rig: Rig, rng: Rng, faults: tuple[str, ...] = ()) -> Scenario:
    """Draw one log's scenario: load, duty, conditions and the given faults.

    Parameters
    ----------
    recipe : weights and ranges.
    rig : bounds amplitude by its stroke, speed by its drive and force by its relief valve.
    rng : the log's stream.
    faults : ids, from `assign_faults`.

    Examples
    --------
    >>> recipe = Recipe(schema="fdd.recipe/1", healthy_share=1.0)
    >>> rig = draw_unit(recipe, stream(recipe, "unit", 0), 0)
    >>> draw_scenario(recipe, rig, stream(recipe, "log", 0, 0, 0)).faults
    []
    """
    duration = round(float(rng.uniform(*recipe.duration)), 3)
    load_name = _chosen(rng, recipe.loads)
    duty_name = _chosen(rng, recipe.duties)
    gain = _log_uniform(rng, recipe.position_gain)
    # A throttled partner is a rig for measuring: it is mostly driven by speed.
    share = max(recipe.speed_control_share, 0.7) if load_name == "throttle" else recipe.speed_control_share
    duty, control = fitting_duty(
        duty_name,
        rig.unit,
        rng,
        recipe.ranges.get(duty_name, {}),
        speed=bool(rng.random() < share),
        gain=gain,
    )
    departs = duty.amplitude if control.mode == "position" else 0.4 * rig.unit.cylinder.stroke
    reach = abs(duty.offset) + departs
    load = _load(load_name, recipe, rig.unit, rng, reach)
    specs = [_fault(name, recipe, duration, rng) for name in faults]
    if recipe.stuck_valve == "loaded":
        specs = [_on_loaded_side(spec, load, duty.offset, rig.unit) for spec in specs]
    return Scenario(
        unit=rig.unit.name,
        duration=duration,
        duty=duty,
        control=control,
        load=load,
        oil_temperature=_uniform(rng, recipe.oil_temperature),
        warming=_uniform(rng, recipe.warming),
        charge_factor=_uniform(rng, recipe.charge_factor),
        faults=specs,
        recording=recipe.recording,
        details=rig.details,
        seed=int(rng.integers(0, 2**62)),
        # Last: what is drawn above does not depend on how many scales there are.
        fault_scales=FaultScales(**_drawn(rng, recipe.fault_scales)),
    )


def _fault(name: str, recipe: Recipe, duration: float, rng: Rng) -> FaultSpec:
    entry = CATALOGUE[name]
    variants = recipe.faults[name].variants or entry.variants
    onset = _uniform(rng, recipe.onset) * duration
    if rng.random() < recipe.at_start_share:
        onset = 0.0
    # A drift grows by itself: ramped or interrupted it would be another fault.
    profile = "step" if name == "pressure_sensor_drift" else _chosen(rng, recipe.profiles)
    left = duration - onset
    return FaultSpec(
        fault=name,
        severity=round(_uniform(rng, recipe.faults[name].severity or recipe.severity), 3),
        onset=round(onset, 3),
        profile=profile,
        ramp=round(_uniform(rng, (0.15, 0.5)) * left, 3),
        period=round(_uniform(rng, (4.0, 10.0)), 3),
        duty=round(_uniform(rng, (0.4, 0.7)), 3),
        side=int(rng.choice(entry.sides)) if entry.sides else None,
        variant=str(rng.choice(variants)) if variants else None,
    )


def _on_loaded_side(spec: FaultSpec, load: Load, offset: float, unit: Unit) -> FaultSpec:
    """A stuck check valve moved to the chamber that the load's mean force presses on, if it does."""
    if spec.fault != "check_valve_stuck_open":
        return spec
    force = getattr(load, "level", 0.0) + load.stiffness * (offset - load.centre)
    if abs(force) < ONE_SIDED_PRESSURE * unit.cylinder.area_1:
        return spec
    return spec.model_copy(update={"side": 1 if force > 0.0 else 2})


def _load(name: str, recipe: Recipe, unit: Unit, rng: Rng, reach: float) -> Load:
    """A load of that kind which the unit can carry over a reach of ± `reach` metres."""
    kind = LOADS[name]
    drawn = _drawn(rng, {**kind.usual, **recipe.ranges.get(name, {})})
    most = GREATEST_FORCE * unit.accumulator.relief_pressure * min(unit.cylinder.area_1, unit.cylinder.area_2)
    if name == "throttle":
        # Its drop goes with the square of speed: bounded where the pump turns at 200 rad/s.
        drawn["pressure"] = min(drawn["pressure"], GREATEST_FORCE * unit.accumulator.relief_pressure)
    elif name == "constant":
        drawn["level"] = float(np.clip(drawn["level"], -most, most))
    elif name == "spring":
        drawn["rate"] = min(drawn["rate"], most / (reach + abs(drawn["slack"])))
    elif name == "gust":
        drawn["level"] = float(np.clip(drawn["level"], -0.3 * most, 0.3 * most))
        drawn["deviation"] = min(drawn["deviation"], 0.25 * (most - abs(drawn["level"])))
        drawn["rate"] = min(drawn["rate"], 0.3 * most / reach)
    return kind(**drawn)


def _sensors(recipe: Recipe, unit: Unit, rng: Rng) -> dict[str, Any]:
    errors = recipe.sensors
    drawn = {}
    for channel, sensor in unit.sensors.items():
        factor = _log_uniform(rng, errors.noise_factor)
        gain = 1.0 + errors.gain_error * rng.uniform(-1.0, 1.0)
        zero = errors.zero_error.get(channel, 0.0) * rng.uniform(-1.0, 1.0)
        drawn[channel] = sensor.model_copy(
            update={
                "noise": sensor.noise * factor,
                "gain": sensor.gain if channel in COUNTED else sensor.gain * gain,
                "zero": sensor.zero + zero,
            }
        )
    return drawn


def _apportioned(shares: Mapping[str, float], number: int) -> NDArray[np.str_]:
    """`number` names in their shares: whole parts first, then the largest remainders."""
    names, wanted = list(shares), np.array(list(shares.values())) * number
    counts = np.floor(wanted + 1e-9).astype(int)
    left = number - int(counts.sum())
    for k in np.argsort(-(wanted - counts), kind="stable")[:left]:
        counts[k] += 1
    return np.repeat(names, counts)


def _chosen(rng: Rng, weights: Mapping[str, float]) -> str:
    names, values = list(weights), np.array(list(weights.values()))
    return names[int(rng.choice(len(names), p=values / values.sum()))]


def _uniform(rng: Rng, bounds: Range) -> float:
    return float(rng.uniform(*bounds))


def _log_uniform(rng: Rng, bounds: Range) -> float:
    return float(np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]))))


def _drawn(rng: Rng, ranges: Mapping[str, Range]) -> dict[str, Any]:
    """One value for each; log-uniform where a positive range spans a factor of four or more."""
    return {
        name: _log_uniform(rng, bounds) if 0.0 < 4.0 * bounds[0] <= bounds[1] else _uniform(rng, bounds)
        for name, bounds in ranges.items()
    }
