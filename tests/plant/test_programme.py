"""Programmes and duties over time, and the chatter filter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import bilinear

from fdd.errors import InputError
from fdd.plant.circuit import Circuit
from fdd.plant.duty import Levels, OneWay
from fdd.plant.prepare import chatter_filter
from fdd.plant.programme import programme

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
    with pytest.raises(InputError) as caught:
        Circuit(bypass=given)
    assert told in str(caught.value) and "bypass" in str(caught.value) and "\n" not in str(caught.value)


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
