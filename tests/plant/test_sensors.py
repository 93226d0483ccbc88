"""Sensors: their statistics, rounding and range, and how a recording loses rows."""

import numpy as np
import pytest
from scipy.signal import welch

from fdd.plant.scenario import Recording, Scenario
from fdd.plant.sensors import ChannelSensor, Recorder, range_of
from fdd.plant.sensors.recorder import MEASURED
from fdd.plant.simulate import simulate
from fdd.sensor import CurrentLoop
from fdd.unit import Sensor, Unit

UNIT = Unit.load("axis_a")
TIME = np.arange(60_000) * 1e-3
LOOP = CurrentLoop(low=0.0, high=6.895e6, resistance=499.0)


def _measure(sensor: Sensor, truth: np.ndarray, angle: np.ndarray | None = None) -> np.ndarray:
    return ChannelSensor(sensor, np.random.default_rng(1)).observe(truth, TIME[: truth.size], angle)


@pytest.mark.parametrize("bandwidth", [None, 150.0])
def test_noise_has_the_deviation_asked_for_within_its_band(bandwidth):
    sensor = Sensor(noise=7e3, bandwidth_hz=bandwidth)
    noise = _measure(sensor, np.zeros(TIME.size))
    assert np.std(noise) == pytest.approx(7e3, rel=0.03)
    frequency, power = welch(noise, 1000.0, nperseg=1024)
    low, high = power[(frequency > 5) & (frequency < 75)].mean(), power[frequency > 300].mean()
    assert (high < 1e-3 * low) if bandwidth else (high == pytest.approx(low, rel=0.1))


def test_band_limited_noise_is_settled_from_the_first_row():
    sensor = Sensor(noise=1.0, bandwidth_hz=5.0)
    row = np.zeros(1)
    first = [ChannelSensor(sensor, np.random.default_rng(k)).observe(row, row)[0] for k in range(800)]
    # Standard error of a deviation from 800 draws: 2.5 %.
    assert np.std(first) == pytest.approx(1.0, abs=0.1)


def test_the_signal_lags_by_one_time_constant():
    ramp = 5.0 * TIME[:20_000]
    measured = _measure(Sensor(bandwidth_hz=0.5), ramp)
    assert (ramp - measured)[-1] == pytest.approx(5.0 / (2.0 * np.pi * 0.5), rel=0.01)
    assert measured[0] == ramp[0]


def test_tones_ride_on_the_signal():
    tones = [(355.0, 1500.0), (410.0, 900.0)]
    measured = _measure(Sensor(tones=tones, bandwidth_hz=150.0), np.zeros(TIME.size))
    spectrum = 2.0 * np.abs(np.fft.rfft(measured)) / measured.size
    frequency = np.fft.rfftfreq(measured.size, 1e-3)
    for tone, amplitude in tones:
        assert spectrum[np.argmin(np.abs(frequency - tone))] == pytest.approx(amplitude, rel=1e-3)


def test_the_differentiated_encoder_peaks_near_165_hz_at_three_volts():
    # Figure A.8: 3 V, 94.24 rad/s, 34.1 mm/s; here with a whole number of counts a row, since the rounding
    # of any other speed makes lines of its own.
    encoder = UNIT.sensor("position")
    truth, angle = 34e-6 * np.arange(16_384) + 0.31e-6, 94.24e-3 * np.arange(16_384)
    # As uneven as friction makes it: enough to blur the rounding into noise.
    truth = truth + np.cumsum(np.random.default_rng(3).normal(0.0, 0.3e-6, truth.size))
    shown = range_of(encoder).digitise(_measure(encoder, truth, angle))
    frequency, power = welch(np.diff(shown) / 1e-3, 1000.0, nperseg=2048)
    band = (frequency > 100.0) & (frequency < 450.0)
    assert frequency[band][np.argmax(power[band])] == pytest.approx(165.0, abs=1.0)
    near = (frequency > 120.0) & (frequency < 150.0)
    assert power[band].max() > 2.5 * power[near].mean()
    # And yet the position is what the thesis calls free of noise: within a count of the truth.
    assert np.abs(shown - truth).max() < 0.75e-6


def test_the_current_loop_is_the_theses():
    # Eqs A.1 to A.4: 1.996 V and 9.980 V, 8.636e5 Pa/V, 1.724e6 Pa; 20 V over 2^16 codes.
    assert LOOP.sensitivity == pytest.approx(8.636e5, rel=1e-4)
    assert LOOP.offset == pytest.approx(1.724e6, rel=2e-4)
    assert LOOP.resolution == pytest.approx(8.636e5 * 20.0 / 65536, rel=1e-4)
    for volts, pressure in ((1.996, 0.0), (9.980, 6.895e6), (0.0, -1.724e6)):
        assert LOOP.sensitivity * volts - LOOP.offset == pytest.approx(pressure, abs=300.0)
    for axis in ("axis_a", "axis_b"):
        sensor = Unit.load(axis).sensor("pressure_difference")
        assert sensor.loop is not None and sensor.resolution == sensor.loop.resolution


