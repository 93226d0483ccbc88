"""Noise by likelihood, and what the innovations say, on logs whose noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reduced_model import PERIOD, Made, reduced_log

from estimators import eha_layout as layout
from estimators.eha_noise import Noise
from fdd.errors import InputError
from fdd.identify.innovations import innovations, prepare
from fdd.identify.likelihood import maximise
from fdd.identify.noise import NoiseFit, NoiseRow, fit_noise, likelihoods, stretches
from fdd.identify.whiteness import ChannelTest, channel_tests, slow_excess
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import noise_of
from fdd.samples import Samples
from fdd.unit import Unit

LEVELS = {
    "force": 3.0, "acceleration": 40.0, "pressure": 5e3, "flow": 3e-7, "position": 4e-6, "angle": 3e-4,
}  # fmt: skip


@pytest.fixture(scope="module")
def unit() -> Unit:
    """Axis A with hardly any friction: its change of sign is what a linearised filter misses most."""
    unit = Unit.load("axis_a")
    for branch in (unit.friction.forward, unit.friction.reverse):
        branch.coulomb = branch.static = 2.0
        branch.viscous = 100.0
    return unit


@pytest.fixture(scope="module")
def truth(unit: Unit) -> Noise:
    return replace(noise_of(unit), **LEVELS)


@pytest.fixture(scope="module")
def made(unit: Unit, truth: Noise) -> list[Made]:
    return [reduced_log(unit, truth, 7.0, seed) for seed in range(3)]


def pressures(log: Samples, change) -> Samples:
    columns = dict(log.columns)
    for name in ("pressure_1", "pressure_2"):
        columns[name] = change(log[name])
    return Samples(log.time, columns)


def pressure_test(unit: Unit, noise: Noise, logs: list[Samples], **steps: float) -> ChannelTest:
    found = [innovations(prepare(log, unit), noise, 1.0) for log in logs]
    return next(t for t in channel_tests(found, steps) if t.channel == "pressure_1")


def names(test: ChannelTest) -> list[str]:
    return [cause.name for cause in test.causes]


# Innovations


@pytest.mark.parametrize("chambers", [True, False])
def test_reconstructed_innovations_are_the_trackers_own(unit: Unit, truth: Noise, chambers: bool) -> None:
    log = prepare(reduced_log(unit, truth, 2.0, 3, chambers=chambers).log, unit)
    records = log.tracker(truth).push(log.block)
    found = innovations(log, truth, 0.5)
    there = np.isfinite(found.nis)
    assert there.mean() > 0.99
    nis = records[-len(found) :, layout.R_NIS]
    # Without the chambers there is one measurement more, of the low side, of next to no weight.
    np.testing.assert_allclose(found.nis[there], nis[there], rtol=1e-6 if chambers else 0.05, atol=1e-3)


def test_a_consistent_filter_passes_every_test(unit: Unit, truth: Noise, made: list[Made]) -> None:
    tests = channel_tests([innovations(prepare(m.log, unit), truth, 1.0) for m in made])
    assert [t.channel for t in tests] == ["position", "pump_angle", "pressure_1", "pressure_2"]
    for test in tests:
        assert test.white, (test.channel, test.words)
        assert test.nis == pytest.approx(1.0, abs=0.05)
        assert test.inside == pytest.approx(0.95, abs=0.01)


def test_nis_of_a_consistent_filter_is_in_its_band_nineteen_times_in_twenty(unit: Unit, truth: Noise) -> None:
    inside = []
    for seed in range(100, 110):
        found = [innovations(prepare(reduced_log(unit, truth, 2.0, seed).log, unit), truth, 1.0)]
        inside += [t.low <= t.nis <= t.high for t in channel_tests(found)]
    # 40 tests at 95 %: 38 ± 1.4; below 33 in one of a thousand.
    assert sum(inside) >= 33


def test_too_much_and_too_little_noise_show_in_nis(unit: Unit, truth: Noise, made: list[Made]) -> None:
    logs = [m.log for m in made[:2]]
    assert pressure_test(unit, replace(truth, pressure=1.5e4), logs).nis < 0.5
    assert pressure_test(unit, replace(truth, pressure=2.5e3), logs).nis > 1.5


# What remains when they are not white


def test_pump_ripple_is_named_with_its_order(unit: Unit, truth: Noise, made: list[Made]) -> None:
    logs = []
    for m in made:
        wave = 2.5e3 * np.sin(11.0 * m.log["pump_angle"] + 0.4)
        logs.append(pressures(m.log, lambda p, wave=wave: p + wave))
    test = pressure_test(unit, truth, logs)
    assert not test.white and names(test)[0] == "ripple"
    assert "order 11" in test.words


def test_a_tone_is_named_with_its_frequency(unit: Unit, truth: Noise, made: list[Made]) -> None:
    wave = 3e3 * np.sin(2.0 * np.pi * 355.0 * made[0].log.time)
    test = pressure_test(unit, truth, [pressures(m.log, lambda p: p + wave) for m in made])
    assert not test.white and names(test)[0] == "tone"
    assert "355 Hz" in test.words


def test_a_sensor_of_limited_bandwidth_is_named(unit: Unit, truth: Noise, made: list[Made]) -> None:
    rng = np.random.default_rng(8)
    logs = []
    for m in made:
        columns = dict(m.log.columns)
        for name, state in (("pressure_1", 4), ("pressure_2", 5)):
            noise = np.convolve(rng.standard_normal(len(m.log) + 6), np.full(7, 1.0 / np.sqrt(7.0)), "valid")
            columns[name] = m.states[:, state] * 1e6 + truth.pressure * noise
        logs.append(Samples(m.log.time, columns))
    test = pressure_test(unit, truth, logs)
    assert not test.white and "coloured noise" in names(test)
    assert "delay" not in names(test) and "quantisation" not in names(test)


def test_quantisation_is_named() -> None:
    """A converter of 12 bits over 100 MPa: at rest the rounding repeats itself, in motion it does not."""
    unit, step = Unit.load("axis_a"), 2.5e4
    for channel in ("pressure_1", "pressure_2"):
        unit.sensors[channel] = unit.sensors[channel].model_copy(update={"noise": 0.0, "resolution": step})
    log = simulate(
        unit, Scenario(duration=12.0, duty={"name": "steps"}, load={"name": "spring"}, seed=3)
    ).samples
    noise = replace(noise_of(unit), pressure=step / np.sqrt(12.0))
    test = pressure_test(unit, noise, [log], pressure_1=step)
    assert not test.white and names(test)[0] == "quantisation"
    # The same log is not blamed on the converter where the converter is not known to be coarse.
    assert "quantisation" not in names(pressure_test(unit, noise, [log], pressure_1=263.5))


def test_a_late_position_is_named_a_delay() -> None:
    unit = Unit.load("axis_a")
    run = simulate(
        unit,
        Scenario(
            duration=10.0,
            duty={"name": "sines", "speed": 150.0, "low_hz": 1.0, "high_hz": 12.0},
            control={"mode": "speed"},
            load={"name": "none"},
            recording={"dropped": 0.0, "late": 0.0, "nan_bursts_per_minute": 0.0},
            seed=4,
        ),
    ).samples
    late = 4
    columns = dict(run.columns)
    columns["position"] = np.concatenate((np.full(late, run["position"][0]), run["position"][:-late]))
    noise = noise_of(unit)
    on_time, delayed = (
        channel_tests([innovations(prepare(log, unit), noise)]) for log in (run, Samples(run.time, columns))
    )
    assert all("delay" not in names(t) for t in on_time)
    named = [t for t in delayed if "delay" in names(t)]
    assert named and all("position and angle" in t.words for t in named)


def test_slow_flow_errors_are_named(unit: Unit, truth: Noise, made: list[Made]) -> None:
    """A filter that trusts its volume balance thirty times more than it may."""
    test = pressure_test(unit, replace(truth, flow=1e-8), [m.log for m in made])
    assert not test.white and "slow flow" in names(test)


def test_slow_excess_is_that_of_the_low_frequencies() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal(100_000)
    drift = np.repeat(rng.choice([-0.1, 0.1], 100), 1000)
    alone, blocks = slow_excess([white], PERIOD)
    assert blocks == 200 and alone == pytest.approx(1.0, abs=0.3)
    # Half a second of it holds 500 samples: 1 + 500 · 0.01.
    assert slow_excess([white + drift], PERIOD)[0] == pytest.approx(6.0, abs=1.5)


# The fit


def test_the_fit_recovers_the_noise_and_beats_the_truth(unit: Unit, truth: Noise, made: list[Made]) -> None:
    start = noise_of(unit)
    pieces = stretches([prepare(m.log, unit) for m in made[:2]], truth)
    fit = maximise(lambda n: likelihoods(pieces, n), start, tuple(LEVELS), 5)
    assert fit.value >= float(np.sum(likelihoods(pieces, truth))) > fit.start_value
    for name, level in LEVELS.items():
        assert getattr(fit.noise, name) == pytest.approx(level, rel=0.25), name
        assert 0.0 < fit.told[name] < 0.25


def test_a_level_that_the_data_does_not_tell_stays(unit: Unit, truth: Noise, made: list[Made]) -> None:
    """Under a force noise of 100 N√s nothing can be said about an encoder's micrometre."""
    noise = replace(truth, force=100.0, position=1e-6)
    pieces = stretches([prepare(m.log, unit) for m in made[:2]], noise)
    fit = maximise(lambda n: likelihoods(pieces, n), noise, ("position",))
    assert fit.told == {} and fit.noise.position == pytest.approx(1e-6, rel=0.05)


