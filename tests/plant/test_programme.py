"""Programmes over time, and the chatter filter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import bilinear

from fdd.errors import InputError
from fdd.plant.circuit import Circuit
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


def test_programmes_travel_as_users_write_them() -> None:
    circuit = Circuit(bypass="0:0/2:1", throttle=1)
    plain = circuit.model_dump()
    assert plain["bypass"] == [[0.0, 0.0], [2.0, 1.0]] and plain["throttle"] == 1.0
    assert Circuit.model_validate_json(circuit.model_dump_json()) == circuit == Circuit(**plain)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ([[2, 0], [1, 0]], "time 1 s comes after 2 s"),
        ([[1, 0], [1, 0.5], [1, 1]], "three points at 1 s"),
        ([[-1, 0]], "greater than or equal to 0"),
        ([[4000, 0]], "3600"),
        ([], "at least 1"),
        ([[1, 2, 3]], "pair"),
        ([1, 2], "pair"),
        ("a", "number"),
        ("0:x/1:2", "number"),
        (float("nan"), "finite"),
        (True, "no programme"),
        (None, "no programme"),
        ({"0": 1}, "no programme"),
    ],
)
def test_a_wrong_programme_is_told_in_one_line_with_its_field(given, told) -> None:
    with pytest.raises(InputError) as caught:
        Circuit(bypass=given)
    line = str(caught.value)
    assert told in line and "bypass" in line and "\n" not in line


@pytest.mark.parametrize("given", [1.2, -0.1, "0:0/3:1.5"])
def test_an_opening_stays_between_shut_and_open(given) -> None:
    with pytest.raises(InputError, match=r"0 \(shut, off\) to 1"):
        Circuit(throttle=given)


# The filter of eq. 7.5.


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
