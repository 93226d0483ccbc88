"""Bins: one filter for all channels, whatever is missing and however a log was cut."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt

from fdd import Samples, Unit
from fdd.residuals.bins import BIN_S, COLUMNS, FAST, FRAME_BINS, FRAME_S, PRESLIDING_TRAVEL_M, BinMaker
from fdd.residuals.compiled import LUBRICATION_LAG_S
from fdd.sections import Sensor

UNIT = Unit.load("axis_a")
RATE_HZ = 1000
SECONDS = 3.2


def moving(seconds: float = SECONDS, seed: int = 3) -> Samples:
    """A rigid actuator in smooth motion, with made-up noise on what is not motion."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    angle = 90.0 * np.sin(2.0 * time) + 3.0 * time
    position = UNIT.pump.displacement * angle / UNIT.cylinder.area_1
    columns = {name: rng.normal(size=time.size) for name in FAST}
    columns |= {
        "pump_angle": angle, "pump_speed": np.gradient(angle, time), "position": position,
        "oil_temperature": np.full(time.size, 41.0),
    }  # fmt: skip
    return Samples(time, columns)


def bins_of(samples: Samples, cuts: list[int] | None = None, unit: Unit = UNIT) -> np.ndarray:
    maker = BinMaker(unit)
    edges = itertools.pairwise([0, *sorted(cuts or []), len(samples)])
    parts = [maker.push(samples.rows(a, b))[1] for a, b in edges]
    return np.concatenate([*parts, maker.push(None)[1]])


def column(bins: np.ndarray, name: str) -> np.ndarray:
    return bins[:, COLUMNS[name]]


def test_where_the_position_jumps_it_is_left_out() -> None:
    """Bins that a jump lies in and those beside them; not what is decided after the frames were given."""
    maker, plain = BinMaker(UNIT), bins_of(moving())
    maker.jumps = [(0.305, 0.331, 1.0), (0.9, 0.9, 1.5), (1.2, 1.2, 2.0)]
    bins = np.concatenate([maker.push(moving().rows(0, 1100))[1], maker.push(moving().rows(1100, 3200))[1]])
    gone = np.flatnonzero(np.isnan(column(bins, "position")))
    assert gone.tolist() == [29, 30, 31, 32, 33, 34, 119, 120, 121] and maker.jumps == []
    np.testing.assert_array_equal(column(bins, "pump_angle"), column(plain, "pump_angle")[: len(bins)])