def test_a_filter_that_fails_is_no_maximum() -> None:
    def likelihoods_of(noise: Noise) -> np.ndarray:
        u = np.log(noise.flow / 1e-6)
        return np.array([-np.inf if u > 0.1 else -8.0 * u * u, -8.0 * u * u])

    fit = maximise(likelihoods_of, Noise(), ("flow",), 5)
    assert np.isfinite(fit.value) and fit.noise.flow == pytest.approx(1e-6, rel=0.15)
    again = maximise(likelihoods_of, Noise(), ("flow",), 5)
    assert again.noise == fit.noise and again.evaluations == fit.evaluations


@pytest.fixture(scope="module")
def fitted(unit: Unit, made: list[Made]) -> NoiseFit:
    fit = fit_noise([m.log for m in made], unit)
    assert fit is not None
    return fit


def row(fit: NoiseFit, name: str) -> NoiseRow:
    return next(r for r in fit.rows if r.name == name)


def test_nothing_goes_below_what_is_argued(unit: Unit, fitted: NoiseFit) -> None:
    argued = noise_of(unit)
    for r in fitted.rows:
        assert r.argued == getattr(argued, r.name) and r.used >= r.argued and r.why
    assert row(fitted, "force").likelihood < 10.0 and row(fitted, "force").used == 100.0
    assert row(fitted, "angle").used == pytest.approx(LEVELS["angle"], rel=0.25)
    # Flow noise follows what lasts: here it is white, and what lasts says the same as the single steps.
    assert fitted.slow[0] > 1.0 >= fitted.slow[1] or fitted.slow[0] <= 1.0
    assert 1e-7 <= row(fitted, "flow").used < 2.0 * LEVELS["flow"]


