"""Every simulated fault: does nothing at severity 0, and what the catalogue says at severity 1."""

import numpy as np
import pytest
from fault_case import ONSET, UNITS, Case, port_pressure, run
from fault_checks import CHECKS
from hypothesis import given
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.plant.duty import Strokes
from fdd.plant.faults.spec import SIMULATED, FaultSpec, parse_fault
from fdd.plant.load import ConstantLoad
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import Simulation, simulate

UNIT = UNITS[1]
AXES = [1, pytest.param(2, marks=pytest.mark.slow)]
CHOICES = [
    (name, side, variant)
    for name in SIMULATED
    for side in (CATALOGUE[name].sides or (None,))
    for variant in (CATALOGUE[name].variants or (None,))
]


@pytest.fixture(scope="module")
def healthy() -> dict[int, Simulation]:
    return {axis: run(axis=axis) for axis in (1, 2)}


def test_every_simulated_fault_has_a_check():
    assert set(CHECKS) == set(SIMULATED) == set(CATALOGUE) - {"unknown"}


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("name", "side", "variant"), CHOICES)
def test_severity_zero_is_healthy_bit_for_bit(healthy, name, side, variant, axis):
    spec = FaultSpec(fault=name, severity=0.0, onset=ONSET, side=side, variant=variant, axis=axis)
    sound, faulty = healthy[axis].samples, run(spec, axis=axis).samples
    assert set(faulty.channels) == set(sound.channels)
    for channel in sound.channels:
        assert np.array_equal(faulty[channel], sound[channel], equal_nan=True), channel


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(("name", "side", "variant"), CHOICES)
def test_severity_one_is_what_the_catalogue_says(healthy, name, side, variant, axis):
    spec = FaultSpec(fault=name, severity=1.0, onset=ONSET, side=side, variant=variant, axis=axis)
    faulty, sound = run(spec, axis=axis), healthy[axis]
    case = Case(spec, faulty, sound)
    CHECKS[name](case)
    before = faulty.truth.time < ONSET
    for channel in sound.samples.channels:
        a, b = faulty.samples[channel][before], sound.samples[channel][before]
        # A band limit looks some samples ahead in its noise only, never in the signal.
        assert np.array_equal(a, b, equal_nan=True), channel
    np.testing.assert_array_equal(faulty.truth.severity[name][case.after], 1.0)
    np.testing.assert_array_equal(faulty.truth.severity[name][before], 0.0)
    label = faulty.labels[0]
    assert (label["fault"], label["severity"], label["onset_s"]) == (name, 1.0, ONSET)
    assert label["family"] == CATALOGUE[name].family
    assert (label["side"], label["variant"], label["axis"]) == (spec.side, spec.variant, axis)


def test_faults_act_together():
    specs = [
        FaultSpec(fault="internal_leakage", severity=0.5, onset=1.0),
        FaultSpec(fault="aeration", severity=0.5, onset=2.0),
        FaultSpec(fault="pressure_sensor_bias", severity=0.5),
    ]
    both = run(*specs)
    alone = run(*specs[:2])
    assert len(both.labels) == 3
    assert np.array_equal(both.truth["position"], alone.truth["position"])
    last = both.truth["leakage"][-1], both.truth["bulk_modulus"][-1]
    assert last[0] == pytest.approx(UNIT.pump.total_leakage + 6e-12, rel=1e-9)
    assert last[1] < 0.7 * UNIT.oil.bulk_modulus


def test_thin_oil_leaks_more_through_the_fault_too():
    scenario = Scenario(
        duration=0.1, oil_temperature=70.0, faults=[{"fault": "internal_leakage", "severity": 1.0}]
    )
    hot = simulate(UNIT, scenario).truth["leakage"][0]
    assert hot > 2.0 * (UNIT.pump.total_leakage + 12e-12)


