"""Samples: what is refused, and that cutting and joining lose nothing."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

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


def same(a: Samples, b: Samples) -> None:
    """Equal to the bit, in content."""
    assert set(a.channels) == set(b.channels)
    np.testing.assert_array_equal(a.time, b.time)
    for name in a.channels:
        np.testing.assert_array_equal(a[name], b[name])


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


def test_whole_numbers_and_missing_values_are_taken() -> None:
    s = Samples([0, 1, 2], {"position": [1, 2, 3], "command": [np.nan] * 3})
    assert s["position"].dtype == np.float64
    assert s.duration == 2.0
    assert "position" in s and "pressure_1" not in s
    assert np.isnan(s.get("pressure_1")).all() and s.get("pressure_1").shape == (3,)


def test_an_empty_log_is_possible() -> None:
    s = Samples([], {"position": []})
    assert (len(s), s.duration, repr(s)) == (0, 0.0, "Samples(empty)")
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
        same(Samples.concatenate(blocks), s)


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
