"""An estimate needs a second witness beside the data: the profile of a healthy unit, or a finding."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fdd
from estimators.eha import layout
from estimators.observability import Observed
from fdd.diagnosis.agreement import believed
from fdd.diagnosis.findings import FaultFinding
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

CHANNELS = ("position", "pump_angle", "pressure_1", "pressure_2", "oil_temperature")


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit.load(Path(fdd.__file__).parent / "demo" / "unit.yaml")


def seen(value: float, std: float) -> Observed:
    one = np.ones(2)
    return Observed(one > 0.0, std * one, value * one, std * one, 0.0 * one)


def judged(
    unit: Unit, leakage: float, modulus: float = 1.0, channels: tuple[str, ...] = CHANNELS,
    faults: tuple[FaultFinding, ...] = (),
) -> tuple[dict[str, Observed], dict[str, str]]:  # fmt: skip
    """Records at 10 and 30 s; estimates over the profile's, each known to 2 %."""
    records = np.zeros(2, layout.RECORD)
    records["time"], records["viscosity"] = (10.0, 30.0), 1.0
    healthy, beta = unit.pump.total_leakage, unit.oil.bulk_modulus
    found = {
        "leakage": seen(leakage * healthy, 0.02 * leakage * healthy),
        "bulk_modulus": seen(modulus * beta, 0.02 * modulus * beta),
    }
    return believed(found, records, unit, channels, faults)


def finding(kind: str, severity: float | None = None) -> FaultFinding:
    return FaultFinding(
        fault=kind, family="leakage", ambiguity=[kind], confidence=0.9, onset_s=20.0, detected_s=25.0,
        severity=severity, evidence=[], next_check="",
    )  # fmt: skip


LEAK, VALVE = finding("internal_leakage", 0.5), finding("relief_valve_stuck_open", 0.5)
AIR = finding("aeration", 0.5)
NEVER, BEFORE, AFTER, ALWAYS = [False, False], [True, False], [False, True], [True, True]


@pytest.mark.parametrize(
    ("leakage", "modulus", "found", "leakage_valid", "modulus_valid"),
    [
        (1.05, 0.9, (), ALWAYS, ALWAYS),
        (200.0, 0.1, (), NEVER, NEVER),
        (None, 1.0, (LEAK,), AFTER, ALWAYS),  # more by its own size, from its onset on
        (200.0, 1.0, (LEAK,), NEVER, ALWAYS),
        (0.5, 1.0, (LEAK,), NEVER, ALWAYS),
        (1.0, 1.0, (VALVE,), BEFORE, ALWAYS),  # a valve's oil does not cross the ports
        (1.0, 0.3, (AIR,), ALWAYS, AFTER),
        (1.0, 3.0, (AIR,), ALWAYS, NEVER),
    ],
)
def test_an_estimate_agrees_with_the_profile_or_with_what_was_found(
    unit: Unit, leakage: float | None, modulus: float, found: tuple[FaultFinding, ...],
    leakage_valid: list[bool], modulus_valid: list[bool],
) -> None:  # fmt: skip
    """Before a fault at 20 s and after it; what agrees with neither is held at the profile, and why."""
    if leakage is None:
        leakage = 1.0 + 0.5 * Scales.of(unit).fault_leakage / unit.pump.total_leakage
    out, why = judged(unit, leakage, modulus, faults=found)
    healthy = {"leakage": unit.pump.total_leakage, "bulk_modulus": unit.oil.bulk_modulus}
    for name, valid in (("leakage", leakage_valid), ("bulk_modulus", modulus_valid)):
        assert out[name].valid.tolist() == valid, name
        if valid == NEVER and not found:
            assert out[name].held[-1] == pytest.approx(healthy[name]) and "agrees neither" in why[name]
    if leakage_valid == ALWAYS:
        assert out["leakage"].held[-1] == pytest.approx(leakage * healthy["leakage"])


def test_a_bulk_modulus_at_an_unknown_pressure_is_none(unit: Unit) -> None:
    out, why = judged(unit, 1.0, channels=("position", "pump_speed", "pressure_difference"))
    assert not out["bulk_modulus"].valid.any() and "pressure" in why["bulk_modulus"]


def test_a_base_says_nothing_of_a_unit() -> None:
    out, why = judged(Unit.load("axis_a"), 200.0)
    assert out["leakage"].valid.all() and not why
