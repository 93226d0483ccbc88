"""Every simulated fault: does nothing at severity 0, and what the catalogue says at severity 1."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.plant.details import Details
from fdd.plant.duty import Levels, Steps, Strokes
from fdd.plant.faults.spec import SIMULATED, FaultSpec, parse_fault
from fdd.plant.load import ConstantLoad
from fdd.plant.scenario import Control, Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
ONSET = 2.0
CHOICES = [
    (name, side, variant)
    for name in SIMULATED
    for side in (CATALOGUE[name].sides or (None,))
    for variant in (CATALOGUE[name].variants or (None,))
]


def _run(*faults: FaultSpec, duration: float = 5.0, seed: int = 5, load: float = 600.0) -> Simulation:
    scenario = Scenario(
        duration=duration,
        duty=Steps(amplitude=0.04, hold=0.8),
        load=ConstantLoad(level=load),
        faults=list(faults),
        seed=seed,
        oil_temperature=UNIT.oil.reference_temperature,
    )
    return simulate(UNIT, scenario)


@pytest.fixture(scope="module")
def healthy() -> Simulation:
    return _run()


def _leaks(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    added = (faulty.truth["leakage"] - healthy.truth["leakage"])[after]
    np.testing.assert_allclose(added, 12e-12, rtol=1e-9)
    drop = faulty.truth["pressure_difference"]
    rows = after & (np.abs(drop) > 100e3)
    assert rows.sum() > 1000
    # A tenth of the 12 cm³/s at 1 MPa goes with the square root.
    laminar = (UNIT.pump.cross_port_leakage + 10.8e-12) * drop[rows]
    turbulent = 1.2e-6 * np.sign(drop[rows]) * np.sqrt(np.abs(drop[rows]) / 1e6)
    np.testing.assert_allclose(faulty.truth["cross_flow"][rows], laminar + turbulent, rtol=5e-3)


def _lost(run: Simulation, after: np.ndarray) -> float:
    """Oil (m³ at atmospheric pressure) that left the actuator."""
    mass = run.truth["oil_mass"][after]
    return float(mass[0] - mass[-1])


def _over_time(run: Simulation, values: np.ndarray, after: np.ndarray) -> float:
    return float(np.trapezoid(values[after], run.truth.time[after]))


def _drips(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    pressure = faulty.truth[f"pressure_{spec.side}"].clip(0.0)
    assert _lost(faulty, after) == pytest.approx(6e-12 * _over_time(faulty, pressure, after), rel=0.02)
    assert abs(_lost(healthy, after)) < 1e-9
    last = faulty.truth["pressure_accumulator"][-1]
    assert last < healthy.truth["pressure_accumulator"][-1] - 20e3, "the accumulator drains"


def _slips(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    speed, drop = faulty.truth["pump_speed"], faulty.truth["pressure_difference"]
    turning = after & (np.abs(speed) > 30.0)
    share = faulty.truth["pump_flow"][turning] / (UNIT.pump.displacement * speed[turning])
    assert np.mean(share) == pytest.approx(0.98, abs=2e-3)
    ripple = Details().pump_ripple + 0.05
    assert np.sqrt(2.0) * np.std(share) == pytest.approx(0.98 * ripple, rel=0.1)
    pressed = turning & (np.abs(drop) > 100e3)
    leaking = faulty.truth["cross_flow"][pressed] / drop[pressed] - UNIT.pump.cross_port_leakage
    np.testing.assert_allclose(leaking, 12e-14 * np.abs(speed[pressed]), rtol=0.02)


def _drains(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    # The case drain's check valve holds the case 5 kPa above the accumulator while oil comes.
    mean = 0.5 * (faulty.truth["pressure_1"] + faulty.truth["pressure_2"])
    above = mean - faulty.truth["pressure_accumulator"] - UNIT.accumulator.case_cracking_pressure
    rows = after & (above > 20e3)
    assert rows.sum() > 200
    expected = (UNIT.pump.case_leakage + 24e-12) * 2.0 * above[rows]
    np.testing.assert_allclose(faulty.truth["drain_flow"][rows], expected, rtol=0.03)
    assert abs(_lost(faulty, after)) < 1e-9, "it stays inside"


def _weeps(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    case = faulty.truth["pressure_accumulator"] + UNIT.accumulator.case_cracking_pressure
    per_pascal = 1e-6 / 60.0 / 487e3
    assert _lost(faulty, after) == pytest.approx(per_pascal * _over_time(faulty, case, after), rel=0.05)


def _swings(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    """The pump's speed once a turn, over the speed itself: twice its first harmonic over the angle."""
    found = []
    for faults in ([], [spec.model_copy(update={"onset": 0.0})]):
        duty, speed_control = Levels(points=100.0, offset=-0.05), Control(mode="speed")
        truth = simulate(UNIT, Scenario(duration=2.5, duty=duty, control=speed_control, faults=faults)).truth
        steady = truth.time > 1.0
        swing = truth["pump_speed"][steady] / np.mean(truth["pump_speed"][steady]) - 1.0
        found.append(2.0 * abs(np.mean(swing * np.exp(1j * truth["pump_angle"][steady]))))
    assert found[0] < 0.002
    assert found[1] == pytest.approx(0.02, abs=0.01), "the drive's loop takes part of the swing out"


