"""Scenarios: what is refused, what duties and loads are, and that a seed fixes everything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.plant.duty import DUTIES, Replay, duty_named
from fdd.plant.load import LOADS, GustLoad, load_named
from fdd.plant.scenario import Control, Recording, Scenario
from fdd.plant.simulate import prepare, simulate
from fdd.plant.truth import TRUTH
from fdd.unit import Unit

UNIT = Unit.load("axis_b")


def _control(duty_name: str, mode: str) -> Control:
    return Control(mode="speed" if duty_name == "constant_speed" else mode)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"duration": -1.0}, "duration"),
        ({"duration": 1e9}, "3600"),
        ({"durations": 3.0}, "the parameters are: unit, duration"),
        ({"duration": 5.0, "faults": [{"fault": "aeration", "severity": 0.1, "onset": 5.0}]}, "past the end"),
        ({"faults": [{"fault": "aeration", "severity": 2.0}]}, "severity"),
        ({"faults": [{"fault": "unknown", "severity": 0.2}]}, "not simulated"),
        ({"faults": [{"fault": "aeration", "severity": 0.1}] * 2}, "twice"),
        ({"duty": {"name": "dance"}}, "steps"),
        ({"duty": {"name": "steps", "hold": 0.0}}, "hold"),
        ({"duty": {"name": "constant_speed"}}, "speed control"),
        ({"load": {"name": "spring", "rate": -3.0}}, "rate"),
        ({"load": {"name": "brick"}}, "spring"),
        ({"oil_temperature": 400.0}, "oil_temperature"),
        ({"oil_temperature": 100.0, "warming": 0.5, "duration": 600.0}, "end at 400"),
        ({"control": {"mode": "force"}}, "position"),
        ({"control": {"rate_gain": -1.0}}, "rate_gain"),
        ({"control": {"filter_cutoff": 4000.0}}, "filter_cutoff"),
        ({"power": 1.5}, "power"),
        ({"fault_scales": {"free_air": 3.0}}, "free_air"),
        ({"duty": {"name": "levels", "points": [[2.0, 0.0], [1.0, 0.0]]}}, "comes after"),
        ({"duty": {"name": "levels", "points": 1e4}}, "2000 rad/s"),
        ({"duty": {"name": "one_way", "out": 0.0}}, "out"),
        ({"recording": {"dropped": 2.0}}, "dropped"),
        ({"details": {"pump_teeth": 0}}, "pump_teeth"),
        ({"seed": -1}, "seed"),
    ],
)
def test_wrong_scenarios_are_told_in_one_line(arguments, told):
    with pytest.raises(InputError) as caught:
        Scenario(**arguments)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_scenarios_travel_as_json():
    scenario = Scenario(
        duration=5.0,
        duty=duty_named("constant_speed", speeds=(40.0, 90.0)),
        control=Control(mode="speed"),
        load=GustLoad(),
        faults=[{"fault": "check_valve_stuck_open", "severity": 0.3, "side": 2}],
    )
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario
    with pytest.raises(InputError, match="duration"):
        Scenario.model_validate({"duration": -1.0})
    with pytest.raises(InputError, match="not simulated"):
        Scenario.model_validate_json('{"faults": [{"fault": "unknown", "severity": 0.1}]}')


def test_a_duty_beyond_the_stroke_and_a_chamber_empty_within_it_are_refused():
    with pytest.raises(InputError, match="leaves the stroke"):
        simulate(UNIT, Scenario(duration=1.0, duty=duty_named("steps", amplitude=0.2)))
    small = UNIT.model_copy(update={"cylinder": UNIT.cylinder.model_copy(update={"volume_2": 2e-4})})
    with pytest.raises(InputError, match="volume_2"):
        simulate(small, Scenario(duration=1.0))


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


@pytest.mark.parametrize("name", DUTIES)
@pytest.mark.parametrize("mode", ["position", "speed"])
def test_the_position_follows_every_duty_within_the_stroke(name, mode):
    written = {"points": "0:60/3:-60"} if (name, mode) == ("levels", "speed") else {}
    scenario = Scenario(
        duration=6.0, duty=DUTIES[name](**written), control=_control(name, mode),
        recording=Recording.perfect(), seed=2,
    )  # fmt: skip
    out = simulate(UNIT, scenario)
    moved = np.ptp(out.truth["position"])
    assert moved < 1e-3 if name in ("standstill", "mission") else moved > 2e-3, "a mission stands by default"
    assert np.abs(out.truth["position"]).max() < 0.5 * UNIT.cylinder.stroke
    assert ("position_setpoint" in out.samples) == (scenario.control.mode == "position")


def test_a_ramp_is_followed_with_the_loops_velocity_lag():
    """A P loop on an integrator: the lag is the velocity over Kp·Dp/A."""
    duty = duty_named("strokes", rate=0.03, amplitude=0.1)
    out = simulate(UNIT, Scenario(duration=3.0, duty=duty, recording=Recording.perfect()))
    lag = (out.samples["position_setpoint"] - out.truth["position"])[2500]
    gain = 16875.0 * UNIT.pump.displacement / UNIT.cylinder.area_1
    assert lag == pytest.approx(0.03 / gain, rel=0.05)


@pytest.mark.parametrize("name", LOADS)
def test_every_load_acts_and_every_usual_range_is_allowed(name):
    scenario = Scenario(duration=3.0, load=load_named(name), seed=1)
    truth = simulate(UNIT, scenario).truth
    quiet = name in ("none", "inertia", "changing")  # the last one changes after a minute
    assert (np.ptp(truth["load_force"]) + np.abs(truth["load_force"]).max() == 0.0) == quiet
    for parameter, ends in LOADS[name].usual.items():
        for end in ends:
            load_named(name, **{parameter: end})


def test_gusts_have_the_deviation_and_bandwidth_asked_for():
    force = GustLoad(deviation=300.0, bandwidth_hz=2.0, level=50.0).force(600_000, np.random.default_rng(0))
    assert np.std(force) == pytest.approx(300.0, rel=0.06)
    assert np.mean(force) == pytest.approx(50.0, abs=40.0)
    spectrum = np.abs(np.fft.rfft(force - force.mean())) ** 2
    frequency = np.fft.rfftfreq(force.size, 1e-3)
    assert spectrum[frequency < 4.0].sum() > 0.95 * spectrum.sum()


def test_the_units_spread_of_friction_varies_from_run_to_run():
    draws = [prepare(UNIT, Scenario(duration=0.01, seed=s)).parameters[0].coulomb_forward for s in range(300)]
    assert np.mean(draws) == pytest.approx(UNIT.friction.forward.coulomb, rel=0.02)
    assert np.std(draws) == pytest.approx(
        UNIT.friction.forward.coulomb * UNIT.friction.trial_spread, rel=0.15
    )


def test_the_truth_is_documented_and_aligned():
    out = simulate(UNIT, Scenario(duration=1.0, recording=Recording(dropped=0.1)))
    assert set(out.truth.columns) == set(TRUTH)
    assert np.array_equal(out.truth.time, out.samples.time) and len(out.samples) < 950
    near = np.abs(out.samples["position"] - out.truth["position"])
    encoder = UNIT.sensors["position"]
    shaken = sum(amplitude for _, amplitude in encoder.shaft_orders)
    assert np.nanmax(near) <= 0.51 * encoder.resolution + shaken


@pytest.mark.parametrize("mode", ["position", "speed"])
def test_replay_gives_each_value_for_a_millisecond_and_holds_the_last(mode):
    values = (0.0, 0.01, -0.02)
    scenario = Scenario(
        duration=0.01, duty=Replay(values=values, offset=0.03), control=Control(mode=mode, gain=100.0),
        recording=Recording.perfect(),
    )  # fmt: skip
    log = simulate(UNIT, scenario).samples
    expected = np.array([*values, *[values[-1]] * 7])
    if mode == "position":
        assert np.array_equal(log["position_setpoint"], expected)
    else:
        assert np.allclose(log["command"], expected, atol=UNIT.sensor("command").resolution + 1e-12)
    assert log["position"][0] == pytest.approx(0.03)
    # Signals of one's own come by the library; the command line has no way to write them.
    with pytest.raises(InputError, match="unknown profile"):
        duty_named("replay", values=values)
