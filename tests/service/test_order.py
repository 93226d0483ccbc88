"""However a stream is cut, repeated, reordered and its clock set: the same samples; the counts add up."""

import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.logs.quality import check_time
from fdd.monitor.stream import Gaps
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.order import Order
from tests.service.senders import ordered

PERIOD = 0.01


def block(time: np.ndarray, value: np.ndarray, number: int | None) -> Block:
    return Block("A1", Samples(time, {"position": value, "pump_speed": -value}), number, 0.0)


def blocks_of(draw: st.DrawFn, *, counted: bool) -> tuple[list[Block], np.ndarray, np.ndarray]:
    """A stream of several spans, between which the clock was set: blocks in order, true times and values."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    start = draw(st.sampled_from([0.0, 5.0, 1.7e9]))
    spans = draw(st.lists(st.integers(70, 300), min_size=1, max_size=3))
    steps = [draw(st.sampled_from([-3600.0, -20.0, -1.5, 4e7, 1e9])) for _ in spans]
    blocks, times, clock, t = [], [], start, 0.0
    for rows, step in zip(spans, steps, strict=True):
        # Jitter that stays below the period, and rows that the sender itself lost.
        own = PERIOD * (np.arange(rows) + rng.uniform(0, 0.5, rows))
        own = own[np.sort(rng.choice(rows, rows - 5, replace=False))]
        raw = clock + own - own[0]
        times.append(t + raw - raw[0])
        cuts = np.cumsum(rng.integers(1, 25, rows))
        for part in np.split(raw, cuts[cuts < raw.size]):
            blocks.append((part, rng.standard_normal(part.size)))
        t, clock = times[-1][-1] + 1.0, raw[-1] + step
    made = [block(time, value, k if counted else None) for k, (time, value) in enumerate(blocks)]
    first = 0.0 if start > 1e6 else start
    return made, first + np.concatenate(times), np.concatenate([v for _, v in blocks])


def disturbed(draw: st.DrawFn, blocks: list[Block], *, fixed: frozenset[int]) -> list[Block]:
    """Neighbours overtaken by less than the hold, never across a block of `fixed`; any block again, later."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    order, k = [], 0
    while k < len(blocks):
        stop = k + 1
        while stop < len(blocks) and stop not in fixed and stop < k + 3:
            rows = sum(len(b.samples) for b in blocks[k : stop + 1])
            if rows * PERIOD * 1.5 > 0.45:
                break
            stop += 1
        order += rng.permutation(np.arange(k, stop)).tolist()
        k = stop
    out: list[Block] = []
    for k in order:
        out.append(blocks[k])
        if rng.random() < 0.3:
            out.append(out[rng.integers(max(0, len(out) - 20), len(out))])
    return out


def passed(blocks: list[Block], restart: int | None) -> tuple[Samples, Order]:
    order, parts = Order(), []
    for k, one in enumerate(blocks):
        if k == restart:
            state = {name: array.copy() for name, array in order.state().items()}
            order = Order()
            order.restore(state)
        parts.append(order.take([one]))
        given, counts = sum(len(p) for p in parts), order.counts
        assert counts["received"] == given + counts["repeated"] + counts["late"] + order.held_samples
    return Samples.concatenate([*parts, order.flush()]), order


@settings(max_examples=120, deadline=None)
@given(data=st.data(), counted=st.booleans())
def test_disturbed_streams_give_the_undisturbed_samples(data, counted):
    blocks, times, values = blocks_of(data.draw, counted=counted)
    # Without numbers nothing tells on which side of a set clock a block belongs.
    steps = [after.samples.time[0] - before.samples.time[-1] for before, after in pairwise(blocks)]
    set_at = {k for k, step in enumerate(steps, 1) if not 0.0 < step < 0.5}
    coming = disturbed(data.draw, blocks, fixed=frozenset() if counted else frozenset(set_at))
    restart = data.draw(st.none() | st.integers(0, len(coming)))
    found, order = passed(coming, restart)
    assert np.allclose(found.time, times, rtol=0, atol=2e-6)
    assert np.array_equal(found["position"], values) and np.array_equal(found["pump_speed"], -values)
    twice = sum(len(b.samples) for b in coming) - values.size
    assert order.counts["repeated"] == twice and order.counts["late"] == 0
    assert order.counts["missing_blocks"] == 0 and order.clock.resets == len(set_at)
    places = np.array([coming.index(one) for one in blocks])
    first_after = np.minimum.accumulate(places[::-1])[::-1]
    assert order.counts["reordered"] == (first_after[1:] < places[:-1]).sum()


def steady(number: int | None, start: float, rows: int = 10, seed: int = 0) -> Block:
    value = np.random.default_rng(seed).standard_normal(rows)
    return block(PERIOD * (round(start / PERIOD) + np.arange(rows)), value, number)


def test_rows_that_interleave_are_put_between_each_other_and_silence_passes_on_what_is_held():
    parts = (block(PERIOD * np.arange(k, 200, 2), np.arange(k, 200, 2.0), None) for k in (1, 0))
    found, order = ordered(parts)
    assert np.array_equal(found["position"], np.arange(200.0))
    for start in (2.0, 2.1):
        assert len(order.take([steady(None, start)])) == 0 and len(order.flush()) == 10
    assert order.held_samples == 0


