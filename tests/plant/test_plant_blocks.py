"""A run is the same bits however it is cut into blocks."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.plant.integrator import run
from fdd.plant.prepare import prepare
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import raw_blocks, simulate, stream
from fdd.unit import Unit

A, B = Unit.load("axis_a"), Unit.load("axis_b")
LENGTH = 900
CASES: dict[str, dict[str, Any]] = {
    "one axis": {
        "duty": {"name": "steps", "hold": 0.2},
        "load": {"name": "gust"},
        "faults": [
            {"fault": "coupling_wear", "severity": 1.0, "onset": 0.2},
            {"fault": "pressure_sensor_drift", "severity": 1.0, "onset": 0.1},
        ],
    },
    "shuttle with rate feedback": {
        "duty": {"name": "constant_speed", "amplitude": 0.005, "dwell": 0.05},
        "control": {"mode": "speed"},
    },
    "rate feedback": {"control": {"rate_gain": 500.0}, "duty": {"name": "sines", "lead_in": 0.0}},
    "dual": {
        "duty": {"name": "prbs", "amplitude": 0.02, "bit": 0.1},
        "load": {"name": "spring"},
        "partner": {"circuit": {"throttle": "0:0/0.5:0.2"}},
        "connect": {"line_1": "0:0/0.7:1"},
        "faults": [{"fault": "aeration", "severity": 0.5, "onset": 0.3, "axis": 2, "profile": "ramp"}],
    },
}


def _scenario(case: str) -> Scenario:
    return Scenario(duration=LENGTH * 1e-3, seed=11, **CASES[case])


@pytest.fixture(scope="module")
def whole() -> dict[str, Any]:
    return {case: simulate(A, _scenario(case), partner=_partner(case)) for case in CASES}


def _partner(case: str) -> Unit | None:
    return B if "partner" in CASES[case] else None


@settings(max_examples=6)
@given(block=st.integers(1, LENGTH + 50))
@pytest.mark.parametrize("case", CASES)
def test_streamed_it_is_the_same_bits(whole, case, block):
    """Samples and truth of every axis, for any block length."""
    parts = list(stream(A, _scenario(case), partner=_partner(case), block=max(block, 25)))
    reference = whole[case]
    for axis, expected in enumerate(filter(None, (reference, reference.partner))):
        time = np.concatenate([part[axis].samples.time for part in parts])
        np.testing.assert_array_equal(time, expected.samples.time)
        for name, values in expected.samples.columns.items():
            streamed = np.concatenate([part[axis].samples.columns[name] for part in parts])
            np.testing.assert_array_equal(streamed, values, err_msg=name)
        for name, values in expected.truth.columns.items():
            streamed = np.concatenate([part[axis].truth.columns[name] for part in parts])
            np.testing.assert_array_equal(streamed, values, err_msg=name)


@settings(max_examples=8)
@given(cuts=st.lists(st.integers(1, LENGTH - 1), unique=True, max_size=6))
@pytest.mark.parametrize("case", CASES)
def test_the_loop_forgets_nothing_between_uneven_cuts(case, cuts):
    """The compiled loop alone: whatever it must remember is in its arguments."""
    scenario, partner = _scenario(case), _partner(case)
    once = next(iter(raw_blocks(prepare(A, scenario, partner=partner), block=LENGTH)))
    ready = prepare(A, scenario, partner=partner)
    late = np.rint((once.time - np.arange(LENGTH) * 1e-3) / 1e-4).astype(np.int64)
    edges = [0, *sorted(cuts), LENGTH]
    states, commands = [], []
    for start, stop in pairwise(edges):
        block, _, asked = run(
            ready.state, ready.memory, ready.past, *ready.conditions(start, stop), ready.viscosity,
            ready.parameters[0], ready.parameters[-1], ready.controller, late[start:stop],
            1.0 / ready.allowed, ready.longest,
        )  # fmt: skip
        states.append(block)
        commands.append(asked)
    np.testing.assert_array_equal(np.concatenate(states), once.states)
    np.testing.assert_array_equal(np.concatenate(commands), once.commands)
