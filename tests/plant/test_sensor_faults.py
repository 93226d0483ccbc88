"""Sensors and their faults: statistics, rounding, range and laws against closed forms; how rows are lost."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.signal import welch

from fdd import Scenario, Unit, simulate
from fdd.faults import CATALOGUE
from fdd.plant.faults import FaultScales, FaultSpec
from fdd.plant.sensors import KNOWN, MEASURED, ChannelSensor, Recorded, Recorder, range_of
from fdd.plant.sensors.faults import DROPOUTS, PLAY, position_offset, sensor_fault
from fdd.plant.sensors.recording import Recording
from fdd.sections import CurrentLoop, Sensor

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
        assert sensor.resolution == sensor.loop.resolution


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
    _, columns, _ = Recorder(UNIT, [], recording, seed=5).measure(truth, np.arange(n) * 1e-3)
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
    stamps, columns, _ = Recorder(UNIT, [], recording, seed=5).measure(truth, TIME)
    error = stamps - TIME
    assert stamps[0] == 0.0 and np.all(np.diff(stamps) > 0.0)
    assert np.std(error) == pytest.approx(1e-5, rel=0.02)
    _, plain, _ = Recorder(UNIT, [], Recording.perfect(), seed=5).measure(truth, TIME)
    np.testing.assert_array_equal(columns["pressure_1"], plain["pressure_1"])


def test_a_late_row_shows_the_plant_at_its_own_stamp():
    late = Recording(dropped=0.0, late=0.1, nan_bursts_per_minute=0.0)
    a, b = (simulate(UNIT, Scenario(duration=3.0, recording=r)).truth for r in (Recording.perfect(), late))
    assert not np.array_equal(a["pump_angle"], b["pump_angle"])
    between = np.interp(b.time, a.time, a["pump_angle"])[:-1]
    np.testing.assert_allclose(b["pump_angle"][:-1], between, atol=5e-3)


RATES = (200, 500, 1000, 2000)
WAYS = [
    *(("pressure_sensor_bias", {"law": law}) for law in ("gain", "hysteresis")),
    *(("pressure_sensor_drift", {"law": law}) for law in ("root", "walk", "settling")),
    *(("sensor_dropout", {"variant": variant}) for variant in ("noisy", "sticking", "clipped", "late")),
]
IDS = ["-".join([name, *way.values()]) for name, way in WAYS]
PROFILES = ("step", "ramp", "intermittent", "exponential", "random")
TWO_CHAMBERS = ("position", "pump_angle", "pump_speed", "pressure_1", "pressure_2")
"""Of a log without the differential pressure."""
N = 4000


def spec(name: str, way: dict[str, str], severity: float = 1.0, **more: Any) -> FaultSpec:
    return FaultSpec(fault=name, severity=severity, **way, **more)


def shown(
    asked: FaultSpec, truth: np.ndarray, time: np.ndarray, seed: int = 3, **scales: float
) -> np.ndarray:
    """What a sensor with the fault alone shows, which errs by nothing else."""
    made = sensor_fault(asked)
    fault = made(asked, Sensor(), seed, scales=FaultScales(**scales))
    return fault.replace(fault.distort(truth.copy(), truth, time, 0), time)


def drops(variant: str, severity: float) -> FaultSpec:
    return spec("sensor_dropout", {"variant": variant}, severity)


def recorded(
    faults: Sequence[FaultSpec], recording: Recording, edges: Iterable[int] = (), unit: Unit = UNIT
) -> Recorded:
    """N rows of waves beyond the relief pressure, measured between the edges and joined."""
    time = np.arange(N) * recording.period
    wave = np.sin(2.0 * np.pi * 1.3 * time)
    truth = dict.fromkeys(MEASURED, 4e6 * wave) | {"pump_angle": 30.0 * wave, "position": 0.01 * wave}
    truth |= {"oil_temperature": 40.0 + time} | dict.fromkeys(KNOWN, 10.0 * wave)
    recorder = Recorder(unit, list(faults), recording, seed=11)
    blocks = [
        recorder.measure({c: v[i:j] for c, v in truth.items()}, time[i:j])
        for i, j in pairwise([0, *sorted(edges), N])
    ]
    assert recorder.row == N
    joined = {c: np.concatenate([b.columns[c] for b in blocks]) for c in blocks[0].columns}
    return Recorded(
        np.concatenate([b.time for b in blocks]), joined, np.concatenate([b.kept for b in blocks])
    )


def changed(one: Recorded, other: Recorded) -> set[str]:
    assert one.columns.keys() == other.columns.keys()
    assert one.time.tobytes() == other.time.tobytes() and one.kept.tobytes() == other.kept.tobytes()
    return {c for c, values in one.columns.items() if values.tobytes() != other.columns[c].tobytes()}


BUSY = UNIT.model_copy(deep=True)
"""A sensor of every kind: a lag and band of each order of size, tones, shaft orders, a loop, a range."""
BUSY.sensors["pressure_1"] = Sensor(noise=3e3, bandwidth_hz=20.0, resolution=200.0, gain=1.01, zero=5e3)
BUSY.sensors["oil_temperature"] = Sensor(noise=0.1, bandwidth_hz=0.5)
BUSY.sensors["pump_speed"] = Sensor(noise=0.2, resolution=0.05, tones=[(50.0, 0.1)])


@pytest.mark.parametrize(("name", "way"), WAYS, ids=IDS)
def test_only_its_channel_changes_in_any_log_and_nothing_at_severity_nought(name, way) -> None:
    rate = RATES[WAYS.index((name, way)) % len(RATES)]
    for channels, struck in ((None, "pressure_difference"), (TWO_CHAMBERS, "pressure_1")):
        recording = Recording(rate=rate, channels=channels, nan_bursts_per_minute=60.0, jitter=1e-6)
        sound = recorded([], recording)
        assert changed(recorded([spec(name, way, 0.0)], recording), sound) == set()
        faulty = recorded([spec(name, way, onset=0.4)], recording)
        assert changed(faulty, sound) == {struck}
        values, before = faulty.columns[struck], sound.time < 0.3999
        np.testing.assert_array_equal(values[before], sound.columns[struck][before])
        assert before.sum() > 300
        np.testing.assert_array_equal(np.isnan(values), np.isnan(sound.columns[struck]))
    assert np.count_nonzero(faulty.kept) == pytest.approx(N * min(rate / 1000.0, 1.0), rel=0.02)


BLOCKWISE = [*WAYS, ("position_sensor_slip", {}), ("sensor_dropout", {"variant": "held"})]


@pytest.mark.parametrize(("name", "way"), BLOCKWISE)
def test_any_blocks_give_the_same_bits(name, way) -> None:
    profile = PROFILES[BLOCKWISE.index((name, way)) % len(PROFILES)]
    asked = spec(name, way, 0.7, onset=0.2, profile=profile, ramp=1.0, period=0.3)
    cuts = np.random.default_rng(1).integers(0, N, 40).tolist()
    # An encoder slips from one millisecond to the next, so blocks of its log are whole ones.
    lossy = {"nan_bursts_per_minute": 60.0, "dropped": 0.05, "late": 0.05, "jitter": 5e-6}
    for rate in (1000,) if name == "position_sensor_slip" else (1000, 2000):
        recording = Recording(rate=rate, load_force=True, **lossy)
        whole = recorded([asked], recording, unit=BUSY)
        assert changed(recorded([asked], recording, cuts, BUSY), whole) == set()
    assert changed(recorded([asked], recording, range(900, 1100), BUSY), whole) == set()
    assert len(changed(recorded([], recording, unit=BUSY), whole)) == 1


@pytest.mark.parametrize(("name", "way"), WAYS, ids=IDS)
def test_a_users_figure_counts_instead_of_the_catalogues(name, way) -> None:
    """Doubled it does what severity 1 does with the usual one, at severity 0.5; a limit does not."""
    truth, time = 4e6 * np.sin(np.arange(N) * 1e-2), np.arange(N) * 1e-3
    half = shown(spec(name, way, 0.5), truth, time)
    by_figure = (
        shown(spec(name, way, 0.5), truth, time, **{figure.name: 2.0 * figure.value})
        for figure in CATALOGUE[name].figures
    )
    doubled = [values for values in by_figure if not np.array_equal(values, half)]
    assert len(doubled) == 1, "each way has one figure"
    if way.get("variant") != "clipped":
        np.testing.assert_allclose(doubled[0], shown(spec(name, way), truth, time))


@pytest.mark.parametrize("severity", [0.3, 1.0])
def test_a_gain_errs_by_the_bias_at_the_relief_pressure(severity) -> None:
    relief = UNIT.accumulator.relief_pressure
    truth, time = np.linspace(-relief, relief, 2001), np.arange(2001) * 1e-3
    error, bias = (
        shown(spec("pressure_sensor_bias", {"law": law}, severity), truth, time) - truth
        for law in ("gain", "zero")
    )
    np.testing.assert_allclose(np.polyfit(truth, error, 1)[1], 0.0, atol=1e-3)
    assert error[-1] == pytest.approx(bias[-1], rel=0.01) == pytest.approx(-error[0], rel=0.01)
    assert error[-1] == pytest.approx(250e3 * severity, rel=0.01)


@pytest.mark.parametrize("severity", [0.4, 1.0])
def test_hysteresis_makes_a_loop_of_its_width(severity) -> None:
    """Of a play of ±h under a swing of ±A: the loop is a parallelogram, 2h wide and 2(A - h) high."""
    swing, half, time = 1e6, 250e3 * severity, np.arange(3000) * 1e-3
    truth = swing * np.sin(2.0 * np.pi * time)
    values = shown(spec("pressure_sensor_bias", {"law": "hysteresis"}, severity), truth, time)
    error, last = values - truth, slice(1999, 3000)
    area = np.trapezoid(values[last], truth[last])
    assert abs(area) == pytest.approx(4.0 * half * (swing - half), rel=0.01)
    assert np.abs(error).max() == pytest.approx(half, rel=1e-9)
    assert np.ptp(values[last]) == pytest.approx(2.0 * (swing - half), rel=1e-4)
    np.testing.assert_allclose(error[[2000, 2500]], [-half, half], err_msg="too little rising, else too much")


def drifted(law: str, severity: float, time: np.ndarray, seed: int = 3, **more: Any) -> np.ndarray:
    asked = spec("pressure_sensor_drift", {"law": law}, severity, **more)
    return shown(asked, np.zeros(time.size), time, seed)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("severity", [0.4, 1.0])
def test_drifts_meet_after_fifty_seconds(severity, rate) -> None:
    time = np.arange(int(51.0 * rate)) / rate
    root, settling, line = (drifted(law, severity, time) / severity for law in ("root", "settling", "line"))
    after_1, after_12, after_25, after_50 = (int(t * rate) for t in (1.0, 12.5, 25.0, 50.0))
    assert line[after_50] == pytest.approx(250e3, rel=1e-3) == pytest.approx(root[after_50], rel=1e-3)
    assert root[after_1] == pytest.approx(35e3, rel=0.02)
    assert root[after_12] == pytest.approx(125e3, rel=1e-3), "half in a quarter of the time"
    assert settling[after_50] == pytest.approx(0.95 * 250e3, rel=1e-3)
    # A first-order lag's step: how fast it goes falls in proportion to what is left.
    constant = ((250e3 - settling) / np.gradient(settling, time))[[after_1, after_25]]
    np.testing.assert_allclose(constant, 16.7, rtol=0.01)


def test_a_walks_rms_reaches_the_line_after_fifty_seconds() -> None:
    time = np.arange(5001) * 1e-2
    walks = np.array([drifted("walk", 0.6, time, seed) for seed in range(600)]) / 0.6
    # The standard error of a deviation from 600 is 3 %.
    for after, expected in ((1250, 125e3), (5000, 250e3)):
        assert np.sqrt(np.mean(walks[:, after] ** 2)) == pytest.approx(expected, rel=0.1)
    steps = np.diff(walks[:, ::500]).T
    assert np.abs(np.corrcoef(steps) - np.eye(len(steps))).max() < 0.2, "steps know nothing of each other"
    # Sampled four times as often it is as wide.
    often = [drifted("walk", 1.0, np.arange(5001) * 2.5e-3, seed)[-1] for seed in range(600)]
    assert np.std(often) == pytest.approx(125e3, rel=0.1)


@pytest.mark.parametrize("law", ["root", "settling"])
def test_a_drift_that_is_interrupted_goes_on_where_it_was(law) -> None:
    time = np.arange(20_001) * 1e-3
    broken = drifted(law, 1.0, time, profile="intermittent", period=2.0, duty=0.5)
    whole = drifted(law, 1.0, time)
    for pieces in (1, 4, 9):
        assert broken[2000 * pieces - 500] == pytest.approx(whole[1000 * pieces], rel=2e-3)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("severity", [0.2, 1.0])
def test_noise_is_white_and_five_per_cent_of_the_range(severity, rate) -> None:
    recording = Recording.perfect().model_copy(update={"rate": rate})
    sound, faulty = (recorded(faults, recording) for faults in ([], [drops("noisy", severity)]))
    noise = (faulty.columns["pressure_difference"] - sound.columns["pressure_difference"])[sound.kept]
    loop = UNIT.sensor("pressure_difference").loop
    error = 4.0 / np.sqrt(noise.size)
    assert np.std(noise) == pytest.approx(0.05 * (loop.high - loop.low) * severity, rel=error)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < error


@pytest.mark.parametrize("severity", [0.2, 1.0])
def test_a_sticking_reading_climbs_a_slope_in_steps_of_its_band(severity) -> None:
    band, time = 250e3 * severity, np.arange(4000) * 1e-3
    truth = 1.0 + 0.999e6 * time  # a little less than 1 kPa a row, so that no step is just the band
    step = (band / 1e3 + 1.0) * 999.0
    values = shown(drops("sticking", severity), truth, time)
    steps = np.diff(values)
    np.testing.assert_allclose(steps[steps != 0.0], step)
    assert np.count_nonzero(steps) == int(truth[-1] // step) > 5
    assert values[0] == truth[0] and (truth - values).min() == 0.0 and (truth - values).max() <= band
    # Swings within the band do not show at all.
    assert not shown(drops("sticking", severity), 0.99 * band * np.sin(9.0 * time), time).any()


@pytest.mark.parametrize(("severity", "limit"), [(0.25, 2.58e6), (0.5, 1.72e6), (1.0, 0.0)])
def test_a_saturated_reading_ends_at_its_limit_and_is_right_below(severity, limit) -> None:
    truth, time = np.linspace(-4e6, 4e6, 801), np.arange(801) * 1e-3
    values = shown(drops("clipped", severity), truth, time)
    assert values.max() == pytest.approx(limit, abs=1.0)
    np.testing.assert_array_equal(values[truth < limit - 1.0], truth[truth < limit - 1.0])
    assert UNIT.accumulator.relief_pressure * (1.0 - severity) == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("rate", [1000, 2000])
@pytest.mark.parametrize("severity", [0.25, 1.0])
def test_late_samples_age_and_catch_up(severity, rate) -> None:
    time = np.arange(60 * rate) / rate
    age = time - shown(drops("late", severity), time, time)
    longest = 20e-3 * severity
    assert age.min() == 0.0 and longest - 1.001 / rate < age.max() < longest
    # It is held, or it has caught up: nothing between.
    steps = np.diff(age)
    held = np.isclose(steps, 1.0 / rate, rtol=1e-3)
    np.testing.assert_array_equal(age[1:][~held], 0.0)
    # Waits are even up to the longest, rounded up to whole rows: of n rows at most, n·(n + 1)/2 in n of them,
    # the sum of whose ages is that of 0 + … + k - 1 for each k.
    rows = np.arange(1, round(longest * rate) + 1)
    expected = np.sum(rows * (rows - 1) / 2) / rows.sum() / rate
    assert age.mean() == pytest.approx(expected, rel=0.03)


def measured(n: int, asked: FaultSpec) -> dict[str, np.ndarray]:
    """Columns of a long run at rest with a fault."""
    recorder = Recorder(UNIT, [asked], Recording.perfect(), seed=2)
    return recorder.measure({c: np.zeros(n) for c in MEASURED}, np.arange(n) * 1e-3)[1]


@pytest.mark.parametrize("severity", [0.05, 0.3, 0.7, 1.0])
def test_a_dropout_takes_the_share_of_time_that_its_severity_says(severity: float) -> None:
    lost = np.isnan(measured(600_000, drops("missing", severity))["pressure_difference"])
    # 0.1 s of memory: 3000 independent pieces, so the share is known to ±2.7 % of a unit (3 deviations).
    assert lost.mean() == pytest.approx(severity, abs=0.03)
    if severity < 1.0:
        bursts = np.count_nonzero(np.diff(lost.astype(int)) == 1)
        assert lost.sum() * 1e-3 / bursts == pytest.approx(0.1 / (1.0 - severity), rel=0.25)


def test_what_a_dropout_leaves_in_the_log() -> None:
    n = 60_000
    found = {v: measured(n, spec("sensor_dropout", {"variant": v}, 0.5, onset=0.2)) for v in DROPOUTS}
    healthy = measured(n, spec("sensor_dropout", {}, 0.0))
    lost = np.isnan(found["missing"]["pressure_difference"])
    assert not lost[:200].any()
    for variant, (channel, _) in DROPOUTS.items():
        for other in set(healthy) - {channel}:
            np.testing.assert_array_equal(found[variant][other], healthy[other])
    np.testing.assert_array_equal(np.isnan(found["position_missing"]["position"]), lost)
    # A broken loop carries no current: 4 mA below the live zero, thesis eq. A.4.
    broken = found["broken_loop"]["pressure_difference"]
    np.testing.assert_allclose(broken[lost], -1.724e6, rtol=2e-4)
    np.testing.assert_array_equal(broken[~lost], healthy["pressure_difference"][~lost])
    held, true = found["held"]["pressure_difference"], healthy["pressure_difference"]
    last_seen = np.maximum.accumulate(np.where(lost, 0, np.arange(n)))
    np.testing.assert_array_equal(held, true[last_seen])


def test_a_slip_jumps_once_a_second_by_a_millimetre_and_stays_in_its_play() -> None:
    slips = spec("position_sensor_slip", {}, onset=10.0)
    offset = position_offset([slips], 0, 3_600_000, seed=4)
    jumps = np.diff(offset)
    struck = np.flatnonzero(jumps)
    assert struck[0] >= 9_999 and np.abs(offset).max() <= PLAY
    # 3590 expected, deviation 60.
    assert abs(struck.size - 3590) < 240
    sizes = np.abs(jumps[struck])
    inside = np.abs(offset[struck]) < PLAY - 1.5e-3
    # Two slips within one millisecond add up; 3.6 are expected in 3600.
    assert np.sum((sizes[inside] < 0.499e-3) | (sizes[inside] > 1.501e-3)) <= 12
    assert sizes[inside].mean() == pytest.approx(1e-3, rel=0.05)
    assert 0.4 < (jumps[struck] > 0.0).mean() < 0.6
    # All over the play: a walk between walls is as often in one half as in the other.
    assert (offset > 0.0).mean() == pytest.approx(0.5, abs=0.2)
