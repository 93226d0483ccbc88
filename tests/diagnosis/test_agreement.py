"""An estimate needs a second witness beside the data: the profile of a healthy unit, or a finding."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.eha import layout
from estimators.observability import Observed
from fdd.diagnosis.agreement import believed
from fdd.diagnosis.findings import FaultFinding
from fdd.residuals.quantities import Scales
from fdd.unit import Unit

CHANNELS = ("position", "pump_angle", "pressure_1", "pressure_2", "oil_temperature")


@pytest.fixture(scope="module")
def unit() -> Unit:
    from pathlib import Path

    import fdd

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


def test_what_agrees_with_the_profile_is_observable(unit: Unit) -> None:
    out, _ = judged(unit, 1.05, 0.9)
    assert out["leakage"].valid.all() and out["bulk_modulus"].valid.all()
    assert out["leakage"].held[-1] == pytest.approx(1.05 * unit.pump.total_leakage)


def test_a_factor_that_no_fault_explains_is_held_at_the_profile(unit: Unit) -> None:
    """Test: 200 times the leakage beside a healthy verdict. Expected: not observable, and why."""
    out, why = judged(unit, 200.0, 0.1)
    for name, healthy in (("leakage", unit.pump.total_leakage), ("bulk_modulus", unit.oil.bulk_modulus)):
        assert not out[name].valid.any() and out[name].held[-1] == pytest.approx(healthy)
        assert "agrees neither" in why[name]


def test_a_leak_that_was_found_moves_leakage_by_its_own_size_from_its_onset_on(unit: Unit) -> None:
    more = 1.0 + 0.5 * Scales.of(unit).fault_leakage / unit.pump.total_leakage
    leak = (finding("internal_leakage", 0.5),)
    assert judged(unit, more, faults=leak)[0]["leakage"].valid.tolist() == [False, True]
    assert not judged(unit, 200.0, faults=leak)[0]["leakage"].valid.any()
    assert not judged(unit, 0.5, faults=leak)[0]["leakage"].valid.any()


def test_a_valve_that_was_found_is_no_port_leakage(unit: Unit) -> None:
    found = judged(unit, 1.0, faults=(finding("relief_valve_stuck_open", 0.5),))[0]
    assert found["leakage"].valid.tolist() == [True, False]


def test_air_that_was_found_softens_the_oil(unit: Unit) -> None:
    air = (finding("aeration", 0.5),)
    assert judged(unit, 1.0, 0.3, faults=air)[0]["bulk_modulus"].valid.tolist() == [False, True]
    assert not judged(unit, 1.0, 3.0, faults=air)[0]["bulk_modulus"].valid.any()


def test_a_bulk_modulus_at_an_unknown_pressure_is_none(unit: Unit) -> None:
    out, why = judged(unit, 1.0, channels=("position", "pump_speed", "pressure_difference"))
    assert not out["bulk_modulus"].valid.any() and "pressure" in why["bulk_modulus"]


def test_a_base_says_nothing_of_a_unit() -> None:
    out, why = judged(Unit.load("axis_a"), 200.0)
    assert out["leakage"].valid.all() and not why
