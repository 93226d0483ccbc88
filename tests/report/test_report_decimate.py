"""Decimation against the property that it is for: no spike and no gap is ever lost."""

from __future__ import annotations

import base64
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fdd.report.decimate import (
    KEPT_PER_BUCKET,
    break_at_gaps,
    bucket_means,
    decimate,
    envelope,
    intervals,
)
from fdd.report.traces import on_grid, packed

signals = arrays(
    np.float64,
    st.integers(1, 700),
    elements=st.one_of(st.floats(-1e6, 1e6), st.just(float("nan")), st.just(0.0)),
)


@given(values=signals, buckets=st.integers(1, 60))
@settings(max_examples=200, deadline=None)
def test_every_sample_lies_within_what_is_kept_nearby_and_ends_and_gaps_are_kept(
    values: np.ndarray, buckets: int
) -> None:
    time = np.arange(values.size, dtype=float)
    kept_time, kept = decimate(time, values, buckets)
    assert kept.size <= max(4 * buckets, KEPT_PER_BUCKET * buckets)
    assert (np.diff(kept_time) > 0).all() and (kept_time[0], kept_time[-1]) == (time[0], time[-1])
    np.testing.assert_array_equal(kept, values[kept_time.astype(int)])
    size = -(-values.size // buckets)
    for at in np.flatnonzero(np.isfinite(values)):
        near = kept[np.abs(kept_time - at) < size]
        assert np.nanmin(near) <= values[at] <= np.nanmax(near)
    assert np.isnan(kept).any() == np.isnan(values).any()


def test_small_signals_are_left_alone_and_nonsense_is_refused() -> None:
    time = np.arange(40.0)
    assert decimate(time, time, 10)[1] is time
    with pytest.raises(ValueError, match="buckets"):
        decimate(time, time, 0)


@given(values=signals, buckets=st.integers(2, 60))
@settings(max_examples=100, deadline=None)
def test_envelope_covers_the_band(values: np.ndarray, buckets: int) -> None:
    time = np.arange(values.size, dtype=float)
    mid, low, high = envelope(time, values - 1.0, values + 1.0, buckets)
    assert mid.size == low.size == high.size <= max(buckets, 1)
    assert (np.diff(mid) > 0).all()
    if np.isfinite(values).any():
        assert np.nanmin(low) == np.nanmin(values) - 1.0
        assert np.nanmax(high) == np.nanmax(values) + 1.0
    else:
        assert np.isnan(low).all()


def test_shares_still_sum_to_one_after_averaging() -> None:
    table = np.random.default_rng(3).dirichlet(np.ones(5), 4321)
    reduced = bucket_means(table, 100)
    assert reduced.shape[0] <= 100
    np.testing.assert_allclose(reduced.sum(axis=1), 1.0)
    np.testing.assert_allclose(bucket_means(np.arange(6.0), 3), [0.5, 2.5, 4.5])


def test_a_hole_in_time_breaks_the_line_once() -> None:
    time = np.concatenate((np.arange(0.0, 10.0, 0.001), np.arange(11.0, 20.0, 0.001)))
    broken_time, broken = break_at_gaps(time, np.ones(time.size))
    assert np.isnan(broken).sum() == 1
    assert 10.0 < broken_time[np.isnan(broken)][0] < 11.0
    assert (np.diff(broken_time) > 0).all()
    jitter = time[:5000] + np.random.default_rng(5).uniform(0.0, 9e-4, 5000)
    assert break_at_gaps(jitter, np.ones(5000))[1].size == 5000


@given(arrays(np.bool_, st.integers(1, 400)), st.integers(2, 20))
@settings(max_examples=100, deadline=None)
def test_intervals_cover_the_mask_and_are_few(mask: np.ndarray, at_most: int) -> None:
    time = np.arange(mask.size, dtype=float)
    found = intervals(time, mask, at_most)
    assert len(found) <= at_most
    assert all(any(a <= t <= b for a, b in found) for t in time[mask])
    assert all(a[1] < b[0] for a, b in itertools.pairwise(found))
    if not mask.any():
        assert found == []


def test_packed_numbers_keep_six_digits() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=10_000) * 10.0 ** rng.uniform(-6, 6, 10_000)
    values[::100] = np.nan
    values[1::100] = np.inf
    out = packed(values)
    back = np.frombuffer(base64.b64decode(out["bdata"]), f"<{out['dtype']}")
    np.testing.assert_allclose(back, values, rtol=6e-7)
    epoch = 1.7e9 + np.arange(1000) * 1e-3
    out = packed(epoch)
    back = np.frombuffer(base64.b64decode(out["bdata"]), f"<{out['dtype']}")
    np.testing.assert_array_equal(back, epoch)


def test_times_keep_their_order_and_ends() -> None:
    time = np.sort(np.random.default_rng(4).uniform(5.0, 3600.0, 5_000))
    drawn = on_grid(time)
    assert (np.diff(drawn) >= 0.0).all()
    assert np.abs(drawn - time).max() < np.ptp(time) * 1e-5
