"""The healthy calibration runs of a drawn unit, from which ``fdd identify`` makes its profile."""

from __future__ import annotations

import numpy as np

from fdd.campaign.drawing import Rig
from fdd.campaign.recipe import Recipe
from fdd.plant.duty import AnyDuty, ConstantSpeed, Sines
from fdd.plant.rig import AnyLoad, NoLoad, ThrottleLoad
from fdd.plant.scenario import Control, Scenario
from fdd.unit import Unit

SPEEDS = (50.0, 105.0, 200.0)
"""rad/s, of the free strokes."""
MULTI_SINE_HZ = (0.3, 25.0)
ORDINARY_SPEEDS = (0.12, 0.25, 0.5, 0.75)
"""Of the drive's largest, of ordinary strokes."""
THROTTLED_SPEEDS = (60.0, 85.0, 110.0)
"""rad/s, of the throttled strokes; the largest pressure comes with the last."""
THROTTLED_PRESSURE = (2.1e6, 2.8e6)
"""Pa, that largest pressure's range."""


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
