"""The experiments on logs whose truth is known: closed-form systems, the plant, and its oil."""

import functools

import numpy as np
import pytest
from made_units import calibration_logs, case_of, random_unit
from numpy.typing import NDArray
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

from fdd import Samples, Scenario, Unit
from fdd.identification.experiments import Outcome, Told
from fdd.identification.experiments.bulk_modulus import bulk_modulus
from fdd.identification.experiments.dynamics import fit_pole_pair, half_power_frequency, welch
from fdd.identification.experiments.friction import friction
from fdd.identification.experiments.gain import gain
from fdd.identification.experiments.leakage import leakage
from fdd.identification.experiments.response import frequency_response
from fdd.identification.record import Record, even_record
from fdd.plant import oil as plant_oil
from fdd.plant.details import Details
from fdd.plant.simulate import Simulation, simulate
from fdd.residuals.oil import air_compliance
from reports.thesis.flow import from_profile
from reports.thesis.runs import VOLT, identification_volts, run_speed

Array = NDArray[np.float64]
AXIS_A = Unit.load("axis_a")
RATE = 400.0
GAIN, HZ, ZETA = 3.66e-4, 55.0, 0.12
OMEGA = 2.0 * np.pi * HZ
RUNS = 20
SPEEDS = {"name": "constant_speed", "amplitude": 0.05, "turn": 6.0}
SLOW_TO_FAST = (5.0, 8.0, 20.0, 40.0, 80.0, 150.0, 250.0)


def second_order(noise: float, seed: int, rows: int = 6000) -> Array:
    """Input and output of a pole pair, in coloured noise, each the mean of ten times as many."""
    rng, fine = np.random.default_rng(seed), 10.0 * RATE
    low_pass = butter(4, 120.0, fs=fine, output="sos")
    given = 50.0 * sosfilt(low_pass, np.repeat(rng.choice([-1.0, 1.0], rows), 10))
    pair = cont2discrete(([OMEGA**2 * GAIN], [1.0, 2.0 * ZETA * OMEGA, OMEGA**2]), 1.0 / fine, method="zoh")
    caused = lfilter(np.ravel(pair[0]), pair[1], given)
    coloured = lfilter([1.0, 0.3], [1.0, -0.9], rng.standard_normal(rows))
    given, caused = (x.reshape(-1, 10).mean(axis=1) for x in (given, caused))
    return np.column_stack([given, caused + noise * coloured])


@pytest.mark.parametrize("natural", [30.0, 55.0, 100.0])
def test_intervals_hold_gain_frequency_and_damping(natural):
    """95 % intervals of three facts in 20 noises: fewer than 51 of 60 inside has a chance below 0.001."""
    inside = 0
    for seed in range(RUNS):
        found = fit_pole_pair(welch([second_order(2e-3, seed)], 1.0 / RATE, 1.0), natural)
        miss = np.abs(found.theta - [GAIN, HZ, ZETA, 0.0]) / found.std
        inside += int(np.count_nonzero(miss[:3] < 1.96))
    assert inside >= 51


def told(outcome: Outcome) -> dict[str, Told]:
    return {t.quantity: t for t in outcome.told}


def record(run: Simulation) -> Record:
    return even_record(run.samples, AXIS_A, "log")


