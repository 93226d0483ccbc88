"""Every simulated fault: does nothing at severity 0, and what the catalogue says at severity 1."""

from typing import Any

import drive_and_seal_checks  # noqa: F401
import fault_checks  # noqa: F401
import numpy as np
import pytest
from fault_case import CHECKS, ONSET, UNITS, Case, choices, keeps_its_oil, port_pressure, run, sound

from fdd.faults import CATALOGUE
from fdd.plant.details import Details
from fdd.plant.duty import Levels, Strokes
from fdd.plant.faults import SIMULATED, FaultSpec, parse_fault
from fdd.plant.oil import viscosity_ratio
from fdd.plant.rig import ConstantLoad, GustLoad, SpringLoad
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import simulate
from tests.refusal import refused

UNIT = UNITS[1]
CHOICES = choices(SIMULATED)
# The second axis takes its faults as the first one does: one way of each tells that they reach it.
ON_AXIS_2 = {name: (name, *choice) for name, *choice in reversed(CHOICES)}.values()
RUNS = [*((*c, 1) for c in CHOICES), *(pytest.param(*c, 2, marks=pytest.mark.slow) for c in ON_AXIS_2)]


def test_every_simulated_fault_has_a_check():
    """Of all its laws: a check that does not know one fails."""
    assert set(CHECKS) == set(SIMULATED) == set(CATALOGUE) - {"unknown"}


@pytest.mark.parametrize(("name", "side", "variant", "law", "axis"), RUNS)
def test_severity_one_is_what_the_catalogue_says(name, side, variant, law, axis):
    spec = FaultSpec(fault=name, severity=1.0, onset=ONSET, side=side, variant=variant, law=law, axis=axis)
    faulty, healthy = run(spec, axis=axis), sound(axis)
    case = Case(spec, faulty, healthy)
    CHECKS[name](case)
    before = faulty.truth.time < ONSET
    for channel in healthy.samples.channels:
        # A band limit looks some samples ahead in its noise only, never in the signal.
        one, other = (each.samples[channel][before] for each in (faulty, healthy))
        np.testing.assert_array_equal(one, other, err_msg=channel)
    np.testing.assert_array_equal(faulty.truth.severity[name][case.after], 1.0)
    np.testing.assert_array_equal(faulty.truth.severity[name][before], 0.0)
    expected = {"fault": name, "severity": 1.0, "onset_s": ONSET, "family": CATALOGUE[name].family}
    expected |= {"side": side, "variant": variant, "law": law, "axis": axis}
    assert {key: faulty.labels[0][key] for key in expected} == expected


# Little charge and a case that drains what a clogged valve does not bring back.
STORE = UNIT.accumulator.model_copy(update={"charge_pressure": 20e3, "case_cracking_pressure": 1e3})
DRAINING = UNIT.pump.model_copy(update={"case_leakage": 1.5 * UNIT.pump.total_leakage})
EMPTY = UNIT.model_copy(update={"accumulator": STORE, "pump": DRAINING})
STARVING: dict[str, Any] = {
    "duration": 6.0, "duty": Strokes(rate=0.1), "recording": Recording.perfect(), "charge_factor": 0.7,
    "ambient": 50e3,
}  # fmt: skip


@pytest.mark.parametrize("air", [0.0, 1.0])
@pytest.mark.parametrize(("side", "load"), [(1, -2500.0), (2, 2500.0)])
def test_a_clogged_valve_cavitates_above_vacuum_and_converges(air, side, load):
    """The pump starves instead of emptying a chamber; steps a quarter as long give the same pressures."""
    faults = [
        {"fault": "check_valve_clogged", "severity": 1.0, "side": side},
        {"fault": "aeration", "severity": air},
    ]
    scenario = Scenario(load=ConstantLoad(level=load), faults=faults, **STARVING)
    coarse, fine = (simulate(EMPTY, scenario, refine=k).truth for k in (1.0, 4.0))
    for name in ("pressure_1", "pressure_2"):
        assert coarse[name].min() > -50e3
        assert np.sqrt(np.mean((coarse[name] - fine[name]) ** 2)) < 2e3
    # At the pump's own port, which the line's losses put below the chamber.
    lowest = port_pressure(coarse, side).min() + 50e3
    assert lowest > 0.0
    # With little air as far as the pump starves; much air expands, but falls below ambient all the same.
    assert lowest < (18e3 if air == 0.0 else 50e3)
    assert np.abs(coarse["oil_mass"] / coarse["oil_mass"][0] - 1.0).max() < 1e-6


