"""Samples and their units of measure: what is refused, and that cutting and joining lose nothing."""

import re

import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fdd.measures import _NOT_BY_PINT, MEASURES, find_measure, measure
from fdd.samples import CHANNELS, Samples, missing_required
from tests.refusal import refused

# The contract's channels, in its order.
PROMISED = [
    "time", "command", "pump_angle", "pump_speed", "position", "pressure_difference", "pressure_1",
    "pressure_2", "pressure_accumulator", "motor_current", "oil_temperature", "load_force",
    "position_setpoint",
]  # fmt: skip
MEASURED = [name for name in PROMISED if name != "time"]


@st.composite
def samples(draw: st.DrawFn, least: int = 0, most: int = 60) -> Samples:
    """Any samples: uneven steps, any channels, holes."""
    n = draw(st.integers(least, most))
    steps = draw(hnp.arrays(np.float64, n, elements=st.floats(1e-4, 1.0)))
    names = draw(st.lists(st.sampled_from(MEASURED), unique=True, max_size=4))
    column = hnp.arrays(np.float64, n, elements=st.floats(-1e9, 1e9) | st.just(np.nan))
    return Samples(np.cumsum(steps), {name: draw(column) for name in names})


def test_channels_are_the_promised_ones() -> None:
    assert list(CHANNELS) == PROMISED


REFUSED = [
    ([0.0, np.nan], {}, r"channel time, row 1: not a finite number"),
    ([np.inf], {}, r"channel time, row 0: not a finite number"),
    ([0.0, 1.0, 1.0], {}, r"channel time, row 2: 1\.000000 s after 1\.000000 s, time must increase; sort"),
    ([0.0, 2.0, 1.0], {}, r"channel time, row 2: 1\.000000 s after 2\.000000 s"),
    ([0.0], {"positoin": [0.0]}, r"unknown channel 'positoin'; the channels are: command, pump_angle"),
    ([0.0], {"time": [0.0]}, r"unknown channel 'time'"),
    ([0.0, 1.0], {"position": [0.0]}, r"channel position: 1 values for 2 time stamps"),
    ([0.0, 1.0], {"position": [0.0, -np.inf]}, r"channel position, row 1: infinite value; mark missing"),
    ([0.0], {"position": ["up"]}, r"channel position: not numbers"),
    ([0.0], {"position": [[0.0]]}, r"channel position: 2 dimensions where one column is wanted"),
    ([[0.0]], {}, r"channel time: 2 dimensions"),
    (["noon"], {}, r"channel time: not numbers"),
    ([0.0, 1.0], {"position": [[0.0], [1.0, 2.0]]}, r"channel position: not numbers"),
]


@pytest.mark.parametrize(("time", "columns", "line"), REFUSED)
def test_refused_with_channel_row_and_reason(time: list, columns: dict, line: str) -> None:
    assert re.search(line, refused(lambda: Samples(time, columns)))


def test_whole_numbers_missing_values_and_no_rows_are_taken() -> None:
    s = Samples([0, 1, 2], {"position": [1, 2, 3], "command": [np.nan] * 3})
    assert s["position"].dtype == np.float64
    assert s.duration == 2.0
    assert "position" in s and "pressure_1" not in s
    assert np.isnan(s.get("pressure_1")).all() and s.get("pressure_1").shape == (3,)
    none = Samples([], {"position": []})
    assert (len(none), none.duration, repr(none)) == (0, 0.0, "Samples(empty)")
    assert len(Samples.concatenate([])) == 0


@given(samples(), st.integers(0, 70), st.integers(0, 70))
def test_rows_are_the_slices_and_views(s: Samples, a: int, b: int) -> None:
    part = s.rows(a, b)
    np.testing.assert_array_equal(part.time, s.time[a:b])
    for name in s.channels:
        np.testing.assert_array_equal(part[name], s[name][a:b])
        # A copy of every block would double the memory of a log.
        assert not part[name].size or np.shares_memory(part[name], s[name])


@given(samples(), st.integers(1, 70))
def test_blocks_partition_the_log(s: Samples, size: int) -> None:
    blocks = list(s.blocks(size))
    assert sum(len(b) for b in blocks) == len(s)
    assert all(len(b) == size for b in blocks[:-1])
    assert all(0 < len(b) <= size for b in blocks)
    if blocks:
        joined = Samples.concatenate(blocks)
        assert set(joined.channels) == set(s.channels)
        np.testing.assert_array_equal(joined.time, s.time)
        for name in s.channels:
            np.testing.assert_array_equal(joined[name], s[name])


