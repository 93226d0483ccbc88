"""Residual features: near zero on a healthy unit, and moved by the fault that they stand for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fdd.faults import CATALOGUE
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.features import FEATURES, shrink
from fdd.residuals.windows import ResidualWindows
from fdd.unit import Unit

# What each simulated fault moves, and which way (0: either); severity 1 under a spring load.
MOVES: dict[str, tuple[str, int]] = {
    "internal_leakage": ("leakage", 1),
    "external_leakage": ("accumulator", -1),
    "pump_wear": ("jump", 1),  # a loss that grows with speed fits none of the parameters for long
    "case_drain_seal_failure": ("loss_largest", 1),
    "seal_wear": ("friction", -1),
    "aeration": ("compliance", 1),
    "check_valve_stuck_open": ("valve_largest", 1),
    "check_valve_clogged": ("refeed_deficit", 1),
    "relief_valve_stuck_open": ("leakage", 1),
    "oil_degradation": ("leakage", 1),
    "motor_degradation": ("torque", 1),
    "pressure_sensor_bias": ("redundancy", 0),
    "pressure_sensor_drift": ("redundancy", 0),
    "position_sensor_slip": ("compliance", 1),
}

# What no feature shows: the list says what the diagnosis cannot see in a minute of log.
SILENT = {
    "shaft_seal_wear": "1 cm³/min is a thirtieth of the accumulator's oil in this log",
    "sensor_dropout": "rows without a pressure are left out; the log's quality tells of them",
    "coupling_wear": "no feature looks at pulses once a turn of the shaft",
}


# A clogged valve shows on the side that the load leaves low, and only as oil leaves it for the case.
NEEDS: dict[str, dict[str, Any]] = {
    "check_valve_clogged": {"duration": 50.0, "load": {"name": "constant", "level": 2500.0}, "side": 2},
}


def medians(fault: str | None = None, like: str | None = None) -> dict[str, float]:
    """Median features of the last ten seconds, with `fault` or healthy under the load that `like` needs."""
    unit = Unit.load("axis_a")
    needs = dict(NEEDS.get(fault or like or "", {}))
    side = needs.pop("side", None)
    scenario = {"duration": 24.0, "seed": 21, "load": {"name": "spring"}} | needs
    if fault is not None:
        spec = {"fault": fault, "severity": 1.0, "onset": 4.0}
        scenario["faults"] = [spec if side is None else spec | {"side": side}]
    samples = simulate(unit, Scenario(**scenario)).samples
    times, features = ResidualWindows(unit).push(samples)
    return dict(zip(FEATURES, np.median(features[times > times[-1] - 10.0], axis=0), strict=True))


@pytest.fixture(scope="module")
def healthy() -> dict[str, float]:
    return medians()


def test_every_simulated_fault_is_checked() -> None:
    assert {f.id for f in CATALOGUE.values() if f.simulated} == set(MOVES) | set(SILENT)
    assert not set(MOVES) & set(SILENT)


def test_healthy_residuals_are_small(healthy: dict[str, float]) -> None:
    for name in ("leakage", "valve_1", "valve_2", "compliance", "redundancy", "refeed_deficit"):
        assert abs(healthy[name]) < 0.15, name
    assert abs(healthy["friction"]) < 0.3


@pytest.mark.parametrize("fault", MOVES)
def test_fault_moves_its_feature(fault: str, healthy: dict[str, float]) -> None:
    feature, direction = MOVES[fault]
    before = medians(like=fault) if fault in NEEDS else healthy
    moved = medians(fault)[feature] - before[feature]
    assert (abs(moved) if direction == 0 else direction * moved) > 0.2


@pytest.mark.parametrize("fault", SILENT)
def test_a_silent_fault_moves_nothing(fault: str, healthy: dict[str, float]) -> None:
    """Once a feature sees one of these, it belongs into `MOVES`."""
    found = medians(fault)
    for name in FEATURES:
        assert abs(found[name] - healthy[name]) < 0.2, name


def test_shrink_is_a_posterior_mean() -> None:
    # Conjugate normal: prior N(0, 0.3²), one observation 0.6 with variance 0.3² gives the midpoint.
    assert shrink(0.6, 0.09) == pytest.approx(0.3)
    assert shrink(0.6, 1e12) == pytest.approx(0.0, abs=1e-9)
    assert shrink(0.6, 0.0) == 0.6
    assert shrink(float("nan"), 0.1) == 0.0
