"""Clocks, holes, signs, gaps and kept states of a stream."""

from __future__ import annotations

import itertools
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.diagnosis.findings import Quality
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.monitor import LineParser, Replay, watch
from fdd.monitor import state as state_module
from fdd.monitor.clock import WallClock
from fdd.monitor.state import CLOCK, load_state, save_state
from fdd.monitor.stream_clock import Gaps
from fdd.samples import Samples
from fdd.unit import Unit


def test_the_wall_clock_waits_and_stops_waiting() -> None:
    stop = threading.Event()
    clock = WallClock(stop)
    before = clock.now()
    clock.sleep(-1.0)
    clock.sleep(0.05)
    assert 0.05 <= clock.now() - before < 5.0
    threading.Timer(0.05, stop.set).start()
    began = time.monotonic()
    clock.sleep(30.0)
    assert time.monotonic() - began < 15.0


def test_a_long_hole_is_waited_through_in_steps(clock: Any) -> None:
    """So that a display stays alive; the log still takes as long as it took."""
    stamps = np.concatenate([np.arange(100) * 0.01, 6.0 + np.arange(100) * 0.01])
    log = Samples(stamps, {"position": np.zeros(200)})
    blocks = list(Replay(log, Quality(), speed=2.0, clock=clock))
    assert Samples.concatenate([b for b in blocks if len(b)]).time.tolist() == stamps.tolist()
    empty = sum(not len(b) for b in blocks)
    assert 20 <= empty <= 26, "half of five seconds, each tenth of a second"
    assert max(clock.slept) <= 0.2 + 1e-9
    assert clock.now() - 100.0 == pytest.approx(stamps[-1] / 2.0)


def test_the_state_is_saved_each_minute_where_nothing_else_is_asked(
    unit: Unit, tiny_model: Model, leaking: Samples, clock: Any
) -> None:
    saved: list[float] = []
    watch(
        Replay(leaking, Quality(), speed=0.1, clock=clock),
        Pipeline(unit, tiny_model, keep_trajectories=False),
        lambda e: None, clock=clock, save=saved.append,
    )  # fmt: skip
    assert saved == pytest.approx([6.0, 12.0, leaking.time[-1]], abs=0.2)


def test_a_sign_may_come_in_a_column_of_its_own() -> None:
    text = "time: {column: t}\nposition: {column: x, unit: mm, sign_of: d}\npump_speed: {column: w}"
    parser = LineParser(ChannelMap.from_yaml(text))
    lines = [b'{"t": 0.0, "x": 5, "d": 1, "w": 2}', b'{"t": 0.1, "x": 5, "d": -2, "w": 2}',
             b'{"t": 0.2, "x": 5, "w": 2}']  # fmt: skip
    block = parser.samples(lines)
    np.testing.assert_allclose(block["position"], [0.005, -0.005, -0.005])  # it holds until the next
    np.testing.assert_allclose(block["pump_speed"], [2.0, 2.0, 2.0])


@given(cuts=st.lists(st.integers(1, 599), max_size=30), lost=st.sets(st.integers(1, 590), max_size=40))
def test_missing_rows_are_the_same_however_a_stream_is_cut(cuts: list[int], lost: set[int]) -> None:
    stamps = np.delete(np.arange(600) * 0.002, sorted(lost))
    edges = [0, *sorted({c for c in cuts if c < stamps.size}), stamps.size]
    whole, parts = Gaps(), Gaps()
    whole.count(stamps)
    for a, b in itertools.pairwise(edges):
        parts.count(stamps[a:b])
    assert (parts.dropped, parts.jumps) == (whole.dropped, whole.jumps)
    assert whole.dropped == len(lost)


@pytest.fixture
def begun(unit: Unit, tiny_model: Model, leaking: Samples) -> Pipeline:
    pipeline = Pipeline(unit, tiny_model, keep_trajectories=False)
    pipeline.push(leaking.rows(0, 2000))
    return pipeline


def test_a_state_of_more_bytes_than_are_read_is_refused(
    begun: Pipeline, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that is in it together, though each part is small."""
    path = tmp_path / "axis.npz"
    save_state(path, begun, last_time=2.0, offset=7.0)
    assert load_state(path, begun) == (2.0, 7.0)
    monkeypatch.setattr(state_module, "MAX_STATE_BYTES", path.stat().st_size // 2)
    with pytest.raises(InputError, match="bytes, at most"):
        load_state(path, begun)


class Runs:
    """What a pickle may do where it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.path),)


def test_a_state_runs_nothing_of_its_own(begun: Pipeline, tmp_path: Path) -> None:
    path, made = tmp_path / "axis.npz", tmp_path / "made"
    arrays: dict[str, Any] = {**begun.state(), CLOCK: np.array([2.0, 0.0])}
    np.savez(path, allow_pickle=True, **arrays, more=np.array([Runs(made)], dtype=object))
    with pytest.raises(InputError, match="not a monitor's state"):
        load_state(path, begun)
    assert not made.exists()
