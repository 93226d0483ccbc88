"""What the filters take from a profile."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.eha.noise import Noise
from fdd.residuals.tracking import gain_spread, noise_of
from fdd.unit import Unit


def test_noise_that_a_profile_sets_goes_before_what_is_argued() -> None:
    plain = Unit.load("axis_a")
    assert plain.estimation is None and "estimation" not in plain.to_yaml()
    own = Unit.from_yaml(plain.to_yaml() + "estimation: {flow: 3.0e-7}\n")
    again = Unit.from_yaml(own.to_yaml())
    assert noise_of(plain).flow == Noise().flow
    assert noise_of(own).flow == noise_of(again).flow == pytest.approx(3.0e-7)
    assert noise_of(own).leakage == noise_of(plain).leakage


def test_what_a_count_rounds_to_is_noise_of_its_own() -> None:
    """By rounding many values."""
    unit, rng = Unit.load("axis_a"), np.random.default_rng(1)
    for channel, noise in (("position", 2e-5), ("pump_angle", 0.004)):
        step, true = 4.0 * noise, rng.uniform(0.0, 1000.0 * noise, 100_000)
        coarse = {"noise": noise, "resolution": step}
        unit.sensors[channel] = unit.sensor(channel).model_copy(update=coarse)
        seen = np.round((true + noise * rng.normal(size=true.size)) / step) * step
        found = getattr(noise_of(unit), channel.removeprefix("pump_"))
        assert found == pytest.approx(np.std(seen - true), rel=0.02)


def test_a_sensor_without_noise_has_the_usual_one() -> None:
    """A filter that believes a sensor wholly divides by nothing."""
    unit, usual = Unit.load("axis_a"), Noise()
    for channel in ("pressure_1", "pressure_2", "pressure_difference", "position", "pump_angle"):
        still = {"noise": 0.0, "resolution": 0.0}
        unit.sensors[channel] = unit.sensor(channel).model_copy(update=still)
    found = noise_of(unit)
    for name in ("pressure", "pressure_difference", "position", "angle"):
        assert getattr(found, name) == getattr(usual, name) > 0.0, name
    unit.sensors["pressure_1"] = unit.sensor("pressure_1").model_copy(update={"noise": 3e3})
    assert noise_of(unit).pressure == 3e3, "the worse of the two"
    assert noise_of(unit).relief_pressure < unit.accumulator.relief_pressure


def test_a_pumps_gain_is_as_sure_as_its_profile_says() -> None:
    """Relative, and never surer than thirty kelvin let it be: metals grow by some 2e-5 a kelvin."""
    plain = Unit.load("axis_a")
    assert gain_spread(plain) == noise_of(plain).initial_gain == Noise().initial_gain
    known = plain.pump.provenance["displacement"]
    for share, least, most in ((0.01, 0.01, 0.0101), (1e-6, 3e-4, 1e-3)):
        std = share * plain.pump.displacement
        plain.pump.provenance["displacement"] = known.model_copy(update={"std": std})
        assert least <= gain_spread(plain) <= most
