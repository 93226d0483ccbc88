"""Steps are short enough, blocks change no bit, and whatever the rig allows stays within physics."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from fdd import Scenario, Unit
from fdd.plant import state as s
from fdd.plant.details import Details
from fdd.plant.simulate import raw_blocks, simulate, stream
from reports.plant import wild as robustness
from reports.plant.numerics import Case, integrate
from reports.plant.wild import draw_wild, try_wild

A, B = Unit.load("axis_a"), Unit.load("axis_b")
THROTTLE, SPRING, BY_SPEED = {"name": "throttle"}, {"name": "spring"}, {"mode": "speed"}
CASES: dict[str, dict[str, Any]] = {
    "steps, constant load": {"duty": {"name": "steps", "hold": 1.0}, "load": {"name": "constant"}},
    "sines, spring, leakage": {
        "duty": {"name": "sines"}, "load": SPRING,
        "faults": [{"fault": "internal_leakage", "severity": 0.6, "onset": 0.02}],
    },
    "sawtooth, throttle, loose seal": {
        "duty": {"name": "sawtooth"}, "load": THROTTLE,
        "faults": [{"fault": "seal_wear", "severity": 1.0, "variant": "loose"}],
    },
    "flight, gust, aeration": {
        "duty": {"name": "flight", "lead_in": 0.1}, "load": {"name": "gust"},
        "faults": [{"fault": "aeration", "severity": 1.0, "onset": 0.02, "profile": "ramp"}],
    },
    "prbs, stiffest bristles": {
        "duty": {"name": "prbs", "amplitude": 0.01, "lead_in": 0.1}, "load": SPRING,
        "details": Details(bristle_stiffness=Details.usual["bristle_stiffness"][1]),
    },
    "prbs of speed, coupling and check valve": {
        "duty": {"name": "prbs", "speed": 60.0, "lead_in": 0.1}, "control": BY_SPEED, "load": THROTTLE,
        "faults": [
            {"fault": "coupling_wear", "severity": 1.0}, {"fault": "check_valve_stuck_open", "severity": 0.7},
        ],
    },
    "two axes, sines, connected": {
        "duty": {"name": "sines"}, "load": SPRING, "partner": {}, "connect": {"line_1": 0.1, "line_2": 0.1},
    },
    "two axes, one throttled": {
        "duty": {"name": "steps", "hold": 1.0},
        "partner": {"drive": "still", "circuit": {"blocked": True, "throttle": 0.3}},
    },
}  # fmt: skip


def differences(case: Case, one: np.ndarray, other: np.ndarray) -> dict[str, float]:
    """How far two runs' states lie apart: for each channel the rms over what its sensor cannot see, the rms
    of its white noise and of its rounding, LSB/√12; for encoders, which have no noise, that of rounding."""
    rms: dict[str, float] = {}
    off = one - other
    for axis, unit in enumerate(filter(None, (case.unit, case.partner))):
        own = off[:, s.SHARED + axis * s.AXIS_STATES :]
        for channel, error in {
            "position": off[:, s.X],
            "pump_speed": own[:, s.SPEED],
            "pressure_difference": own[:, s.P1] - own[:, s.P2],
            "motor_current": own[:, s.CURRENT],
            "pump_angle": own[:, s.ANGLE],
        }.items():
            # As shipped: also where the loop's encoder was given no steps.
            sensor = Unit.load(unit.name).sensor(channel)
            unseen = np.hypot(sensor.noise, sensor.resolution / np.sqrt(12.0))
            rms[channel] = max(rms.get(channel, 0.0), float(np.sqrt(np.mean(error**2)) / unseen))
    return rms


@pytest.mark.parametrize("name", CASES)
def test_half_the_step_changes_no_sensor_by_a_tenth_of_its_noise(name):
    """The numerics alone, without the encoder's steps in the loop."""
    sensors = dict(A.sensors)
    sensors["position"] = sensors["position"].model_copy(update={"resolution": 0.0})
    case = replace(Case(name, CASES[name]), unit=A.model_copy(update={"sensors": sensors}))
    rms = differences(case, case.states(4.0)[0], case.states(4.0, 2.0)[0])
    # Far finer than noise: 65536 counts a turn, and nothing brings the angle back, an integral to which each
    # corner that a step runs over adds its error.
    assert rms.pop("pump_angle") < 1.0
    assert max(rms.values()) < 0.1
    assert rms["pressure_difference"] < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["prbs, stiffest bristles", "prbs of speed, coupling and check valve", "flight, gust, aeration"]
)
def test_radau_agrees_within_a_tenth_of_the_sensors(name):
    """SciPy's implicit solver on the same right-hand side and commands, tolerance 1e-10."""
    case = Case(name, CASES[name])
    states, commands = case.states(0.25)
    assert np.ptp(states[:, s.X]) > 1e-4
    radau, _ = integrate(case, commands, "Radau", 1e-10, 1e-2, 0.25)
    rms = differences(case, states, radau)
    assert rms.pop("pump_angle") < 0.5
    assert max(rms.values()) < 0.1


