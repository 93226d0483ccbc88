"""Angles from wrapped counts, valves and speeds."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdd.logs.conversion import accumulate_speed, directed, unwrap_counts
from fdd.logs.quality import sample_numbers


@given(st.lists(st.integers(-2047, 2047), min_size=1, max_size=50), st.sets(st.integers(0, 49)))
def test_unwrapping_gives_counts_back(steps: list[int], missing: set[int]) -> None:
    """Test: an encoder of 4096 counts, rows missing between small steps. Expected: its true counts."""
    small = [s // 8 for s in steps] if missing else steps
    true = 100.0 + np.cumsum([0, *small])
    raw = np.mod(true, 4096.0)
    for row in missing:
        # Two missing rows in a row stay below half a turn: 3 * 255 counts.
        if 0 < row < raw.size - 1 and not np.isnan(raw[row - 1]) and not np.isnan(raw[row + 1]):
            raw[row] = np.nan
    out = unwrap_counts(raw, 4096.0)
    there = np.isfinite(raw)
    np.testing.assert_array_equal(out[there] - out[0], true[there] - true[0])
    assert np.isnan(out[~there]).all()


def test_count_differences_add_up_exactly_with_missing_rows() -> None:
    """Test: speed as count difference per nominal millisecond, rows missing, stamps late, constant speed.

    Expected: the encoder's angle at every row that is there.
    """
    rng = np.random.default_rng(3)
    count = 9.587e-5
    counts = np.cumsum(np.full(20_000, 7))
    speed = np.diff(counts, prepend=counts[0] - 7) * count / 1e-3
    time = np.arange(20_000) * 1e-3
    late = rng.choice(np.arange(10, 19_990, 7), 20, replace=False)
    time[late] += rng.uniform(1e-4, 9e-4, 20)
    dropped = np.setdiff1d(
        rng.choice(np.arange(1, 19_999), 40, replace=False), np.concatenate([late - 1, late, late + 1])
    )
    keep = np.setdiff1d(np.arange(20_000), dropped)
    angle = accumulate_speed(time[keep], speed[keep], 1e-3)
    np.testing.assert_allclose(angle, (counts[keep] - counts[0]) * count, atol=1e-9)


def test_a_ramp_is_bridged_by_the_mean_of_the_neighbours() -> None:
    time, speed = np.arange(1000) * 1e-3, np.linspace(0.0, 50.0, 1000)
    whole = accumulate_speed(time, speed, 1e-3)
    keep = np.setdiff1d(np.arange(1000), np.r_[300:308, 500])
    gone = accumulate_speed(time[keep], speed[keep], 1e-3)
    np.testing.assert_allclose(gone, whole[keep], atol=1e-12)
    missing = speed.copy()
    missing[np.r_[300:308, 500]] = np.nan
    bridged = accumulate_speed(time, missing, 1e-3)
    np.testing.assert_allclose(bridged[keep], whole[keep], atol=1e-12)
    assert np.isnan(bridged[305])


def test_nothing_is_made_up_over_a_long_gap() -> None:
    time = np.array([0.0, 0.001, 5.0, 5.001])
    angle = accumulate_speed(time, np.full(4, 100.0), 1e-3)
    np.testing.assert_allclose(angle, [0.0, 0.1, 0.2, 0.3])
    assert np.isnan(accumulate_speed(time, np.full(4, np.nan), 1e-3)).all()


@given(
    st.lists(st.tuples(st.integers(-5, 5), st.sampled_from([-1000.0, 0.0, 1000.0])), min_size=1, max_size=40)
)
def test_a_valve_gives_each_step_its_sign(rows: list[tuple[int, float]]) -> None:
    steps, valve = (np.array(c, dtype=float) for c in zip(*rows, strict=True))
    raw = np.cumsum(steps)
    expected, at = [raw[0]], raw[0]
    for k in range(1, raw.size):
        at += steps[k] * (valve[k] > 0) - steps[k] * (valve[k] < 0)
        expected.append(at)
    np.testing.assert_array_equal(directed(raw, valve, accumulate=True), expected)
    np.testing.assert_array_equal(directed(raw, valve, accumulate=False), raw * np.sign(valve))


def test_an_unknown_valve_keeps_its_last_direction_and_before_the_first_tells_none() -> None:
    valve = np.array([np.nan, 1.0, np.nan, -1.0, np.nan])
    np.testing.assert_array_equal(directed(np.full(5, 2.0), valve, accumulate=False), [np.nan, 2, 2, -2, -2])


@given(
    st.lists(st.integers(1, 4), min_size=2, max_size=60),
    st.lists(st.floats(-0.5, 0.5), min_size=60, max_size=60),
    st.floats(-1e-4, 1e-4),
)
def test_late_stamps_neither_lose_nor_make_rows(gaps: list[int], late: list[float], drift: float) -> None:
    """Test: rows on a grid with gaps, every third late or early by up to half a period; a clock that drifts.

    Expected: as many numbers lie between rows that are not late as periods.
    """
    wanted = np.concatenate(([0], np.cumsum(gaps)))
    lateness = np.array([0.0 if k % 3 else late[k % 60] for k in range(wanted.size)])
    lateness[0] = 0.0
    numbers = sample_numbers((1.0 + drift) * wanted + 0.95 * lateness, 1.0)
    on_time = lateness == 0.0
    np.testing.assert_array_equal(np.diff(numbers[on_time]), np.diff(wanted[on_time]))