def test_a_channel_that_a_block_lacks_is_missing_there() -> None:
    blocks = [Samples([0.0, 1.0], {"position": [1.0, 2.0]}), Samples([2.0], {"command": [5.0]})]
    joined = Samples.concatenate(blocks)
    np.testing.assert_array_equal(joined["position"], [1.0, 2.0, np.nan])
    np.testing.assert_array_equal(joined["command"], [np.nan, np.nan, 5.0])


def test_blocks_out_of_order_are_refused() -> None:
    line = refused(lambda: Samples.concatenate([Samples([1.0], {}), Samples([0.0], {})]))
    assert "channel time, row 1: 0.000000 s after 1.000000 s" in line


@given(samples(least=1))
def test_with_columns_leaves_the_original_alone(s: Samples) -> None:
    before = s.columns
    changed = s.with_columns({"position": np.zeros(len(s))})
    assert set(changed.channels) == {*s.channels, "position"}
    assert not changed["position"].any()
    for name, column in before.items():
        assert s[name] is column
    assert set(s.channels) == set(before)


@given(st.sets(st.sampled_from(sorted(CHANNELS))))
def test_a_diagnosis_wants_position_pump_and_pressure(channels: set[str]) -> None:
    there = {
        "position": "position" in channels,
        "pump_angle": bool(channels & {"pump_angle", "pump_speed"}),
        "pressure_difference": "pressure_difference" in channels or {"pressure_1", "pressure_2"} <= channels,
    }
    absent = [name.split(" ")[0] for name in missing_required(channels)]
    assert absent == [name for name in there if not there[name]]


WRITTEN = [
    ("cm2", "area", 1e-4), ("kgf/cm2", "pressure", 98066.5), ("m3/s", "flow", 1.0),
    ("furlong", "length", None),
]  # fmt: skip
# Of the few units that pint does not have in our sense, from the definition.
DEFINED = {"1/h": 1.0 / 3600.0, "%": 0.01, "1": 1.0}


def test_factors_and_fixed_points_are_those_of_pint() -> None:
    registry = pint.UnitRegistry()
    base: dict[str, str] = {}
    for name, each in MEASURES.items():
        si = base.setdefault(each.dimension, name)
        if each.dimension in _NOT_BY_PINT or each.dimension == "temperature":
            assert name not in DEFINED or each.factor == DEFINED[name]
        elif name:
            factor = registry.Quantity(1.0, name.replace("rev", "turn")).to(si).magnitude
            assert (each.factor, each.offset) == (pytest.approx(factor, rel=1e-12), 0.0), name
    for name in ("K", "degF", "degC", "°C"):
        for value in (0.0, 100.0):
            celsius = registry.Quantity(value, name).to("degC").magnitude
            ours = MEASURES[name].factor * value + MEASURES[name].offset
            assert ours == pytest.approx(celsius, abs=1e-10), name


@pytest.mark.parametrize(("text", "dimension", "factor"), WRITTEN)
def test_units_as_rigs_write_them(text: str, dimension: str, factor: float | None) -> None:
    found = find_measure(text, dimension)
    assert (None if found is None else found.factor) == (factor and pytest.approx(factor))


def test_a_channels_own_unit_is_si() -> None:
    for channel in (c for c in CHANNELS.values() if c.name != "oil_temperature"):
        found = measure(channel.unit, channel.dimension)
        assert (found.factor, found.offset) == (1.0, 0.0), channel.name


def test_unknown_names_and_wrong_dimensions_are_told_with_what_would_fit() -> None:
    assert measure(" bar ") is MEASURES["bar"]
    line = refused(lambda: measure("blurp", "length"))
    assert line.startswith("unknown unit 'blurp'; use one of: m, cm, mm") and "bar" not in line
    line = refused(lambda: measure("bar", "length"))
    assert "'bar' measures pressure, not length; use one of: m, cm" in line


@given(st.text(max_size=12).filter(lambda s: s.strip() not in MEASURES))
def test_any_other_name_is_refused_in_one_line(name: str) -> None:
    refused(lambda: measure(name))