LENGTH = 900
RUNS: dict[str, dict[str, Any]] = {
    "one axis": {
        "duty": {"name": "steps", "hold": 0.2}, "load": {"name": "gust"}, "friction_wander": 0.04,
        "faults": [
            {"fault": "coupling_wear", "severity": 1.0, "onset": 0.2},
            {"fault": "pressure_sensor_drift", "severity": 1.0, "onset": 0.1},
        ],
    },
    "shuttle with rate feedback": {
        "duty": {"name": "constant_speed", "amplitude": 0.005, "dwell": 0.05}, "control": BY_SPEED,
    },
    "rate feedback": {"control": {"rate_gain": 500.0}, "duty": {"name": "sines", "lead_in": 0.0}},
    "dual": {
        "duty": {"name": "prbs", "amplitude": 0.02, "bit": 0.1}, "load": {"name": "spring"},
        "partner": {"circuit": {"throttle": "0:0/0.5:0.2"}}, "connect": {"line_1": "0:0/0.7:1"},
        "faults": [{"fault": "aeration", "severity": 0.5, "onset": 0.3, "axis": 2, "profile": "ramp"}],
    },
}  # fmt: skip


def _rig(case: str) -> dict[str, Any]:
    scenario = Scenario(duration=LENGTH * 1e-3, seed=11, **RUNS[case])
    return {"unit": A, "scenario": scenario, "partner": B if "partner" in RUNS[case] else None}


@pytest.fixture(scope="module")
def whole() -> dict[str, Any]:
    return {case: simulate(**_rig(case)) for case in RUNS}


@settings(max_examples=6)
@given(block=st.integers(1, LENGTH + 50))
@pytest.mark.parametrize("case", RUNS)
def test_streamed_it_is_the_same_bits(whole, case, block):
    parts = list(stream(**_rig(case), block=max(block, 25)))
    reference = whole[case]
    for axis, expected in enumerate(filter(None, (reference, reference.partner))):
        time = np.concatenate([part[axis][0].time for part in parts])
        np.testing.assert_array_equal(time, expected.samples.time)
        for k, kind in enumerate((expected.samples, expected.truth)):
            for name, values in kind.columns.items():
                streamed = np.concatenate([part[axis][k].columns[name] for part in parts])
                np.testing.assert_array_equal(streamed, values, err_msg=name)


@pytest.mark.slow
@settings(max_examples=12, phases=[Phase.generate])  # a smaller number is no simpler scenario
@given(seed=st.integers(0, 10**6))
def test_wild_runs_stay_within_physics(seed):
    outcome = try_wild(seed, duration=2.0)
    assert outcome.failures == []
    assert outcome.lowest_pressure > 0.0


@pytest.mark.parametrize("seed", [1730, 1955, 1048, 1124])
def test_wild_runs_that_once_failed(seed):
    """1730: connect lines stack relief settings. 1955: a motor ran away. 1048, 1124: a coarse quadrature."""
    assert try_wild(seed).failures == []


def test_the_check_sees_what_is_wrong():
    wild = draw_wild(5)
    ready = wild.prepared()
    raw = next(iter(raw_blocks(ready, block=wild.scenario.rows)))
    sound = raw.states.copy()
    for column, value, told in (
        (s.SHARED + s.P1, -1e6, "absolute pressure"),
        (s.X, 1.0, "beyond the stop"),
        (s.SHARED + s.SPEED, 5e3, "motor"),
        (s.SHARED + s.P1, np.nan, "NaN"),
    ):
        raw.states[:] = sound
        raw.states[-1, column] = value
        failures = robustness._checked(5, wild, ready, raw).failures
        assert any(told in failure for failure in failures), told
