"""Duties for experiments: strokes in one direction, and set-points as the user writes them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.plant.duty import Levels, OneWay, duty_named

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("position", [False, True])
def test_one_way_strokes_are_fast_one_way_and_slow_the_other(position, reverse) -> None:
    duty = OneWay(amplitude=0.06, speed=120.0, out=1.5, back=9.0, dwell=0.5, lead_in=0.2, reverse=reverse)
    setpoint = duty.setpoint(60_000, position, RNG) * (-1.0 if reverse else 1.0)
    speed = np.diff(setpoint) / 1e-3 if position else setpoint
    fast, slow = (0.12 / 1.5, -0.12 / 9.0) if position else (120.0, -120.0 * 1.5 / 9.0)
    moving = speed[np.abs(speed) > 1e-6]
    at_fast, at_slow = np.isclose(moving, fast, rtol=0.01), np.isclose(moving, slow, rtol=0.01)
    # But for the milliseconds in which a position's corner falls.
    assert np.mean(at_fast | at_slow) > 0.999
    assert at_fast.sum() == pytest.approx(at_slow.sum() * 1.5 / 9.0, rel=0.2)
    cycles = np.diff((speed > 0.5 * fast).astype(int)).clip(0).sum()
    assert cycles == 5, "60 s hold five strokes of 11.5 s after 4.5 s to the start"


@given(out=st.floats(0.5, 5.0), back=st.floats(0.5, 15.0), dwell=st.floats(0.0, 2.0), reverse=st.booleans())
def test_one_way_speeds_lead_back_to_the_middle_and_stay_within_their_travel(
    out, back, dwell, reverse
) -> None:
    """The integral of the speeds is the position's own shape."""
    duty = OneWay(amplitude=1.0, speed=100.0, out=out, back=back, dwell=dwell, lead_in=0.0, reverse=reverse)
    n = 40_000
    shape = duty.setpoint(n, True, RNG)
    travelled = np.concatenate([[0.0], np.cumsum(duty.setpoint(n, False, RNG))[:-1]]) * 1e-3
    half_travel = 0.5 * 100.0 * min(out, back)
    # Each corner may lie up to a millisecond off.
    corners = 4.0 * (n * 1e-3 / (out + back + 2.0 * dwell) + 2.0)
    np.testing.assert_allclose(travelled, half_travel * shape, atol=100.0 * 1e-3 * corners)


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


def test_levels_forgive_rounding_of_their_times() -> None:
    """0.1 + 0.2 is a hair more than 0.3: still the 300th millisecond."""
    setpoint = Levels(points=[[0.0, 1.0], [0.1 + 0.2, 2.0]]).setpoint(400, False, RNG)
    assert setpoint[[299, 300]].tolist() == [1.0, 2.0]


def test_levels_reach_is_theirs_and_travels() -> None:
    duty = duty_named("levels", points=["0:0.02", "3:-0.07"])
    assert duty.amplitude == 0.07
    assert Levels.model_validate_json(duty.model_dump_json()) == duty
    with pytest.raises(InputError, match="levels"):
        duty_named("level")