def test_rows_after_newer_ones_are_late_and_known_ones_repeated_however_they_are_cut():
    order = Order(hold=0.2)
    for n in (0, 1, 2, 4, 5, 6, 7):
        order.take([steady(None, 0.1 * n)])
    assert len(order.take([steady(None, 0.3)])) == 0
    assert order.counts["late"] == 10 and order.counts["repeated"] == 0
    # Sent again, cut otherwise.
    order.take([steady(None, 0.0, rows=20, seed=1)])
    assert order.counts["repeated"] == 20
    time, value = PERIOD * np.arange(100), np.arange(100.0)
    cuts = [(0, 30), (20, 50), (10, 45), (45, 60), (50, 100)]
    found, order = ordered(block(time[a:b], value[a:b], None) for a, b in cuts)
    assert np.array_equal(found["position"], value)
    assert order.counts["repeated"] == sum(b - a for a, b in cuts) - 100 and order.counts["late"] == 0


def test_a_restored_order_knows_what_was_given_up():
    before, after = Order(hold=0.05), Order()
    for n in (0, 2, 3, 4):
        before.take([steady(n, 0.1 * n)])
    after.restore(before.state())
    assert before.counts["missing_blocks"] == 1
    for order in (before, after):
        assert len(order.take([steady(1, 0.1)])) == 0 and len(order.take([steady(5, 0.5)])) == 10
        assert order.counts["late"] == 10 and order.clock.resets == 0


@pytest.mark.parametrize("start", [0.0, 9.0])
def test_a_sender_that_starts_anew_is_followed(start):
    order = Order()
    before = [order.take([steady(n, 0.1 * n)]) for n in range(50)]
    after = [order.take([steady(n, start + 0.1 * n, seed=1)]) for n in range(50)]
    found = Samples.concatenate([*before, *after])
    assert len(found) == 1000 and order.counts["repeated"] == order.counts["late"] == 0
    assert order.clock.resets == (start == 0.0)


def test_joining_in_the_middle_waits_only_at_the_start_and_a_lost_block_for_the_hold():
    order = Order(hold=0.25)
    got = [len(order.take([steady(n, 0.1 * n)])) for n in (18, 17, 19, 20, 21)]
    assert got == [0, 0, 40 - 10, 10, 10] and order.counts["missing_blocks"] == 0
    order = Order(hold=0.25)
    parts = [order.take([steady(n, 0.1 * n)]) for n in (*range(1, 40), 0, 40, 41)]
    found = Samples.concatenate(parts)
    assert np.allclose(found.time, PERIOD * np.arange(10, 420)) and order.counts["late"] == 10
    assert order.counts["missing_blocks"] == 0 and order.clock.resets == 0
    order = Order(hold=0.5)
    got = [len(order.take([steady(n, 0.1 * n)])) for n in (0, 1, *range(3, 10))]
    # 0.5 s are held with the blocks 3 to 7, more with 8.
    assert got == [10, 10, 0, 0, 0, 0, 0, 60, 10]
    assert order.counts["missing_blocks"] == 1 and order.gaps.jumps == 0
    for repeated in (0, 10):
        assert len(order.take([steady(2, 0.2)])) == 0
        assert (order.counts["late"], order.counts["repeated"]) == (10, repeated)


def test_a_clock_that_is_set_at_each_row_takes_no_time_squared():
    order, rows = Order(), 20_000
    begun = time.perf_counter()
    assert len(order.take([block(4e7 * np.arange(rows), np.zeros(rows), 0)])) == rows
    assert order.clock.resets == rows - 1 and time.perf_counter() - begun < 15.0, "50 s where it is squared"


@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_live_counts_of_what_is_missing_are_those_of_a_log(jitter):
    """Late rows, alone or before a missing one, are not missing; blocks that never come are."""
    rng = np.random.default_rng(4)
    time = PERIOD * (np.arange(20_000) + jitter * rng.standard_normal(20_000))
    late = np.arange(50, 19_900, 37)
    time[late] += PERIOD * rng.choice([0.5, 0.5 + 1e-9, 0.8], late.size)
    gone = rng.choice(np.arange(300, 19_900), 300, replace=False)
    gone = np.concatenate([gone, *(np.arange(k, k + 20) for k in (1000, 5000, 9000))])
    time = np.delete(time, gone)
    gaps = Gaps()
    for part in np.split(time, np.sort(rng.choice(time.size, 500, replace=False))):
        gaps.count(part)
    told = check_time(time, 1.0)
    assert (gaps.dropped, gaps.jumps) == (told.dropped_samples, told.time_jumps) == (np.unique(gone).size, 3)


@pytest.mark.parametrize("damage", ["values", "arrays", "gaps/values"])
def test_a_damaged_state_is_refused_in_one_line(damage):
    order = Order()
    order.take([steady(None, 0.0)])
    state = order.state()
    for broken in ({k: v for k, v in state.items() if k != damage}, {**state, damage: state[damage][:2]}):
        with pytest.raises(InputError):
            Order().restore(broken)


def test_two_senders_that_count_alike_make_no_negative_counts():
    """The same numbers with other content, after a block that never came."""
    order = Order()
    order.take([steady(0, 0.0)])
    for number in range(2, 60):
        order.take([steady(number, 0.1 * number, seed=seed) for seed in (1, 2)])
        assert order.counts["missing_blocks"] in (0, 1)
    assert order.counts["missing_blocks"] == 1
