"""Scenarios: what is refused, what duties, loads and valves are over time; a seed fixes everything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import bilinear

from fdd import Unit, simulate
from fdd.plant import conditions as c
from fdd.plant import programme
from fdd.plant.duty import DUTIES, Levels
from fdd.plant.prepare import axis_conditions, chatter_filter, prepare
from fdd.plant.rig import LOADS, Circuit, ExternalAccumulators, GustLoad, apply, check_charging
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.state import TRUTH
from tests.refusal import refused

AXIS_A, UNIT = Unit.load("axis_a"), Unit.load("axis_b")
RNG = np.random.default_rng(0)
SHUT = {"blocked": True}
OPEN = {"blocked": True, "throttle": 0.5}
BOTH = {"line_1": 1, "line_2": 1}
STILL = {"drive": "still"}
OWN_DRIVE = {"drive": "own", "duty": {"name": "steps"}}
WRONG = [
    ({"duration": -1.0}, "duration"),
    ({"durations": 3.0}, "the parameters are: unit, duration"),
    ({"duration": 5.0, "faults": [{"fault": "aeration", "severity": 0.1, "onset": 5.0}]}, "past the end"),
    ({"faults": [{"fault": "aeration", "severity": 0.1}] * 2}, "twice"),
    ({"duty": {"name": "steps", "hold": 0.0}}, "hold"),
    ({"duty": {"name": "constant_speed"}}, "speed control"),
    ({"oil_temperature": 400.0}, "oil_temperature"),
    ({"oil_temperature": 100.0, "warming": 0.5, "duration": 600.0}, "end at 400"),
    ({"fault_scales": {"free_air": 3.0}}, "free_air"),
    ({"duty": {"name": "levels", "points": 1e4}}, "2000 rad/s"),
    # What contradicts itself: one case for each line of the table in fdd.plant.scenario.
    ({"connect": {"line_1": 1}}, "no partner"),
    ({"partner": {}, "load": {"name": "throttle"}}, "the partner's own throttle"),
    ({"circuit": OPEN, "partner": {"circuit": OPEN}}, "both axes are blocked"),
    ({"circuit": OPEN}, "no partner moves its cylinder"),
    ({"partner": {"circuit": SHUT}}, "hydraulic lock: the partner"),
    ({"partner": {"circuit": SHUT}, "connect": BOTH}, "hydraulic lock"),
    ({"circuit": SHUT, "partner": {}}, "hydraulic lock: the first axis"),
    # Driven by the partner's own drive, and by its own pump over the connect valves.
    (
        {"circuit": SHUT, "duty": {"name": "standstill"}, "control": {"mode": "speed"}, "partner": OWN_DRIVE},
        "hydraulic lock: the first axis",
    ),
    ({"circuit": SHUT, "partner": STILL, "connect": BOTH}, "hydraulic lock: the first axis"),
    ({"circuit": OPEN, "partner": STILL}, "position loop would not see"),
    ({"circuit": {"charging": 1}, "partner": {"circuit": {"charging": "0:0/1:1"}}}, "one charging pump"),
    ({"circuit": {"charging_pressure": 9.7e6}}, "9650000"),
    ({"partner": {"drive": "own"}}, "needs a duty"),
    ({"partner": {"drive": "own", "duty": {"name": "constant_speed"}}}, "its own encoder"),
    ({"faults": [{"fault": "aeration", "severity": 0.1, "axis": 2}]}, "there is no axis 2"),
    ({"circuit": {"by_pass": 1}}, "the parameters are: blocked, bypass"),
]


@pytest.mark.parametrize(("arguments", "told"), WRONG)
def test_wrong_and_contradictory_scenarios_are_told_in_one_line(arguments, told):
    assert told in refused(lambda: Scenario(**arguments))


ALLOWED = {
    "leakage coefficient by throttling (5.2)": {"partner": {**STILL, "circuit": OPEN}},
    "its mirror image": {"circuit": OPEN, "partner": {}},
    "both pumps on one cylinder (4.6.7)": {"partner": {"circuit": OPEN}, "connect": BOTH},
    "charging while leaking (4.6.4)": {"circuit": {"charging": 1, "external_leakage": 0.3}},
    "by-pass on a driving axis (4.6.8)": {"circuit": {"bypass": 1}},
    "a way out that opens late": {"partner": {"circuit": {"blocked": True, "throttle": "0:0/5:1"}}},
    "blocked partner, nothing moves": {"duty": {"name": "standstill"}, "partner": {"circuit": SHUT}},
    "blocked partner, first axis without power": {"power": 0, "partner": {"circuit": SHUT}},
    "a pump against its relief valve": {"circuit": SHUT, "control": {"mode": "speed"}, "partner": STILL},
    "one fault on each axis": {
        "partner": {}, "faults": [{"fault": "aeration", "severity": 0.1, "axis": k} for k in (1, 2)],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", ALLOWED)
def test_what_the_rig_can_do_is_allowed_and_travels(name) -> None:
    scenario = Scenario(**ALLOWED[name])
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


def test_a_duty_beyond_the_stroke_and_a_chamber_empty_within_it_are_refused():
    far = Scenario(duration=1.0, duty=DUTIES["steps"](amplitude=0.2))
    assert "leaves the stroke" in refused(lambda: simulate(UNIT, far))
    small = UNIT.model_copy(update={"cylinder": UNIT.cylinder.model_copy(update={"volume_2": 2e-4})})
    assert "volume_2" in refused(lambda: simulate(small, Scenario(duration=1.0)))


@pytest.mark.parametrize("name", DUTIES)
@pytest.mark.parametrize("mode", ["position", "speed"])
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32), rows=st.integers(1, 9000))
def test_duties_stay_within_their_amplitude_and_rest_first(name, mode, seed, rows):
    duty = DUTIES[name](offset=0.01, lead_in=0.3)
    if name == "mission":  # what its stages are
        duty = duty.model_copy(update={"stages": (DUTIES["steps"](offset=0.01, lead_in=0.3),)})
    setpoint = duty.setpoint(rows, mode == "position", np.random.default_rng(seed))
    assert setpoint.shape == (rows,) and np.isfinite(setpoint).all()
    shuttle = name == "constant_speed"
    middle = 0.01 if mode == "position" and not shuttle else 0.0
    most = max(duty.speeds) if shuttle else duty.amplitude if mode == "position" else duty.speed
    assert np.abs(setpoint - middle).max() <= most * (1.0 + 1e-9)
    assert np.all(setpoint[:300] == middle)


def test_a_ramp_is_followed_with_the_loops_velocity_lag():
    """A P loop on an integrator: the lag is the velocity over Kp·Dp/A."""
    duty = DUTIES["strokes"](rate=0.03, amplitude=0.1)
    out = simulate(UNIT, Scenario(duration=3.0, duty=duty, recording=Recording.perfect()))
    lag = (out.samples["position_setpoint"] - out.truth["position"])[2500]
    gain = 16875.0 * UNIT.pump.displacement / UNIT.cylinder.area_1
    assert lag == pytest.approx(0.03 / gain, rel=0.05)


@pytest.mark.parametrize("name", LOADS)
def test_every_load_acts_and_every_usual_range_is_allowed(name):
    truth = simulate(UNIT, Scenario(duration=3.0, load=LOADS[name](), seed=1)).truth
    quiet = name in ("none", "inertia", "changing")  # the last one changes after a minute
    assert (np.ptp(truth["load_force"]) + np.abs(truth["load_force"]).max() == 0.0) == quiet
    for parameter, ends in LOADS[name].usual.items():
        for end in ends:
            LOADS[name](**{parameter: end})


def test_gusts_have_the_deviation_and_bandwidth_asked_for():
    force = GustLoad(deviation=300.0, bandwidth_hz=2.0, level=50.0).force(600_000, np.random.default_rng(0))
    assert np.std(force) == pytest.approx(300.0, rel=0.06)
    assert np.mean(force) == pytest.approx(50.0, abs=40.0)
    spectrum = np.abs(np.fft.rfft(force - force.mean())) ** 2
    frequency = np.fft.rfftfreq(force.size, 1e-3)
    assert spectrum[frequency < 4.0].sum() > 0.95 * spectrum.sum()


def test_the_truth_is_documented_and_aligned():
    out = simulate(UNIT, Scenario(duration=1.0, recording=Recording(dropped=0.1)))
    assert set(out.truth.columns) == set(TRUTH)
    assert np.array_equal(out.truth.time, out.samples.time) and len(out.samples) < 950
    near = np.abs(out.samples["position"] - out.truth["position"])
    encoder = UNIT.sensors["position"]
    assert np.nanmax(near) <= 0.51 * encoder.resolution + sum(size for _, size in encoder.shaft_orders)


TIMES = st.lists(st.floats(0.0, 3600.0), min_size=1, max_size=12, unique=True).map(sorted)


@given(TIMES, st.data())
def test_a_programme_is_numpys_interpolation(times, data) -> None:
    values = data.draw(st.lists(st.floats(-10.0, 10.0), min_size=len(times), max_size=len(times)))
    asked = np.array(data.draw(st.lists(st.floats(0.0, 4000.0), min_size=1, max_size=30)) + times)
    found = programme(list(zip(times, values, strict=True))).over(asked)
    np.testing.assert_allclose(found, np.interp(asked, times, values), rtol=1e-9, atol=1e-9)
    assert found.min() >= min(values) and found.max() <= max(values)


def test_a_jump_takes_its_second_value_from_that_time_on() -> None:
    found = programme("0:0.2/1:0.2/1:0.9/3:0.5").over(np.array([0.999, 1.0, 2.0, 3.0, 9.0]))
    np.testing.assert_allclose(found, [0.2, 0.9, 0.7, 0.5, 0.5])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([[2, 0], [1, 0]], "time 1 s comes after 2 s"),
        ([[1, 0], [1, 0.5], [1, 1]], "three points at 1 s"),
        ([[-1, 0]], "greater than or equal to 0"),
        ([[1, 2, 3]], "pair"),
        ("0:x/1:2", "number"),
        (float("nan"), "finite"),
        ({"0": 1}, "no programme"),
        ("0:0/3:1.5", "0 (shut, off) to 1"),
    ],
)
def test_a_wrong_programme_is_told_in_one_line_with_its_field(given, told) -> None:
    line = refused(lambda: Circuit(bypass=given))
    assert told in line and "bypass" in line


def test_the_chatter_filter_is_the_one_that_the_thesis_prints() -> None:
    """Eq. 7.5: 4.39e-2, -1.514 and 0.61 as printed; 5.28e-2 there is a misprint of 5.18e-2."""
    b1, b2, a1, a2 = chatter_filter(350.0, 1e-3)
    assert [round(v, 4) for v in (b1, b2, a2)] == [0.0518, 0.0439, 0.6096]
    assert a1 == pytest.approx(-1.5140, abs=1e-4)
    assert (b1 + b2) / (1.0 + a1 + a2) == pytest.approx(1.0, abs=1e-12), "a constant passes unchanged"
    printed = (5.28e-2 + 4.39e-2) / (1.0 - 1.514 + 0.61)
    assert printed > 1.005, "which eq. 7.5 as printed would not"
    tustin = bilinear([350.0**2], [1.0, np.sqrt(2.0) * 350.0, 350.0**2], fs=1e3)[0]
    assert tustin[0] > 0.02, "the rule that the text names has a term without delay; eq. 7.5 has none"


def test_levels_are_held_from_their_time_on_or_joined_by_lines() -> None:
    held = Levels(points=[[0.0, 10.0], [0.3, -20.0], [0.7, 5.0]], lead_in=0.1)
    setpoint = held.setpoint(1000, False, RNG)
    assert setpoint[[0, 99, 100, 399, 400, 799, 800, 999]].tolist() == [0, 0, 10, 10, -20, -20, 5, 5]
    lines = Levels(points="0:0/0.4:0.04", linear=True, offset=-0.01).setpoint(600, True, RNG)
    np.testing.assert_allclose(lines[[0, 100, 399, 599]], [-0.01, 0.0, 0.0299, 0.03], atol=1e-12)


@given(st.lists(st.integers(0, 5000), min_size=1, max_size=20, unique=True).map(sorted))
def test_levels_change_in_exactly_their_millisecond(milliseconds) -> None:
    points = [[k / 1000.0, float(i + 1)] for i, k in enumerate(milliseconds)]
    setpoint = Levels(points=points).setpoint(6000, False, RNG)
    for i, k in enumerate(milliseconds):
        assert setpoint[k] == i + 1
        assert setpoint[max(k - 1, 0)] == max(i, 1)


TIME = np.arange(3000) * 1e-3
ZEROS = np.zeros(TIME.size)


def rows_of(scenario: Scenario, axis: int = 1) -> np.ndarray:
    return axis_conditions(AXIS_A, scenario, TIME, ZEROS, ZEROS, axis=axis)[0]


def changed_by(circuit: Circuit) -> np.ndarray:
    rows = np.zeros((TIME.size, c.COLUMNS))
    apply(circuit, rows, TIME)
    return rows


def test_a_rig_as_it_stands_is_healthy_bit_for_bit() -> None:
    assert rows_of(Scenario()).tobytes() == c.healthy_conditions(AXIS_A, ZEROS, ZEROS).tobytes()


def test_by_pass_and_throttle_add_across_the_cylinder() -> None:
    rows = changed_by(Circuit(bypass="0:0/2:1", throttle=0.5, bypass_flow=2e-4, throttle_flow=1e-4))
    assert np.flatnonzero(rows.any(axis=0)).tolist() == [c.BYPASS]
    np.testing.assert_allclose(rows[[0, 1000, 2500], c.BYPASS], [5e-5, 1.5e-4, 2.5e-4])


def test_the_by_pass_drops_what_the_thesis_says_at_full_flow() -> None:
    """4.4: about 137 kPa at 1.39e-4 m³/s."""
    flow_at_1_mpa = changed_by(Circuit(bypass=1))[0, c.BYPASS]
    assert 1e6 * (1.39e-4 / flow_at_1_mpa) ** 2 == pytest.approx(137e3, rel=0.01)


def test_power_and_valves_go_to_their_own_axis() -> None:
    partner = {"power": "0:1/2:0", "circuit": {"throttle": 1.0}}
    worn = {"fault": "motor_degradation", "severity": 1.0, "axis": 2}
    scenario = Scenario(power=0.8, circuit={"bypass": 0.1}, partner=partner, warming=0.01, faults=[worn])
    one, two = rows_of(scenario), rows_of(scenario, axis=2)
    np.testing.assert_allclose(one[:, c.CURRENT_LIMIT], 0.8)
    np.testing.assert_allclose(two[[0, 1000, 2500], c.CURRENT_LIMIT], [0.8, 0.4, 0.0])
    assert one[0, c.BYPASS] == pytest.approx(0.1 * Circuit().bypass_flow)
    assert two[0, c.BYPASS] == pytest.approx(Circuit().throttle_flow)
    assert np.all(one[:, c.WARMING] == 0.01) and np.all(two[:, c.WARMING] == 0.01)


def test_the_partners_own_speeds() -> None:
    own = {"drive": "own", "duty": {"name": "levels", "points": "0:40/1:-60"}}
    setpoint = prepare(AXIS_A, Scenario(duration=1.5, partner=own)).setpoints[1]
    assert setpoint[[0, 999, 1000, 1499]].tolist() == [40.0, 40.0, -60.0, -60.0]
    for partner in ({"drive": "still"}, {"drive": "same"}):
        assert not prepare(AXIS_A, Scenario(duration=0.01, partner=partner)).setpoints[1].any()


def test_charging_is_checked_against_the_units_pressures() -> None:
    check_charging(Circuit(charging=1), AXIS_A)
    check_charging(Circuit(charging_pressure=1.0), AXIS_A)  # the pump stands
    low = Circuit(charging=1, charging_pressure=0.9 * AXIS_A.accumulator.charge_pressure)
    assert "adds nothing" in refused(lambda: check_charging(low, AXIS_A))
    assert "adds nothing" in refused(lambda: check_charging(Circuit(charging=1), AXIS_A, charge_factor=2.0))
    # 3.44 + 9.30 = 12.74 MPa exceed 10.34 MPa; the bulk-modulus circuit's relief valve protects (4.6.3).
    high = {"charging": 1, "charging_pressure": 9.30e6}
    line = refused(lambda: check_charging(Circuit(**high), AXIS_A))
    assert "exceeds the rated 10.34 MPa" in line and "accumulators" in line
    check_charging(Circuit(**high, accumulators=ExternalAccumulators()), AXIS_A)
    check_charging(Circuit(charging=1, charging_pressure=6.8e6), AXIS_A)
    assert "exceeds the rated" in refused(lambda: rows_of(Scenario(partner={"circuit": high}), axis=2))