def test_the_converter_rounds_to_codes_and_ends_at_its_range():
    pressure = np.linspace(-9e6, 9e6, 20_001)
    shown = range_of(Sensor(loop=LOOP)).digitise(pressure)
    codes = (shown + LOOP.offset) / LOOP.resolution
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)
    # From no current at all to the highest code of +10 V.
    assert (codes.min(), codes.max()) == pytest.approx((0.0, 32767.0))
    inside = (pressure > 0.0) & (pressure < 6.895e6)
    assert np.abs(shown - pressure)[inside].max() <= 0.5001 * LOOP.resolution
    turned = range_of(Sensor(loop=LOOP.model_copy(update={"reversible": True}))).digitise(pressure)
    assert turned.min() == pytest.approx(-turned.max(), abs=LOOP.resolution)
    assert np.abs(turned - pressure)[np.abs(pressure) < 6.895e6].max() <= 0.5001 * LOOP.resolution


def test_the_pump_speed_is_the_count_difference_over_a_nominal_millisecond():
    scenario = Scenario(duration=4.0, recording=Recording(dropped=0.0, late=0.02, nan_bursts_per_minute=0.0))
    samples = simulate(UNIT, scenario).samples
    counted = np.diff(samples["pump_angle"]) / 1e-3
    np.testing.assert_allclose(samples["pump_speed"][1:], counted, atol=1e-6)
    # So a late row shows more than the true speed, the row after it less.
    late = np.flatnonzero(np.diff(samples.time) > 1.3e-3) + 1
    fast = late[np.abs(samples["command"][late - 5]) > 100.0]
    assert fast.size > 3
    assert np.median(samples["pump_speed"][fast] / samples["pump_speed"][fast - 3]) > 1.2


def test_recordings_lose_what_they_are_told_to():
    recording = Recording(dropped=0.02, late=0.03, latest=0.5e-3, nan_bursts_per_minute=30.0)
    out = simulate(UNIT, Scenario(duration=20.0, recording=recording, seed=3))
    assert len(out.samples) == pytest.approx(20_000 * 0.98, rel=0.005)
    assert out.samples.time[0] == 0.0 and np.all(np.diff(out.samples.time) > 0.0)
    lateness = out.samples.time * 1e3 - np.floor(out.samples.time * 1e3 + 1e-6)
    assert (lateness > 0.05).mean() == pytest.approx(0.03, rel=0.2)
    assert lateness.max() <= 0.5 + 1e-6
    missing = {c: int(np.isnan(out.samples[c]).sum()) for c in out.samples.channels}
    assert sum(missing.values()) > 50 and missing["command"] == 0
    assert np.isfinite(out.truth["position"]).all()


def test_bursts_of_nan_come_at_their_rate_and_length():
    recording = Recording(dropped=0.0, late=0.0, nan_bursts_per_minute=30.0)
    n = 1_200_000
    truth = {c: np.zeros(n) for c in MEASURED}
    columns = Recorder(UNIT, [], recording, seed=5).measure(truth, np.arange(n) * 1e-3).columns
    lost = np.array([np.isnan(columns[c]) for c in columns])
    struck = np.diff(lost.any(axis=0).astype(int))
    starts, ends = np.flatnonzero(struck == 1), np.flatnonzero(struck == -1)
    # 600 expected: ±4 deviations of a Poisson count.
    assert abs(starts.size - 600) < 100
    lengths = ends - starts
    assert lengths.min() >= 5 and np.mean(lengths) == pytest.approx(17.5, rel=0.05)
    at_once = lost[:, starts + 1].sum(axis=0)
    assert at_once.min() == 1 and at_once.mean() == pytest.approx(2.5, rel=0.08)


def test_stamps_jitter_while_the_rows_are_taken_on_time():
    recording = Recording(dropped=0.0, late=0.0, nan_bursts_per_minute=0.0, jitter=1e-5)
    truth = {c: TIME.copy() for c in MEASURED}
    rows = Recorder(UNIT, [], recording, seed=5).measure(truth, TIME)
    error = rows.time - TIME
    assert rows.time[0] == 0.0 and np.all(np.diff(rows.time) > 0.0)
    assert np.std(error) == pytest.approx(1e-5, rel=0.02)
    plain = Recorder(UNIT, [], Recording.perfect(), seed=5).measure(truth, TIME)
    np.testing.assert_array_equal(rows.columns["pressure_1"], plain.columns["pressure_1"])


def test_a_late_row_shows_the_plant_at_its_own_stamp():
    late = Recording(dropped=0.0, late=0.1, nan_bursts_per_minute=0.0)
    a, b = (simulate(UNIT, Scenario(duration=3.0, recording=r)).truth for r in (Recording.perfect(), late))
    assert not np.array_equal(a["pump_angle"], b["pump_angle"])
    between = np.interp(b.time, a.time, a["pump_angle"])[:-1]
    np.testing.assert_allclose(b["pump_angle"][:-1], between, atol=5e-3)
