"""Units of one kind as manufacturing spreads them, and logs of theirs under different loads."""

from __future__ import annotations

from typing import Any

import numpy as np

from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit

LOADS = ("none", "spring", "constant", "gust")
DUTIES = ("steps", "flight", "sines", "strokes", "sawtooth")


def spread_unit(seed: int) -> Unit:
    """Axis A drawn log-normally: 2 % displacement, 30 % leakage, 15 % bulk modulus, 20 % friction."""
    rng, unit = np.random.default_rng(seed), Unit.load("axis_a")

    def factor(spread: float) -> float:
        return float(np.exp(rng.normal(0.0, spread)))

    unit.pump.displacement *= factor(0.02)
    leakage = factor(0.3)
    unit.pump.cross_port_leakage *= leakage
    unit.pump.case_leakage *= leakage
    unit.oil.bulk_modulus *= factor(0.15)
    unit.oil.air_fraction = min(unit.oil.air_fraction * factor(0.3), 0.02)
    unit.accumulator.charge_pressure *= factor(0.12)
    unit.drive.torque_constant *= factor(0.03)
    for branch in (unit.friction.forward, unit.friction.reverse):
        grip = factor(0.2)
        for name in ("coulomb", "static", "viscous"):
            setattr(branch, name, grip * getattr(branch, name))
    for channel, size in (("pressure_difference", 8e3), ("pressure_1", 2e3), ("pressure_2", 2e3)):
        unit.sensors[channel].zero = float(rng.normal(0.0, size))
    return unit


def work(
    unit: Unit, seed: int, *, duty: str = "", load: str = "", fault: dict[str, Any] | None = None
) -> Samples:
    """30 s of ordinary work on warm oil; duty and load are drawn where they are not given."""
    rng = np.random.default_rng(seed)
    scenario = Scenario(
        duration=30.0, duty={"name": duty or str(rng.choice(DUTIES))},
        load={"name": load or str(rng.choice(LOADS))}, oil_temperature=float(rng.uniform(30.0, 45.0)),
        faults=[] if fault is None else [fault], seed=seed,
    )  # fmt: skip
    return simulate(unit, scenario).samples


def scaled(log: Samples, factor: float, *channels: str) -> Samples:
    """The log with some channels in another unit of measure."""
    return log.with_columns({c: factor * log[c] for c in channels if c in log})


def only(log: Samples, *channels: str) -> Samples:
    return Samples(log.time, {c: log[c] for c in channels})


def with_swapped_chambers(log: Samples) -> Samples:
    return log.with_columns({"pressure_1": log["pressure_2"], "pressure_2": log["pressure_1"]})
