"""Drawing units from a recipe, who has which fault, and the healthy calibration runs of each unit.

Everything is a pure function of the recipe and of indices: each unit, log and attempt has a random
stream of its own, so that neither the number of workers nor the order of work changes anything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from fdd.campaign import population
from fdd.campaign.population import BETWEEN_UNITS, Rng, Spread, apportioned, chosen, drawn, log_uniform
from fdd.campaign.recipe import Recipe
from fdd.campaign.sizes import NEUTRAL, Scale
from fdd.campaign.structures import Condition, Departure, Structure
from fdd.plant.details import Details
from fdd.plant.duty import AnyDuty, ConstantSpeed, Sines
from fdd.plant.rig import AnyLoad, NoLoad, ThrottleLoad
from fdd.plant.scenario import Control, Scenario
from fdd.plant.sensors.recording import Recording, generator
from fdd.unit import Cylinder, Section, Unit

S = TypeVar("S", bound=Section)

SPEEDS = (50.0, 105.0, 200.0)
"""rad/s, of the free strokes."""
MULTI_SINE_HZ = (0.3, 25.0)
ORDINARY_SPEEDS = (0.12, 0.25, 0.5, 0.75)
"""Of the drive's largest, of ordinary strokes."""
THROTTLED_SPEEDS = (60.0, 85.0, 110.0)
"""rad/s, of the throttled strokes; the largest pressure comes with the last."""
THROTTLED_PRESSURE = (2.1e6, 2.8e6)
"""Pa, that largest pressure's range."""
COUNTED = ("pump_angle", "pump_speed", "position", "command")
"""Channels of incremental encoders and set-points: their gain is exact."""
LEAST_ROOM = 1.2
"""Volume of a drawn machine's chamber at mid-stroke, at least, over what half a stroke displaces."""


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
    return generator(recipe.seed, purpose, *indices)


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


def calibration_runs(recipe: Recipe, rig: Rig, rng: np.random.Generator) -> list[Scenario]:
    """The runs of one calibration: free strokes, multi-sine, throttled strokes; about 75 s together.

    One after the other, on the same oil, within the rig's stroke, drive and relief valve. A run keeps its
    duty and load, hence three.
    """
    unit = rig.unit
    reach = 0.65 * 0.5 * unit.cylinder.stroke
    per_rad = unit.pump.displacement / unit.cylinder.area_1
    speeds = tuple(min(s, 0.8 * unit.drive.max_speed) for s in SPEEDS)
    # Two strokes each way at every speed, the slowest not more than once around.
    turn = max(8.0, 2.2 * reach / (speeds[0] * per_rad))
    pressure = rig.scale.pressure * float(rng.uniform(*THROTTLED_PRESSURE))
    drop = _throttle_for(unit, min(pressure, 0.85 * unit.accumulator.relief_pressure))
    temperature = float(rng.uniform(30.0, 42.0))
    charge = float(rng.uniform(0.9, 1.1))
    free = ConstantSpeed(amplitude=reach, speeds=speeds, turn=turn, dwell=0.4, lead_in=1.0)
    low, high = MULTI_SINE_HZ
    sines = Sines(speed=0.9 * unit.drive.max_speed, low_hz=low, high_hz=high, count=10, tilt=0.5)
    slow = ConstantSpeed(amplitude=0.8 * reach, speeds=THROTTLED_SPEEDS, turn=10.0, dwell=0.4, lead_in=1.0)
    plans: list[tuple[float, AnyDuty, AnyLoad]] = [
        (3.0 * turn + 1.0, free, NoLoad()),
        (15.0, sines, NoLoad()),
        (31.0, slow, ThrottleLoad(pressure=drop)),
    ]
    runs = []
    for duration, duty, load in plans:
        runs.append(_run(rig, rng, duration, duty, load, temperature, 0.02, charge))
        temperature += 0.02 * duration
    return runs


def ordinary_strokes(rig: Rig, rng: np.random.Generator) -> Scenario:
    """Strokes at several speeds under no load, as anybody can make them: at most 81 s."""
    unit = rig.unit
    reach = 0.65 * 0.5 * unit.cylinder.stroke
    per_rad = unit.pump.displacement / unit.cylinder.area_1
    speeds = tuple(share * unit.drive.max_speed for share in ORDINARY_SPEEDS)
    turn = max(float(np.clip(4.4 * reach / (s * per_rad), 6.0, 20.0)) for s in speeds)
    duty = ConstantSpeed(amplitude=reach, speeds=speeds, turn=turn, dwell=0.4, lead_in=1.0)
    temperature, charge = float(rng.uniform(30.0, 42.0)), float(rng.uniform(0.9, 1.1))
    return _run(rig, rng, len(speeds) * turn + 1.0, duty, NoLoad(), temperature, 0.01, charge)


def _run(
    rig: Rig, rng: np.random.Generator, duration: float, duty: AnyDuty, load: AnyLoad, temperature: float,
    warming: float, charge: float,
) -> Scenario:  # fmt: skip
    return Scenario(
        unit=rig.unit.name, duration=round(duration, 3), duty=duty, control=Control(mode="speed"), load=load,
        oil_temperature=temperature, warming=warming, charge_factor=charge, recording=rig.recording,
        details=rig.details, seed=int(rng.integers(0, 2**62)),
    )  # fmt: skip


def _throttle_for(unit: Unit, pressure: float) -> float:
    """Drop (Pa) at 100 rad/s of the throttle that loads this unit with `pressure` at the fastest strokes.

    Quadratic in the flow that leakage leaves; the seal's friction is the rest of the pressure.
    """
    fastest = THROTTLED_SPEEDS[-1] * unit.pump.displacement
    flow = fastest - unit.pump.total_leakage * pressure
    friction = unit.friction.forward.coulomb / unit.cylinder.area_1
    return float((pressure - friction) * (100.0 * unit.pump.displacement / flow) ** 2)
