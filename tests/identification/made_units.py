"""Units with known truth, and healthy logs of theirs: for calibration, and of ordinary work."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fdd import Samples, Scenario, Unit, simulate
from fdd.identification import Identification
from fdd.identification.identify import identify_unit

TEMPERATURE = 35.0
SEEDS = (1, 2, 3)
KNOWN = {"air_law": "free", "pump_friction": 0.0}
"""Details as identification takes them; `test_identify.test_what_its_model_lacks_...` has the others."""
LOADS = ("none", "spring", "constant", "gust")
DUTIES = ("steps", "flight", "sines", "strokes", "sawtooth")


@dataclass(frozen=True)
class Case:
    """A unit that differs from its base, healthy logs of it, and what identification made of them."""

    truth: Unit
    base: Unit
    logs: list[Samples]
    found: Identification


@cache
def case_of(seed: int) -> Case:
    truth, base = random_unit(seed), Unit.load("axis_a")
    logs = calibration_logs(truth, seed)
    return Case(truth, base, logs, identify_unit(logs, base, name=f"unit {seed}"))


def identified(found: Identification, quantity: str) -> tuple[float, float]:
    """A quantity's value and standard deviation."""
    (row,) = [r for r in found.table if r.quantity == quantity]
    assert row.identified is not None and row.std is not None, row.note
    return row.identified, row.std


def with_zeros(unit: Unit, rng: np.random.Generator) -> Unit:
    """The unit with pressure sensors that are off, by 8 and 2 kPa rms."""
    for channel, size in (("pressure_difference", 8e3), ("pressure_1", 2e3), ("pressure_2", 2e3)):
        unit.sensors[channel].zero = float(rng.normal(0.0, size))
    return unit


def random_unit(seed: int) -> Unit:
    """Axis A with its parameters drawn within 15 % of the profile's."""
    rng, unit = np.random.default_rng(seed), Unit.load("axis_a")
    for section, names in (
        (unit.pump, ("displacement", "cross_port_leakage", "case_leakage")),
        (unit.oil, ("bulk_modulus", "air_fraction")),
        (unit.accumulator, ("charge_pressure",)),
        (unit.drive, ("torque_constant",)),
        *((b, ("coulomb", "static", "viscous")) for b in (unit.friction.forward, unit.friction.reverse)),
    ):
        for name in names:
            setattr(section, name, float(getattr(section, name) * rng.uniform(0.85, 1.15)))
    unit.friction.trial_spread = 0.0  # the draw of a run would be the truth then, not the curve
    return with_zeros(unit, rng)


def calibration_logs(unit: Unit, seed: int, **changes: Any) -> list[Samples]:
    """Strokes at three speeds, a multisine, throttled strokes, strokes against a spring to 2.8 MPa."""
    changes["details"] = {**KNOWN, **changes.get("details", {})}

    def strokes(speeds: list[float], turn: float, amplitude: float) -> dict[str, object]:
        return {"name": "constant_speed", "speeds": speeds, "turn": turn, "amplitude": amplitude,
                "dwell": 0.3}  # fmt: skip

    sines = {"name": "sines", "amplitude": 0.02, "low_hz": 0.5, "high_hz": 8.0, "count": 6, "tilt": 0.6}
    throttle, spring = {"name": "throttle", "pressure": 2.0e6}, {"name": "spring", "rate": 3.5e4}
    runs = (
        (36.0, strokes([50.0, 120.0, 240.0], 12.0, 0.08), "speed", {"name": "none"}),
        (8.0, sines, "position", {"name": "none"}),
        (16.0, strokes([60.0, 100.0], 8.0, 0.06), "speed", throttle),
        (12.0, strokes([100.0], 10.0, 0.08), "speed", spring),
    )
    common = {"oil_temperature": TEMPERATURE, **changes}
    scenarios = [
        Scenario(duration=s, duty=duty, control={"mode": mode}, load=load, seed=10 * seed + i, **common)
        for i, (s, duty, mode, load) in enumerate(runs)
    ]
    return [simulate(unit, scenario).samples for scenario in scenarios]


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
    return with_zeros(unit, rng)


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