def test_wet_oil_boils_at_a_higher_pressure():
    """Gusts press the shut rod's chamber 2 apart: sound oil has 0.3 kPa of vapour, water 7.4 kPa."""
    unit = EMPTY.model_copy(update={"oil": UNIT.oil.model_copy(update={"air_fraction": 1e-4})})
    clogged = {"fault": "check_valve_clogged", "severity": 1.0, "side": 2, "law": "starved"}
    wet = {"fault": "oil_degradation", "severity": 1.0, "variant": "wet"}
    gusts: dict[str, Any] = {
        "duration": 4.0, "duty": Levels(points=0.0), "load": GustLoad(deviation=1500.0, bandwidth_hz=2.0),
        # Air that comes out of solution would hold the pressure before vapour does.
        "details": Details(air_law="free"), "oil_temperature": 40.0,
        "fault_scales": {"wet_viscosity": 1.0},
    }  # fmt: skip
    low = []
    for faults in ([clogged], [clogged, wet]):
        truth = simulate(unit, Scenario(faults=faults, **{**STARVING, **gusts})).truth
        keeps_its_oil(truth)
        low.append(truth["pressure_2"].min() + 50e3)
    assert 0.3e3 < low[0] < 2e3 and 7.4e3 < low[1] < 20e3


@pytest.mark.parametrize("profile", ["load", "heat"])
def test_a_fault_comes_with_the_load_or_as_the_oil_warms(profile):
    """A leak in proportion to the load, whole from half the relief setting on; or whole 2 K warmer."""
    spec = FaultSpec(fault="internal_leakage", law="laminar", severity=0.8, onset=1.0, profile=profile)
    truth = run(
        spec, duty=Strokes(amplitude=0.06, rate=0.1), load=SpringLoad(rate=5e4), warming=0.5,
        recording=Recording.perfect(),
    ).truth  # fmt: skip
    load = np.abs(truth["pressure_1"] - truth["pressure_2"]) / (0.5 * UNIT.accumulator.relief_pressure)
    heat = (truth["oil_temperature"] - truth["oil_temperature"][0]) / 2.0
    share = np.where(truth.time >= 1.0 - 1e-9, np.clip(load if profile == "load" else heat, 0.0, 1.0), 0.0)
    assert (share == 1.0).any() and ((share > 0.1) & (share < 0.9)).sum() > 500
    np.testing.assert_allclose(truth.severity["internal_leakage"], 0.8 * share, atol=1e-9)
    drop = truth["port_difference"]
    rows = np.abs(drop) > 50e3
    ratio = viscosity_ratio(UNIT.oil, truth["oil_temperature"])
    expected = (UNIT.pump.cross_port_leakage + 0.8 * share * 12e-12) / ratio * drop
    np.testing.assert_allclose(truth["cross_flow"][rows], expected[rows], rtol=1e-5)


COMING = [*zip(CATALOGUE["aeration"].laws, ("random", "load", "intermittent", "exponential"), strict=True)]


@pytest.mark.parametrize(("law", "profile"), COMING)
def test_air_that_comes_and_goes_makes_no_oil(law, profile):
    times = {"onset": 1.0, "period": 0.7, "ramp": 2.0}
    spec = FaultSpec(fault="aeration", severity=1.0, law=law, profile=profile, seed=4, **times)
    truth = run(spec, load=SpringLoad(rate=3e4)).truth
    assert np.ptp(truth.severity["aeration"]) > 0.3
    keeps_its_oil(truth)


