"""Scenarios: what is refused, what duties and loads are, and that a seed fixes everything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.plant.duty import DUTIES
from fdd.plant.load import LOADS, GustLoad
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import simulate
from fdd.plant.truth import TRUTH
from fdd.unit import Unit

UNIT = Unit.load("axis_b")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
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
    ],
)
def test_wrong_scenarios_are_told_in_one_line(arguments, told):
    with pytest.raises(InputError) as caught:
        Scenario(**arguments)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_a_duty_beyond_the_stroke_and_a_chamber_empty_within_it_are_refused():
    with pytest.raises(InputError, match="leaves the stroke"):
        simulate(UNIT, Scenario(duration=1.0, duty=DUTIES["steps"](amplitude=0.2)))
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