def _wears(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    kind, _, direction = str(spec.variant).partition("_")
    full = 0.35 if kind == "loose" else 2.0
    viscous = (faulty.truth["viscous_friction"] / healthy.truth["viscous_friction"])[after]
    np.testing.assert_allclose(viscous, 0.5 * (1.0 + full) if direction else full, rtol=1e-9)
    assert np.array_equal(faulty.truth["leakage"], healthy.truth["leakage"])
    outside = 1e-14 if kind == "loose" else 0.0
    pressed = sum(_over_time(faulty, faulty.truth[f"pressure_{k}"].clip(0.0), after) for k in (1, 2))
    assert _lost(faulty, after) == pytest.approx(outside * pressed, rel=0.05, abs=1e-11)
    steps = [run.truth["velocity"] * {"reverse": -1.0}.get(direction, 1.0) for run in (faulty, healthy)]
    if direction:  # one direction only, the other as it was
        other = after & (steps[0] < -0.03) & (steps[1] < -0.03)
        sizes = [np.median(np.abs(s.truth["friction_force"][other])) for s in (faulty, healthy)]
        assert sizes[0] == pytest.approx(sizes[1], rel=0.1)
        moving = after & (steps[0] > 0.03) & (steps[1] > 0.03)
    else:
        scale = (faulty.truth["coulomb_friction"] / healthy.truth["coulomb_friction"])[after]
        np.testing.assert_allclose(scale, full, rtol=1e-9)
        moving = after & (np.abs(steps[0]) > 0.03) & (np.abs(steps[1]) > 0.03)
    sizes = [np.median(np.abs(s.truth["friction_force"][moving])) for s in (faulty, healthy)]
    assert (sizes[0] < 0.7 * sizes[1]) if kind == "loose" else (sizes[0] > 1.4 * sizes[1])


def _aerates(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    ratio = (faulty.truth["bulk_modulus"] / healthy.truth["bulk_modulus"])[after]
    assert np.all((ratio > 0.3) & (ratio < 0.5)), "halves to thirds at charge pressure"
    # By the polytropic law itself: 0.025 more air at atmospheric pressure.
    p = UNIT.oil.reference_pressure + 101_325.0
    softer = 0.025 * (101_325.0 / p) ** (1.0 / 1.4) / (1.4 * p)
    np.testing.assert_allclose(
        1.0 / faulty.truth["bulk_modulus"][after], 1.0 / UNIT.oil.bulk_modulus + softer
    )


def _passes(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    drop = faulty.truth["pressure_accumulator"] - faulty.truth[f"pressure_{spec.side}"]
    rows = after & (drop < -30e3)
    assert rows.sum() > 50
    flow = faulty.truth[f"refeed_flow_{spec.side}"][rows]
    np.testing.assert_allclose(flow, -1e-4 * np.sqrt(-drop[rows] / 1e6), rtol=0.06)
    other = 3 - spec.side
    assert faulty.truth[f"refeed_flow_{other}"][after].min() >= 0.0
    assert np.all(healthy.truth[f"refeed_flow_{spec.side}"] >= 0.0)


def _starves(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    side, other = spec.side, 3 - spec.side
    if side == 1:  # the side that the load leaves low: only there is oil refed at all
        healthy, faulty = _run(load=-600.0), _run(spec, load=-600.0)
    assert not faulty.truth[f"refeed_flow_{side}"][after].any()
    assert healthy.truth[f"refeed_flow_{side}"][after].max() > 1e-6
    assert healthy.truth[f"refeed_flow_{other}"].min() >= 0.0
    low = faulty.truth[f"pressure_{side}"][after]
    # Below the accumulator less cracking as never when healthy, yet never below vacuum.
    assert low.min() < healthy.truth[f"pressure_{side}"].min() - 30e3
    assert low.min() > -101_325.0
    assert np.abs(faulty.truth["oil_mass"] / faulty.truth["oil_mass"][0] - 1.0).max() < 1e-6


def _short_circuits(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    drop = faulty.truth["pressure_difference"]
    rows = after & (np.abs(drop) > 30e3)
    assert rows.sum() > 50
    flow = faulty.truth["stuck_relief_flow"]
    assert not healthy.truth["stuck_relief_flow"].any()
    expected = 1e-4 * np.sign(drop[rows]) * np.sqrt(np.abs(drop[rows]) / 1e6)
    np.testing.assert_allclose(flow[rows], expected, rtol=0.06)
    assert np.all(np.abs(flow[after]) <= 1e-4 * np.sqrt(np.abs(drop[after]) / 1e6) + 1e-12)
    assert np.abs(faulty.truth["relief_flow"]).max() < 1e-9, "the other valve stays shut"
    assert np.abs(faulty.truth["oil_mass"] / faulty.truth["oil_mass"][0] - 1.0).max() < 1e-6
    # Against what the pump and the piston leave over: chamber 1's own balance of volume, on average.
    taken = np.mean((faulty.truth["pump_flow"] - flow - faulty.truth["cross_flow"])[after])
    moved = UNIT.cylinder.area_1 * np.mean(faulty.truth["velocity"][after])
    assert taken == pytest.approx(moved, abs=0.1 * np.mean(np.abs(flow[after])))
    assert np.array_equal(faulty.truth["leakage"], healthy.truth["leakage"])


def _changes_viscosity(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    expected = 0.5 if spec.variant == "thin" else 2.0
    for name, factor in (
        ("viscous_friction", expected),
        ("leakage", 1.0 / expected),
        ("coulomb_friction", 1.0),
        ("bulk_modulus", 1.0),
    ):
        ratio = faulty.truth[name][after] / healthy.truth[name][after]
        np.testing.assert_allclose(ratio, factor, rtol=1e-9, err_msg=name)
    drop = faulty.truth["pressure_difference"][after]
    np.testing.assert_allclose(
        faulty.truth["cross_flow"][after], UNIT.pump.cross_port_leakage / expected * drop, rtol=1e-9
    )


def _weakens(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    """The shaft's balance J dω/dt = k·K·i - D·Δp - friction holds with k = 0.7, by least squares."""
    for run, share in ((healthy, 1.0), (faulty, 0.7)):
        truth, drive = run.truth, UNIT.drive
        speed = truth["pump_speed"]
        friction = drive.viscous_friction * speed + Details().pump_coulomb_torque * speed / np.hypot(
            1.0, speed
        )
        # Where the speed is steady for a while, so that its slope over 2 ms is exact.
        slope = np.gradient(speed, truth.time)
        steady = after & (np.abs(slope) < 300.0)
        assert steady.sum() > 1000
        torque = drive.inertia * slope + UNIT.pump.displacement * truth["pressure_difference"] + friction
        electric = drive.torque_constant * truth["motor_current"]
        fitted = (torque[steady] @ electric[steady]) / (electric[steady] @ electric[steady])
        assert fitted == pytest.approx(share, rel=0.02)
    assert np.abs(faulty.truth["motor_current"]).max() <= UNIT.drive.current_limit * (1.0 + 1e-12)
    for name in ("leakage", "viscous_friction", "bulk_modulus"):
        assert np.array_equal(faulty.truth[name], healthy.truth[name]), name


def _is_biased(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    added = (faulty.samples["pressure_difference"] - healthy.samples["pressure_difference"])[after]
    np.testing.assert_allclose(added, 250e3, atol=UNIT.sensors["pressure_difference"].resolution)
    _only_measured(faulty, healthy)


def _drifts(faulty: Simulation, healthy: Simulation, after: np.ndarray, spec: FaultSpec) -> None:
    added = (faulty.samples["pressure_difference"] - healthy.samples["pressure_difference"])[after]
    expected = 5e3 * (faulty.samples.time[after] - ONSET)
    np.testing.assert_allclose(added, expected, atol=UNIT.sensors["pressure_difference"].resolution + 10.0)
    _only_measured(faulty, healthy)


def _only_measured(faulty: Simulation, healthy: Simulation) -> None:
    for name in healthy.truth.columns:
        assert np.array_equal(faulty.truth[name], healthy.truth[name]), name


CHECKS: dict[str, Callable[[Simulation, Simulation, np.ndarray, FaultSpec], None]] = {
    "internal_leakage": _leaks,
    "external_leakage": _drips,
    "pump_wear": _slips,
    "case_drain_seal_failure": _drains,
    "shaft_seal_wear": _weeps,
    "coupling_wear": _swings,
    "seal_wear": _wears,
    "aeration": _aerates,
    "check_valve_stuck_open": _passes,
    "check_valve_clogged": _starves,
    "relief_valve_stuck_open": _short_circuits,
    "oil_degradation": _changes_viscosity,
    "motor_degradation": _weakens,
    "pressure_sensor_bias": _is_biased,
    "pressure_sensor_drift": _drifts,
}


def test_every_simulated_fault_has_a_check():
    assert set(CHECKS) == set(SIMULATED)


@pytest.mark.parametrize(("name", "side", "variant"), CHOICES)
def test_severity_zero_is_healthy_bit_for_bit(healthy, name, side, variant):
    faulty = _run(FaultSpec(fault=name, severity=0.0, onset=ONSET, side=side, variant=variant))
    for channel in healthy.samples.channels:
        assert np.array_equal(faulty.samples[channel], healthy.samples[channel], equal_nan=True), channel


@pytest.mark.parametrize(("name", "side", "variant"), CHOICES)
def test_severity_one_is_what_the_catalogue_says(healthy, name, side, variant):
    spec = FaultSpec(fault=name, severity=1.0, onset=ONSET, side=side, variant=variant)
    faulty = _run(spec)
    # A late row at the onset may lie on either side of its millisecond.
    after = faulty.truth.time > ONSET + 2e-3
    before = faulty.truth.time < ONSET
    CHECKS[name](faulty, healthy, after, spec)
    for channel in healthy.samples.channels:
        a, b = faulty.samples[channel][before], healthy.samples[channel][before]
        # A band limit looks some samples ahead in its noise only, never in the signal.
        assert np.array_equal(a, b, equal_nan=True), channel
    np.testing.assert_array_equal(faulty.truth.severity[name][after], 1.0)
    np.testing.assert_array_equal(faulty.truth.severity[name][before], 0.0)
    label = faulty.labels[0]
    assert (label["fault"], label["severity"], label["onset_s"]) == (name, 1.0, ONSET)
    assert label["family"] == CATALOGUE[name].family
    assert (label["side"], label["variant"]) == (spec.side, spec.variant)


def test_faults_act_together():
    specs = [
        FaultSpec(fault="internal_leakage", severity=0.5, onset=1.0),
        FaultSpec(fault="aeration", severity=0.5, onset=2.0),
        FaultSpec(fault="pressure_sensor_bias", severity=0.5),
    ]
    both = _run(*specs)
    alone = _run(*specs[:2])
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
    scenario = Scenario(duration=0.1, oil_temperature=UNIT.oil.reference_temperature, faults=faults[::order])
    leakage = simulate(UNIT, scenario).truth["leakage"][0]
    # The orifice's tenth, counted at 1 MPa, does not feel the viscosity.
    assert leakage == pytest.approx(2.0 * (UNIT.pump.total_leakage + 10.8e-12) + 1.2e-12, rel=1e-9)


@pytest.mark.parametrize("air", [0.0, 1.0])
@pytest.mark.parametrize(("side", "load"), [(1, -2500.0), (2, 2500.0)])
def test_a_clogged_valve_cavitates_above_vacuum_and_converges(air, side, load):
    """The pump starves instead of emptying a chamber; a quarter of the step gives the same pressures."""
    # Little charge and a case that drains what the clogged valve does not bring back.
    accumulator = UNIT.accumulator.model_copy(update={"charge_pressure": 20e3, "case_cracking_pressure": 1e3})
    pump = UNIT.pump.model_copy(update={"case_leakage": 10.0 * UNIT.pump.case_leakage})
    unit = UNIT.model_copy(update={"accumulator": accumulator, "pump": pump})
    faults = [
        {"fault": "check_valve_clogged", "severity": 1.0, "side": side},
        {"fault": "aeration", "severity": air},
    ]
    scenario = Scenario(
        duration=6.0, duty=Strokes(rate=0.1), load=ConstantLoad(level=load), faults=faults,
        recording=Recording.perfect(), charge_factor=0.7, ambient=50e3,
    )  # fmt: skip
    coarse, fine = (simulate(unit, scenario, substeps=k).truth for k in (10, 40))
    for name in ("pressure_1", "pressure_2"):
        assert coarse[name].min() > -50e3
        assert np.sqrt(np.mean((coarse[name] - fine[name]) ** 2)) < 2e3
    lowest = min(coarse["pressure_1"].min(), coarse["pressure_2"].min()) + 50e3
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
    added = _run(spec).samples["pressure_difference"] - _run().samples["pressure_difference"]
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