@pytest.mark.slow
def test_the_hydraulic_resonance_of_eq_5_22_is_found():
    """Of a plant with viscous friction alone, after two strokes that let the log pass as one."""
    unit = Unit.load("axis_a").model_copy(deep=True)
    for branch in (unit.friction.forward, unit.friction.reverse):
        branch.coulomb, branch.static, branch.viscous = 0.0, 0.0, 800.0
    sharp = Details(pump_ripple=0.0, pump_coulomb_torque=0.0, seal_damping=0.0, check_width=200.0)
    signal = 0.3 * VOLT * identification_volts(12.5, 1)
    command = np.concatenate([np.full(600, 20.0), np.full(600, -20.0), np.zeros(200), signal])
    log = record(run_speed(unit, command, details=sharp, seed=1))
    outcome, eq = frequency_response([log], unit), from_profile(unit, 800.0)
    found = told(outcome)
    natural, damping = found["natural frequency of a pole pair"], found["its damping ratio"]
    assert natural.value == pytest.approx(eq.natural_hz, rel=0.01)
    assert damping.value == pytest.approx(eq.damping / (4.0 * np.pi * eq.natural_hz), rel=0.02)
    assert found["gain by Welch"].value == pytest.approx(eq.numerator / eq.stiffness, rel=0.01)
    assert "55." in natural.note
    assert set(outcome.curves) == {"measured", "pole_pair"}
    fallen = np.linspace(0.1, 150.0, 20_000)
    s = 2j * np.pi * fallen
    size = np.abs(eq.numerator / (s**2 + eq.damping * s + eq.stiffness))
    corner = half_power_frequency(fallen, size, eq.numerator / eq.stiffness)
    bandwidth = found["-3 dB bandwidth by Welch"]
    assert bandwidth.low < corner < bandwidth.high
    assert bandwidth.value == pytest.approx(corner, rel=0.05)


@functools.cache
def drawn(seed: int) -> tuple[Unit, list[Simulation]]:
    """A unit unlike the profile in leakage, displacement and friction; free strokes, and throttled."""
    unit, rng = Unit.load("axis_a").model_copy(deep=True), np.random.default_rng(seed)
    factor = rng.uniform(0.7, 1.5)
    unit.pump.cross_port_leakage *= factor
    unit.pump.case_leakage *= factor
    unit.pump.displacement *= rng.uniform(0.97, 1.03)
    for branch in (unit.friction.forward, unit.friction.reverse):
        factor = rng.uniform(0.8, 1.25)
        branch.coulomb, branch.static = factor * branch.coulomb, factor * branch.static
    speeds = {**SPEEDS, "speeds": tuple(rng.permutation(SLOW_TO_FAST))}
    loaded = {**SPEEDS, "speeds": (60.0, 105.0, 150.0)}
    throttle = {"name": "throttle", "pressure": float(rng.uniform(1e6, 2e6))}
    common = {"duration": 42.0, "control": {"mode": "speed"}}
    return unit, [
        simulate(unit, Scenario(duty=speeds, seed=2 * seed, **common)),
        simulate(unit, Scenario(duty=loaded, load=throttle, seed=2 * seed + 1, **common)),
    ]


@pytest.mark.parametrize("seed", range(2))
def test_leakage_gain_and_slip_of_a_drawn_unit(seed):
    (unit, runs), base = drawn(seed), AXIS_A
    logs = [record(run) for run in runs]
    figures = told(leakage(logs, base))
    leak, share = figures["leakage coefficient, straight line"], figures["volumetric efficiency"]
    pressure, _, _, speed = (w for w in share.note.replace("at ", "").split()[:4])
    flow = unit.pump.displacement * float(speed) * np.pi / 30.0
    arrives = 100.0 * (1.0 - unit.pump.total_leakage * 1e5 * float(pressure) / flow)
    assert share.low - 0.3 < arrives < share.high + 0.3  # its note rounds to three figures
    assert share.high < 99.0 and leak.low < unit.pump.total_leakage < leak.high
    assert leak.high - leak.low < 0.08 * leak.value
    found, true = told(gain(logs, base)), unit.pump.displacement / unit.cylinder.area_1
    for direction in ("forward", "reverse"):
        one, slip = found[f"gain, {direction}"], found[f"slip, {direction}"]
        assert one.low < true < one.high and one.high - one.low < 0.01 * true
        assert slip.value == pytest.approx(unit.pump.cross_port_leakage + unit.pump.case_leakage, rel=0.12)


@pytest.mark.slow
def test_friction_is_that_on_the_piston():
    """Against the plant's own friction force where the piston moves steadily, in two units."""
    inside, count = 0, 0
    for seed in (0, 1):
        run = drawn(seed)[1][0]
        outcome = friction([record(run)], AXIS_A)
        mean = np.ones(40) / 40.0
        for direction, sign in (("forward", 1.0), ("reverse", -1.0)):
            columns = (run.truth[name] for name in ("velocity", "friction_force"))
            v, force = (sign * np.convolve(column, mean, "same") for column in columns)
            steady = np.abs(np.gradient(v, 1e-3)) < 1.0
            curve = outcome.curves[direction]
            for speed, low, high in zip(curve["speed"], curve["low"], curve["high"], strict=True):
                near = steady & (np.abs(v / speed - 1.0) < 0.12)
                if np.count_nonzero(near) >= 200:
                    count, inside = count + 1, inside + int(low < np.median(force[near]) < high)
    assert count >= 12 and inside >= 0.9 * count