@pytest.mark.parametrize("order", [1, -1])
def test_degraded_oil_leaks_through_the_fault_too_in_either_order(order):
    faults = [{"fault": "internal_leakage", "severity": 1.0}, {"fault": "oil_degradation", "severity": 1.0}]
    scenario = Scenario(
        duration=0.1, oil_temperature=UNIT.oil.reference_temperature, faults=faults[::order],
        load=ConstantLoad(level=2000.0),
    )  # fmt: skip
    truth = simulate(UNIT, scenario).truth
    drop = abs(truth["port_difference"][0])
    assert drop > 1e6, "where the orifice is turbulent"
    # The orifice's tenth, counted at 1 MPa, does not feel the viscosity; its secant falls with the root.
    expected = 2.0 * (UNIT.pump.total_leakage + 10.8e-12) + 1.2e-12 / np.sqrt(drop / 1e6)
    assert truth["leakage"][0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("air", [0.0, 1.0])
@pytest.mark.parametrize(("side", "load"), [(1, -2500.0), (2, 2500.0)])
def test_a_clogged_valve_cavitates_above_vacuum_and_converges(air, side, load):
    """The pump starves instead of emptying a chamber; steps a quarter as long give the same pressures."""
    # Little charge and a case that drains what the clogged valve does not bring back.
    accumulator = UNIT.accumulator.model_copy(update={"charge_pressure": 20e3, "case_cracking_pressure": 1e3})
    pump = UNIT.pump.model_copy(update={"case_leakage": 1.5 * UNIT.pump.total_leakage})
    unit = UNIT.model_copy(update={"accumulator": accumulator, "pump": pump})
    faults = [
        {"fault": "check_valve_clogged", "severity": 1.0, "side": side},
        {"fault": "aeration", "severity": air},
    ]
    scenario = Scenario(
        duration=6.0, duty=Strokes(rate=0.1), load=ConstantLoad(level=load), faults=faults,
        recording=Recording.perfect(), charge_factor=0.7, ambient=50e3,
    )  # fmt: skip
    coarse, fine = (simulate(unit, scenario, refine=k).truth for k in (1.0, 4.0))
    for name in ("pressure_1", "pressure_2"):
        assert coarse[name].min() > -50e3
        assert np.sqrt(np.mean((coarse[name] - fine[name]) ** 2)) < 2e3
    # At the pump's own port, which the line's losses put below the chamber.
    lowest = port_pressure(coarse, side).min() + 50e3
    assert lowest > 0.0
    # With little air as far as the pump starves; much air expands, but falls below ambient all the same.
    assert lowest < (18e3 if air == 0.0 else 50e3)
    assert np.abs(coarse["oil_mass"] / coarse["oil_mass"][0] - 1.0).max() < 1e-6


# Profiles in time.


@given(
    severity=st.floats(0.0, 1.0),
    onset=st.floats(0.0, 50.0),
    profile=st.sampled_from(["step", "ramp", "intermittent"]),
    ramp=st.floats(0.1, 100.0),
    period=st.floats(0.1, 20.0),
)
def test_profiles_stay_between_zero_and_severity_and_start_at_the_onset(
    severity, onset, profile, ramp, period
):
    spec = FaultSpec(
        fault="aeration", severity=severity, onset=onset, profile=profile, ramp=ramp, period=period
    )
    time = np.arange(0.0, 100.0, 0.013)
    over = spec.over(time)
    assert np.all((over >= 0.0) & (over <= severity))
    assert not over[time < onset - 1e-6].any()
    if profile != "intermittent":
        assert np.all(np.diff(over) >= 0.0)


def test_profiles_by_hand():
    time = np.array([0.0, 4.9, 5.0, 6.0, 7.0, 8.9, 9.0, 10.0])

    def over(**parameters):
        return FaultSpec(fault="aeration", severity=0.8, onset=5.0, **parameters).over(time)

    np.testing.assert_allclose(over(), [0, 0, 0.8, 0.8, 0.8, 0.8, 0.8, 0.8])
    np.testing.assert_allclose(over(profile="ramp", ramp=4.0), [0, 0, 0, 0.2, 0.4, 0.78, 0.8, 0.8])
    np.testing.assert_allclose(
        over(profile="intermittent", period=4.0, duty=0.25), [0, 0, 0.8, 0, 0, 0, 0.8, 0]
    )


def test_an_intermittent_drift_keeps_what_has_drifted():
    spec = FaultSpec(
        fault="pressure_sensor_drift", severity=1.0, onset=1.0, profile="intermittent", period=2.0, duty=0.5
    )
    added = run(spec).samples["pressure_difference"] - run().samples["pressure_difference"]
    assert np.nanmedian(added[-500:]) == pytest.approx(2 * 5e3, abs=300.0)


# What a user may write.


def test_the_command_lines_fault_is_read_whole():
    spec = parse_fault("check_valve_stuck_open: severity=0.4, onset=20, side=2, profile=ramp, ramp=5")
    assert (spec.severity, spec.onset, spec.side, spec.profile, spec.ramp) == (0.4, 20.0, 2, "ramp", 5.0)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("leak:severity=0.4", "internal_leakage"),
        ("unknown:severity=0.4", "not simulated; the simulated ones: internal_leakage"),
        ("unknown:severity=0.4", "not simulated"),
        ("aeration:severity=1.4", "less than or equal to 1"),
        ("aeration:severity=-0.1", "greater than or equal to 0"),
        ("aeration:severity=nan", "severity"),
        ("aeration:severity=lots", "not a number"),
        ("aeration", "severity is missing"),
        ("aeration:severity=0.4,onset=-1", "onset"),
        ("aeration:severity=0.4,onset=inf", "onset"),
        ("aeration:severity=0.4,sverity=1", "severity, onset"),
        ("aeration:severity", "key=value"),
        ("aeration:severity=0.4,severity=0.5", "twice"),
        ("aeration:severity=0.4,profile=sudden", "step, ramp, intermittent"),
        ("aeration:severity=0.4,side=1", "leave side out"),
        ("aeration:severity=0.4,duty=1.5", "duty"),
        ("check_valve_stuck_open:severity=0.4,side=3", "1, 2"),
        ("check_valve_stuck_open:severity=0.4,side=left", "not a number"),
        ("seal_wear:severity=0.4,variant=wet", "loose, tight"),
    ],
)
def test_wrong_faults_are_told_in_one_line(text, told):
    with pytest.raises(InputError) as caught:
        parse_fault(text)
    line = str(caught.value)
    assert told in line and "\n" not in line and text in line