def test_a_bin_is_the_mean_of_its_samples() -> None:
    samples = moving()
    bins = bins_of(samples)
    assert bins.shape == (int(np.ceil(SECONDS / FRAME_S)) * FRAME_BINS, len(COLUMNS))
    for k in range(0, int(SECONDS / BIN_S), 37):
        inside = [i for i, t in enumerate(samples.time) if round(t * 1e6) // round(BIN_S * 1e6) == k]
        for name in FAST:
            sensor = UNIT.sensor(name)
            mean = sum((samples[name][i] - sensor.zero) / sensor.gain for i in inside) / len(inside)
            assert bins[k, COLUMNS[name]] == pytest.approx(mean, rel=1e-9), (name, k)
    assert column(bins, "temperature")[111] == 41.0


def test_a_sensors_zero_and_gain_are_taken_out() -> None:
    samples = moving(1.0)
    bent = UNIT.model_copy(deep=True)
    channel = "pressure_1"
    bent.sensors[channel] = bent.sensor(channel).model_copy(update={"zero": 0.5, "gain": 2.0})
    plain, found = column(bins_of(samples), channel), column(bins_of(samples, unit=bent), channel)
    own = UNIT.sensor(channel)
    np.testing.assert_allclose(found, (plain * own.gain + own.zero - 0.5) / 2.0, rtol=1e-9)


@settings(max_examples=30)
@given(cuts=st.lists(st.integers(1, int(SECONDS * RATE_HZ) - 1), max_size=8))
def test_any_cut_gives_the_same_rows(cuts: list[int]) -> None:
    samples = moving()
    np.testing.assert_array_equal(bins_of(samples, cuts), bins_of(samples))


some_rows = st.sets(st.integers(0, int(SECONDS * RATE_HZ) - 1), max_size=300)


@settings(max_examples=20)
@given(lost=some_rows, blank=some_rows, jitter=st.integers(0, 5))
def test_what_is_missing_shifts_no_channel_against_another(lost: set, blank: set, jitter: int) -> None:
    """A rigid motion closes the volume balance to rounding, whatever is lost of it."""
    samples = moving()
    keep = np.ones(len(samples), dtype=bool)
    keep[list(lost)] = False
    position = samples["position"].copy()
    position[list(blank)] = np.nan
    time = samples.time + 1e-5 * jitter * np.random.default_rng(jitter).uniform(-1.0, 1.0, len(samples))
    columns = {**samples.columns, "position": position}
    bins = bins_of(Samples(time[keep], {c: values[keep] for c, values in columns.items()}))
    sensors = {c: UNIT.sensor(c) for c in ("pump_angle", "position")}
    assert all(s.zero == 0.0 and s.gain == 1.0 for s in sensors.values())
    closes = UNIT.pump.displacement * np.diff(column(bins, "pump_angle"))
    closes -= UNIT.cylinder.area_1 * np.diff(column(bins, "position"))
    known = np.isfinite(closes)
    assert known.sum() > 200
    assert np.abs(closes[known]).max() < 1e-9 * UNIT.pump.displacement


def test_a_channel_that_is_never_there_hides_no_other() -> None:
    samples = moving()
    bins = bins_of(Samples(samples.time, {c: samples[c] for c in ("pump_angle", "position")}))
    assert np.isfinite(column(bins, "pump_angle")[: int(SECONDS / BIN_S)]).all()
    assert np.isnan(column(bins, "motor_current")).all()
    np.testing.assert_allclose(column(bins, "position"), column(bins_of(samples), "position"), rtol=1e-12)


def test_an_early_row_changes_no_later_one() -> None:
    samples = moving()
    late = samples.rows(600, len(samples))
    early = Samples(
        np.concatenate([[0.0], late.time]),
        {c: np.concatenate([samples[c][:1], late[c]]) for c in late.channels},
    )
    one, other = bins_of(late), bins_of(early)
    one, other = one[-len(other) :], other[-len(one) :]
    for name in (*FAST, "temperature", "time"):
        np.testing.assert_array_equal(column(other, name), column(one, name), err_msg=name)
    # A seal knows where it came from until it has slid: twice its give.
    travel = np.nancumsum(np.abs(np.diff(column(one, "position"), prepend=np.nan)))
    slid = column(one, "time") > late.time[0] + 10.0 * LUBRICATION_LAG_S
    slid &= travel > 4.0 * PRESLIDING_TRAVEL_M
    assert slid.sum() > 100
    for name in ("friction", "sliding"):
        np.testing.assert_allclose(column(other, name)[slid], column(one, name)[slid], rtol=0.02)


@pytest.mark.parametrize("cut", [None, [700, 701, 1900]])
def test_the_seal_is_a_stop_operator_whose_yield_is_the_stribeck_curve(cut: list[int] | None) -> None:
    """Against a loop written from its definition: play in the give, and a yield that follows the film."""
    samples = moving()
    f = UNIT.friction
    stiffness = 0.5 * (f.forward.static + f.reverse.static) / PRESLIDING_TRAVEL_M
    force = film = 0.0
    forces, films = [], []
    before_x, before_t = samples["position"][0], samples.time[0] - 1e-3
    for t, x in zip(samples.time, samples["position"], strict=True):
        free = force + stiffness * (x - before_x)
        curve = f.forward if free >= 0.0 else f.reverse
        weight = float(np.exp(-((abs(film) / curve.stribeck_velocity) ** curve.stribeck_exponent)))
        most = curve.coulomb * (1.0 - weight) + curve.static * weight
        force = float(np.clip(free, -most, most))
        speed = (free - force) / stiffness / (t - before_t)
        share = (t - before_t) / (LUBRICATION_LAG_S + t - before_t)  # backward Euler of a first-order lag
        film = film + share * (speed - film)
        forces.append(force)
        films.append(film)
        before_x, before_t = x, t
    bins = bins_of(samples, cut)
    for name, expected in (("friction", forces), ("sliding", films)):
        means = np.reshape(expected, (-1, int(RATE_HZ * BIN_S))).mean(axis=1)
        found = column(bins, name)[: int(SECONDS / BIN_S)]
        np.testing.assert_allclose(found, means, rtol=1e-7, atol=1e-9, err_msg=name)
    slides = np.abs(films) > 0.05
    assert slides.any()
    against = np.sign(forces)[slides] == np.sign(films)[slides]
    assert against.mean() > 0.95, "friction acts against the motion"


@pytest.mark.parametrize("ringing", [0.0, 4e4])
@pytest.mark.parametrize(("rate", "band_hz"), [(1000, None), (200, None), (1000, 150.0), (500, 150.0)])
def test_the_noise_of_a_rows_pressure_is_that_of_its_samples_mean(rate, band_hz, ringing):
    """Though it swings, steps and rings on its oil; a band's counts by its spectral density."""
    rng, time = np.random.default_rng(9), np.arange(60 * rate) / rate
    unit, samples = UNIT.model_copy(deep=True), moving(60.0).rows(0, 1)
    columns = {c: np.interp(time, samples.time, samples[c]) for c in samples.channels}
    swing = 5e5 * np.sin(9.0 * time) + 2e6 * (np.mod(time, 4.0) < 2.0)
    rings = sosfilt(butter(1, (75.0, 95.0), "bandpass", output="sos", fs=rate), rng.normal(size=time.size))
    for k in (1, 2):
        noise = rng.normal(scale=k * 5e3, size=time.size)
        if band_hz is not None:
            noise = sosfilt(butter(8, 1.1 * band_hz, output="sos", fs=rate), noise)
        columns[f"pressure_{k}"] = swing + noise + (1.0, -1.6)[k - 1] * ringing * rings
        unit.sensors[f"pressure_{k}"] = Sensor(noise=k * 3e3)
    bins = bins_of(Samples(time, columns), unit=unit)
    for k in (1, 2):
        alone = column(bins, f"pressure_{k}_noise")[FRAME_BINS:] * np.sqrt(rate * BIN_S)
        # Combinations are 30 degrees apart: a fifth of the ringing, three to six times the noise, is left.
        assert 0.94 <= np.median(alone) / (k * 5e3) <= (1.6 if ringing else 1.06)


@pytest.mark.parametrize("hz", [130.0, 166.3, 283.0])
def test_what_is_faster_than_the_bins_is_hardly_in_a_windowed_current(hz: float) -> None:
    """A fast tone comes out an eighth of what plain means have of it at most; a slow one by the window."""
    samples = moving(seconds=3.0)
    bins = {}
    for f in (hz, 15.0):
        tone = np.cos(2.0 * np.pi * f * samples.time)
        bins[f] = bins_of(Samples(samples.time, {**samples.columns, "motor_current": tone}))
    fast = column(bins[hz], "windowed_current")
    inside = np.arange(fast.size) % FRAME_BINS % (FRAME_BINS - 1) > 0
    assert np.isnan(fast[~inside]).all() and np.isfinite(fast[inside]).all()
    assert np.std(fast[inside]) < np.std(column(bins[hz], "motor_current")) / 8.0
    middle = (np.arange(fast.size) + 0.5) * BIN_S
    seen = np.sinc(0.3) + 0.5 * (np.sinc(-0.7) + np.sinc(1.3))
    slow = column(bins[15.0], "windowed_current")[inside]
    assert slow == pytest.approx(seen * np.cos(2.0 * np.pi * 15.0 * middle[inside]), abs=0.02)