def test_the_profile_keeps_what_was_raised_with_its_source(unit: Unit, fitted: NoiseFit) -> None:
    own = unit.model_copy(deep=True)
    own.estimation = fitted.estimation
    again = Unit.from_yaml(own.to_yaml())
    assert again.estimation is not None and again.estimation.known == fitted.estimation.known
    assert "likelihood on" in again.estimation.provenance["angle"].source
    # The likelihood has as much flow noise, but it is not where the number comes from.
    assert "slow scatter" in again.estimation.provenance["flow"].source
    assert "slow scatter" in row(fitted, "flow").why and row(fitted, "angle").why == "likelihood"
    assert again.estimation.std_of("angle") == pytest.approx(row(fitted, "angle").std, rel=1e-3)
    noise, argued = noise_of(again), noise_of(unit)
    for r in fitted.rows:
        assert getattr(noise, r.name) == pytest.approx(r.used, rel=1e-3)
    assert noise.leakage == argued.leakage and noise.air == argued.air


def test_a_profile_without_the_section_is_as_before() -> None:
    unit = Unit.load("axis_a")
    assert unit.estimation is None and "estimation" not in unit.to_yaml()
    assert noise_of(unit).flow == Noise().flow


@pytest.mark.parametrize("text", ["{flow: -1}", "{flow: {value: 1, unit: Pa}}", "{leakage: 0.1}"])
def test_a_wrong_section_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="estimation"):
        Unit.from_yaml(Unit.load("axis_a").to_yaml() + f"estimation: {text}\n")


def test_logs_that_are_too_short_give_no_noise(unit: Unit, truth: Noise) -> None:
    assert fit_noise([reduced_log(unit, truth, 4.0, 1).log], unit) is None


def test_coloured_pressure_sensors_do_not_pass_for_flow() -> None:
    """Sensors of 150 Hz: single steps would have ten times the flow noise, and hide every leak."""
    unit = Unit.load("axis_a")
    for channel in ("pressure_1", "pressure_2"):
        unit.sensors[channel] = unit.sensors[channel].model_copy(update={"noise": 5e3, "bandwidth_hz": 150.0})
    log = simulate(
        unit, Scenario(duration=12.0, duty={"name": "sines"}, load={"name": "spring"}, seed=2)
    ).samples
    unit.sensors["pressure_1"].noise = unit.sensors["pressure_2"].noise = 5e3 * np.sqrt(500.0 / 150.0)
    fit = fit_noise([log], unit)
    assert fit is not None
    assert row(fit, "flow").used < 2.0 * row(fit, "flow").argued
    coloured = [t for t in fit.tests if "coloured noise" in names(t)]
    assert {t.channel for t in coloured} == {"pressure_1", "pressure_2"}