def test_what_a_log_does_not_excite_is_said():
    unit = Unit.load("axis_a")
    slow = {**SPEEDS, "speeds": (15.0, 20.0, 30.0), "turn": 10.0}
    log = record(simulate(unit, Scenario(duration=40, duty=slow, control={"mode": "speed"}, seed=4)))
    sentences = {f.__name__: " ".join(f([log], unit).not_told) for f in (friction, leakage, gain)}
    assert "No strokes forward above" in sentences["friction"] and "viscous" in sentences["friction"]
    assert "Load the actuator" in sentences["leakage"]
    assert "Gain forward: fewer than" in sentences["gain"]


def outcome(logs: list[Samples], base: Unit = AXIS_A) -> Outcome:
    return bulk_modulus([even_record(log, base, "log") for log in logs], base)


def with_air(unit: Unit, air: float) -> Unit:
    """The same oil with another share of free air: the oil itself stays as stiff."""
    oil = unit.oil
    soft = float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    oil.bulk_modulus = 1.0 / (1.0 / oil.bulk_modulus + (air - oil.air_fraction) * soft)
    oil.air_fraction = air
    return unit


def hits(found: Outcome, truth: Unit) -> list[bool]:
    """Whether each interval holds the plant's own number."""
    inside = []
    for t in found.told:
        if "free air at" in t.quantity:
            true = truth.oil.air_fraction
        elif "without" in t.quantity:
            true = plant_oil.stiff_bulk_modulus(truth.oil)
        else:
            pressure = float(t.quantity.split(" at ")[1].split()[0]) * 1e5
            true = float(plant_oil.bulk_modulus(truth.oil, pressure))
        inside.append(t.low < true < t.high)
    return inside


@pytest.mark.parametrize("air", [0.001, 0.02])
def test_aeration_shows_at_low_pressure(air: float) -> None:
    truth = with_air(random_unit(2), air)
    found = outcome(calibration_logs(truth, 2))
    assert hits(found, truth) == [True] * 4
    free = next(t for t in found.told if "free air" in t.quantity)
    assert not free.low < AXIS_A.oil.air_fraction < free.high
    assert "profile 0.003" in free.note
    fitted = found.curves["fitted"]
    true = plant_oil.bulk_modulus(truth.oil, fitted["pressure"])
    assert fitted["bulk_modulus"] == pytest.approx(true, rel=0.12)
    assert np.mean((fitted["low"] < true) & (true < fitted["high"])) > 0.9


def test_one_throttled_log_is_enough() -> None:
    found = outcome(case_of(1).logs[2:3])
    assert len(found.told) >= 3 and all(hits(found, case_of(1).truth))


def test_volumes_that_strokes_do_not_tell_widen_the_interval() -> None:
    sines = case_of(1).logs[1:2]
    found = outcome(sines)
    assert any("volumes stay" in note for note in found.notes) and all(hits(found, case_of(1).truth))
    first = found.told[0]
    assert first.high - first.low > 2.0 * 1.96 * 0.15 * first.value
    known = AXIS_A.model_copy(deep=True)
    for name in ("volume_1", "volume_2"):
        known.cylinder.provenance[name].std = 0.02 * getattr(known.cylinder, name)
    sharper = outcome(sines, known).told[0]
    assert sharper.high - sharper.low < 0.5 * (first.high - first.low)


def test_chambers_never_shut_are_said() -> None:
    log = case_of(1).logs[0]
    low = log["pressure_accumulator"]
    never_shut = {"pressure_1": low, "pressure_2": low, "pressure_difference": 0.0 * low}
    found = outcome([log.with_columns(never_shut)])
    assert not found.told and "refeeding" in found.not_told[0] and " 0 % of the time" in found.not_told[0]