def test_profiles_by_hand():
    time = np.array([0.0, 4.9, 5.0, 6.0, 7.0, 8.9, 9.0, 10.0])

    def over(**parameters):
        return FaultSpec(fault="aeration", severity=0.8, onset=5.0, **parameters).over(time)

    np.testing.assert_allclose(over(), [0, 0, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8])
    np.testing.assert_allclose(over(profile="ramp", ramp=4.0), [0, 0, 0, 0.2, 0.4, 0.78, 0.8, 0.8])
    pulses = over(profile="intermittent", period=4.0, duty=0.25)
    np.testing.assert_allclose(pulses, [0, 0, 0.8, 0, 0, 0, 0.8, 0])
    # Of those that go with the plant's state the most.
    assert np.array_equal(over(profile="load"), over()) and np.array_equal(over(profile="heat"), over())
    growth = np.expm1(3.0 * np.array([0.25, 0.5, 0.975])) / np.expm1(3.0)
    np.testing.assert_allclose(over(profile="exponential", ramp=4.0)[3:6], 0.8 * growth)


@pytest.mark.parametrize("duty", [0.2, 0.5, 0.8])
def test_a_random_fault_is_on_for_its_share_and_comes_at_times_without_memory(duty):
    time = np.arange(0.0, 3600.0, 0.01)
    spec = FaultSpec(fault="aeration", severity=0.6, profile="random", period=2.0, duty=duty, seed=3)
    severity = spec.over(time)
    on = severity > 0.0
    assert set(np.unique(severity)) == {0.0, 0.6}
    assert on[0] and np.mean(on) == pytest.approx(duty, abs=0.03)
    comes, goes = (time[1:][np.diff(on.astype(int)) == step] for step in (1, -1))
    assert np.mean(np.diff(comes)) == pytest.approx(2.0, rel=0.06)
    lasted = goes[1:][: comes.size] - comes[: goes.size - 1]
    # Exponentially distributed: deviation as large as the mean.
    assert np.std(lasted) / np.mean(lasted) == pytest.approx(1.0, abs=0.1)
    assert not np.array_equal(spec.model_copy(update={"seed": 4}).over(time), severity)
    assert np.mean(spec.model_copy(update={"duty": 0.9}).over(time) > 0.0) == pytest.approx(0.9, abs=0.03)


def test_the_command_lines_fault_is_read_whole():
    spec = parse_fault("check_valve_stuck_open: severity=0.4, onset=20, side=2, profile=ramp, ramp=5")
    assert (spec.severity, spec.onset, spec.side, spec.profile, spec.ramp) == (0.4, 20.0, 2, "ramp", 5.0)
    assert spec.law == "gap" == spec.label()["law"], "the first"
    spec = parse_fault("internal_leakage:severity=0.4,law=opening,profile=random,period=9,duty=0.2,seed=7")
    assert (spec.law, spec.profile, spec.period, spec.duty, spec.seed) == ("opening", "random", 9.0, 0.2, 7)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("leak:severity=0.4", "internal_leakage"),
        ("unknown:severity=0.4", "not simulated; the simulated ones: internal_leakage"),
        ("aeration:severity=1.4", "less than or equal to 1"),
        ("aeration:severity=nan", "severity"),
        ("aeration", "severity is missing"),
        ("aeration:severity=0.4,sverity=1", "severity, onset"),
        ("aeration:severity=0.4,severity=0.5", "twice"),
        ("aeration:severity=0.4,side=1", "leave side out"),
        ("check_valve_stuck_open:severity=0.4,side=3", "1, 2"),
        ("aeration:severity=0.4,law=orifice", "use one of: exchange, ingress, chamber_1, chamber_2"),
        ("pressure_sensor_bias:severity=0.4,profile=heat", "step, ramp, intermittent, exponential, random"),
    ],
)
def test_wrong_faults_are_told_in_one_line(text, told):
    line = refused(lambda: parse_fault(text))
    assert told in line and text in line
