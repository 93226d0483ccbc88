"""Sensors: their statistics, rounding and range, and how a recording loses rows."""

import numpy as np
import pytest
from scipy.signal import welch

from fdd.plant.load import ConstantLoad
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.sensors import digitise, generator, measure_channel
from fdd.plant.simulate import simulate
from fdd.unit import Sensor, Unit

UNIT = Unit.load("axis_a")
TIME = np.arange(60_000) * 1e-3


def _measure(sensor: Sensor, truth: np.ndarray) -> np.ndarray:
    return measure_channel(sensor, truth, TIME[: truth.size], np.random.default_rng(1))


def test_gain_and_zero():
    truth = np.linspace(-1.0, 1.0, 100)
    np.testing.assert_allclose(_measure(Sensor(gain=1.02, zero=0.3), truth), 1.02 * truth + 0.3)


@pytest.mark.parametrize("bandwidth", [None, 150.0])
def test_noise_has_the_deviation_asked_for_within_its_band(bandwidth):
    sensor = Sensor(noise=7e3, bandwidth_hz=bandwidth)
    noise = _measure(sensor, np.zeros(TIME.size))
    assert np.std(noise) == pytest.approx(7e3, rel=0.03)
    frequency, power = welch(noise, 1000.0, nperseg=1024)
    low, high = power[(frequency > 5) & (frequency < 75)].mean(), power[frequency > 300].mean()
    assert (high < 1e-3 * low) if bandwidth else (high == pytest.approx(low, rel=0.1))


def test_the_signal_lags_by_one_time_constant():
    ramp = 5.0 * TIME[:20_000]
    measured = _measure(Sensor(bandwidth_hz=0.5), ramp)
    assert (ramp - measured)[-1] == pytest.approx(5.0 / (2.0 * np.pi * 0.5), rel=0.01)
    assert measured[0] == ramp[0]


def test_tones_ride_on_the_signal():
    measured = _measure(
        Sensor(tones=[(355.0, 1500.0), (410.0, 900.0)], bandwidth_hz=150.0), np.zeros(TIME.size)
    )
    spectrum = 2.0 * np.abs(np.fft.rfft(measured)) / measured.size
    frequency = np.fft.rfftfreq(measured.size, 1e-3)
    for tone, amplitude in ((355.0, 1500.0), (410.0, 900.0)):
        assert spectrum[np.argmin(np.abs(frequency - tone))] == pytest.approx(amplitude, rel=1e-3)


def test_rounding_and_range():
    value = np.array([-9.0, 0.26, 0.74, 9.0])
    np.testing.assert_allclose(
        digitise(Sensor(resolution=0.5, low=-1.0, high=2.0), value), [-1.0, 0.5, 0.5, 2.0]
    )


def test_the_pump_speed_is_the_count_difference_over_a_nominal_millisecond():
    scenario = Scenario(duration=4.0, recording=Recording(dropped=0.0, late=0.02, nan_bursts_per_minute=0.0))
    samples = simulate(UNIT, scenario).samples
    counted = np.diff(samples["pump_angle"]) / 1e-3
    np.testing.assert_allclose(samples["pump_speed"][1:], counted, atol=1e-6)
    # So a late row shows more than the true speed, the row after it less.
    late = np.flatnonzero(np.diff(samples.time) > 1.3e-3) + 1
    fast = late[np.abs(samples["command"][late - 5]) > 100.0]
    assert fast.size > 3
    ratio = samples["pump_speed"][fast] / samples["pump_speed"][fast - 3]
    assert np.median(ratio) > 1.2


def test_recordings_lose_what_they_are_told_to():
    recording = Recording(dropped=0.02, late=0.03, latest=0.5e-3, nan_bursts_per_minute=30.0)
    scenario = Scenario(duration=20.0, recording=recording, seed=3)
    out = simulate(UNIT, scenario)
    assert len(out.samples) == pytest.approx(20_000 * 0.98, rel=0.005)
    assert out.samples.time[0] == 0.0 and np.all(np.diff(out.samples.time) > 0.0)
    lateness = out.samples.time * 1e3 - np.floor(out.samples.time * 1e3 + 1e-6)
    assert (lateness > 0.05).mean() == pytest.approx(0.03, rel=0.2)
    assert lateness.max() <= 0.5 + 1e-6
    missing = {c: int(np.isnan(out.samples[c]).sum()) for c in out.samples.channels}
    assert sum(missing.values()) > 50 and missing["command"] == 0
    assert np.isfinite(out.truth["position"]).all()


def test_a_late_row_shows_the_plant_at_its_own_stamp():
    on_time = Recording.perfect()
    late = Recording(dropped=0.0, late=0.1, nan_bursts_per_minute=0.0)
    a, b = (simulate(UNIT, Scenario(duration=3.0, recording=r)).truth for r in (on_time, late))
    assert not np.array_equal(a["pump_angle"], b["pump_angle"])
    between = np.interp(b.time, a.time, a["pump_angle"])[:-1]
    np.testing.assert_allclose(b["pump_angle"][:-1], between, atol=5e-3)


def test_the_load_is_measured_only_when_asked():
    scenario = Scenario(duration=0.5, load=ConstantLoad(level=700.0), recording=Recording(load_force=True))
    assert np.nanmedian(simulate(UNIT, scenario).samples["load_force"]) == pytest.approx(700.0)
    assert "load_force" not in simulate(UNIT, Scenario(duration=0.5)).samples


def test_streams_of_unlike_purpose_are_independent():
    draws = np.array(
        [generator(7, purpose).standard_normal(4000) for purpose in ("duty", "load", "sensor a")]
    )
    correlation = np.corrcoef(draws) - np.eye(3)
    assert np.abs(correlation).max() < 0.06
