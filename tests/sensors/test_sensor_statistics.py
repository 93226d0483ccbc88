"""The chances that thresholds are argued with, against simulated noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from fdd.sensors.jumps import NOISE_REACH
from fdd.sensors.limits import INDEX, Limits
from fdd.sensors.statistics import excess, spread
from fdd.unit import Unit

ROWS = 1_000_000


def chance_of_excess(reach: float) -> float:
    """That ``a + 2b + c`` and ``2a + b + d`` are both beyond `reach`, or both below its negative."""
    correlation, scale = 4.0 / 6.0, np.sqrt(6.0)
    rest = np.sqrt(1.0 - correlation**2)

    def density(u: float) -> float:
        return float(stats.norm.pdf(u) * stats.norm.sf((reach / scale - correlation * u) / rest))

    return 2.0 * float(integrate.quad(density, reach / scale, reach / scale + 12.0)[0])


@pytest.mark.parametrize("reach", [4.0, 7.0])
def test_excess_of_white_noise_has_the_chance_that_is_said(reach: float) -> None:
    noise = np.random.default_rng(1).normal(0.0, 1.0, ROWS)
    over = np.abs(excess(np.arange(ROWS) * 1e-3, noise)) > reach
    expected = chance_of_excess(reach)
    assert over.mean() == pytest.approx(expected, abs=5.0 * np.sqrt(expected / ROWS))


def test_a_false_jump_comes_once_in_a_hundred_thousand_hours() -> None:
    channels, strides, rate = 6, 2, 1000.0
    per_hour = chance_of_excess(NOISE_REACH) * channels * strides * rate * 3600.0
    assert per_hour < 1e-5


def test_noise_is_estimated_through_jumps_and_rounding() -> None:
    rng = np.random.default_rng(2)
    noise = rng.normal(0.0, 3.0, (800, 40))
    # A step every 20 rows, and rounding to the noise's own size.
    spoilt = np.round(noise / 3.0) * 3.0 + 100.0 * np.cumsum(np.arange(800) % 20 == 0)[:, None]
    assert np.median([spread(run) for run in noise.T]) == pytest.approx(3.0, rel=0.05)
    assert all(2.0 < spread(run) < 9.0 for run in spoilt.T)


def test_rows_of_noise_repeat_no_more_often_than_limits_allow() -> None:
    unit = Unit.load("axis_a")
    sensor = unit.sensor("pressure_1")
    values = 5e5 + sensor.noise * np.random.default_rng(3).normal(size=ROWS)
    counts = np.round(values / sensor.resolution)
    repeated = float((np.diff(counts) == 0).mean())
    assert repeated == pytest.approx(sensor.resolution / (sensor.noise * np.sqrt(4.0 * np.pi)), rel=0.05)
    assert Limits.of(unit).repeat[INDEX["pressure_1"]] >= repeated


def test_limits_leave_every_shipped_unit_its_ordinary_range() -> None:
    for name in ("axis_a", "axis_b"):
        unit, limits = Unit.load(name), Limits.of(Unit.load(name))
        half, relief = 0.5 * unit.cylinder.stroke, unit.accumulator.relief_pressure
        assert limits.low[INDEX["position"]] < -half < half < limits.high[INDEX["position"]]
        assert limits.high[INDEX["pressure_1"]] > relief + unit.accumulator.charge_pressure
        assert limits.low[INDEX["pressure_1"]] < -101_325.0
        assert limits.high[INDEX["pump_speed"]] > unit.drive.max_speed
