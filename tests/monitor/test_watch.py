"""The monitor's loop gives what the offline diagnosis gives, however its samples come."""

from __future__ import annotations

import threading
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from fdd.diagnosis.findings import Diagnosis, Quality
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.monitor import Event, Found, JsonLines, LineParser, Noted, Replay, Status, watch
from fdd.monitor.clock import WallClock
from fdd.monitor.state import load_state, save_state
from fdd.samples import Samples
from fdd.unit import Unit


@pytest.fixture
def pipeline(unit: Unit, tiny_model: Model) -> Pipeline:
    return Pipeline(unit, tiny_model, keep_trajectories=False)


@pytest.fixture(scope="session")
def offline(unit: Unit, tiny_model: Model, leaking: Samples) -> Diagnosis:
    whole = Pipeline(unit, tiny_model)
    whole.push(leaking)
    return whole.finish()


def same(found: Diagnosis, offline: Diagnosis) -> bool:
    ignored = {"quality"}
    return found.model_dump(exclude=ignored) == offline.model_dump(exclude=ignored)


def test_the_offline_diagnosis_finds_the_leak(offline: Diagnosis) -> None:
    assert offline.verdict == "faulty" and offline.faults[0].family == "leakage"
    # It begins at 5 s: of the first four stretches none is a reference, so it is told as from the start.
    assert 0.0 <= offline.faults[0].onset_s < 6.0


@pytest.mark.parametrize("speed", [None, 1.0, 40.0])
def test_a_replay_gives_the_offline_findings(pipeline, leaking, offline, clock, speed) -> None:
    events: list[Event] = []
    answer = watch(Replay(leaking, Quality(), speed=speed, clock=clock), pipeline, events.append, clock=clock)
    assert same(answer, offline)
    found = [e for e in events if isinstance(e, Found)]
    assert [e.time for e in found] == [offline.faults[0].detected_s]
    expected = 0.0 if speed is None else leaking.duration / speed
    assert clock.now() - 100.0 == pytest.approx(expected, abs=1e-6)


def test_json_lines_give_the_offline_findings(pipeline, leaking_lines, offline) -> None:
    rng = np.random.default_rng(2)
    cuts = np.concatenate([[0], np.cumsum(rng.integers(1, 200_000, 400))])
    chunks = iter([*(leaking_lines[a:b] for a, b in pairwise(cuts)), b""])
    clock = WallClock(threading.Event())
    events: list[Event] = []
    source = JsonLines(lambda most: next((c for c in chunks if c), b""), LineParser(), clock=clock)
    answer = watch(source, pipeline, events.append, clock=clock)
    assert same(answer, offline)
    assert [type(e) for e in events] == [Found]
    assert answer.quality.nan_samples > 0 and answer.quality.dropped_samples > 0


def test_a_finding_comes_with_its_block_and_not_at_the_end(pipeline, leaking, clock) -> None:
    seen_at: list[float] = []
    watch(
        Replay(leaking, Quality(), speed=1.0, clock=clock), pipeline,
        lambda e: seen_at.append(clock.now() - 100.0 - e.time), clock=clock,
    )  # fmt: skip
    assert len(seen_at) == 1 and 0.0 <= seen_at[0] < 0.3


def test_duration_and_stop_end_it(unit, tiny_model, leaking, clock) -> None:
    def answer(**options) -> Diagnosis:
        source = Replay(leaking, Quality(), speed=1.0, clock=clock)
        return watch(
            source,
            Pipeline(unit, tiny_model, keep_trajectories=False),
            lambda e: None,
            clock=clock,
            **options,
        )

    assert answer(duration=6.0).duration_s == pytest.approx(6.0, abs=0.01)
    started = clock.now()
    assert answer(stopped=lambda: clock.now() - started > 3.0).duration_s == pytest.approx(3.0, abs=0.3)


def test_status_comes_as_often_as_asked(pipeline, leaking, clock) -> None:
    events: list[Event] = []
    watch(
        Replay(leaking, Quality(), speed=1.0, clock=clock), pipeline, events.append, clock=clock,
        status_every=1.0,
    )  # fmt: skip
    states = [e for e in events if isinstance(e, Status)]
    assert 12 <= len(states) <= 15
    assert states[0].verdict == "inconclusive" and states[-1].verdict == "faulty"
    assert states[-1].probabilities["leakage"] > 0.5
    assert sum(states[-1].probabilities.values()) == pytest.approx(1.0, abs=0.01)


def test_a_silent_stream_can_be_stopped(pipeline) -> None:
    stop = threading.Event()
    released = threading.Event()
    threading.Timer(0.3, stop.set).start()

    def silent(most: int) -> bytes:
        released.wait(20.0)
        return b""

    source = JsonLines(silent, LineParser(), clock=WallClock(stop))
    answer = watch(source, pipeline, lambda e: None, clock=WallClock(stop), stopped=stop.is_set)
    released.set()
    assert answer.verdict == "inconclusive" and answer.samples == 0


def test_an_error_of_the_stream_is_told(pipeline, clock) -> None:
    def broken(most: int) -> bytes:
        raise OSError("the line was cut")

    with pytest.raises(OSError, match="the line was cut"):
        watch(JsonLines(broken, LineParser(), clock=clock), pipeline, lambda e: None, clock=clock)


def test_remarks_become_events(pipeline, clock) -> None:
    text = iter([b'bad\n{"time": 0, "position": 0}\n', b""])
    events: list[Event] = []
    source = JsonLines(lambda most: next(text), LineParser(), clock=clock)
    watch(source, pipeline, events.append, clock=clock)
    assert len(events) == 1 and isinstance(events[0], Noted) and "malformed" in events[0].text


@pytest.mark.parametrize("stop_at", [0.2, 3.0, 8.0])
def test_it_goes_on_from_a_saved_state(
    unit, tiny_model, leaking, offline, clock, tmp_path: Path, stop_at: float
) -> None:
    path = tmp_path / "axis.npz"

    def session(**options) -> Diagnosis:
        pipeline = Pipeline(unit, tiny_model, keep_trajectories=False)
        after = load_state(path, pipeline)[0] if path.exists() else float("nan")
        rest = leaking.rows(int((leaking.time <= after).sum()), len(leaking))
        source = Replay(rest, Quality(), speed=1.0, clock=clock)
        return watch(
            source, pipeline, lambda e: None, clock=clock,
            save=lambda last: save_state(path, pipeline, last_time=last, offset=0.0), **options,
        )  # fmt: skip

    first = session(duration=stop_at)
    assert first.samples < len(leaking)
    assert same(session(), offline)
    assert [p.name for p in tmp_path.iterdir()] == ["axis.npz"]


def test_a_restored_pipeline_is_the_one_that_went_on(unit, tiny_model, leaking) -> None:
    """Every array of the state, not the answer alone, at cuts within a frame and within a look."""
    whole = Pipeline(unit, tiny_model, keep_trajectories=False)
    whole.push(leaking)
    whole.finish()  # takes the frames that wait for the next look
    first, found = Pipeline(unit, tiny_model, keep_trajectories=False), []
    edges = [0, 320, 4711, 10_333, len(leaking)]
    for a, b in pairwise(edges):
        following = Pipeline(unit, tiny_model, keep_trajectories=False)
        if a:
            following.restore(first.state())
        found += following.push(leaking.rows(a, b))
        following.finish()
        first = following
    expected, state = whole.state(), first.state()
    assert state.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(state[name], value, err_msg=name)
    assert [f.family for f in found] == ["leakage"]


@pytest.mark.parametrize("damage", ["text", "empty", "cut", "pickle", "strange"])
def test_a_damaged_state_is_refused(pipeline, leaking, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "axis.npz"
    pipeline.push(leaking.rows(0, 2000))
    save_state(path, pipeline, last_time=2.0, offset=0.0)
    content = path.read_bytes()
    if damage in ("text", "empty", "cut"):
        path.write_bytes({"text": b"hello", "empty": b"", "cut": content[: len(content) // 2]}[damage])
    elif damage == "pickle":
        np.savez(path, allow_pickle=True, pipeline=np.array([{"a": 1}], dtype=object))
    else:
        np.savez(path, pipeline=np.zeros(3))
    with pytest.raises(InputError) as refused:
        load_state(path, pipeline)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)


def test_a_state_of_another_unit_is_refused(pipeline, tiny_model, leaking, tmp_path: Path) -> None:
    path = tmp_path / "axis.npz"
    pipeline.push(leaking.rows(0, 2000))
    save_state(path, pipeline, last_time=2.0, offset=0.0)
    with pytest.raises(InputError, match="unit 'axis_a'"):
        load_state(path, Pipeline(Unit.load("axis_b"), tiny_model))


def test_what_is_said_of_a_streams_scales_comes_once_before_its_findings(pipeline, leaking, clock) -> None:
    class Scales:
        def push(self, samples: Samples) -> list[str]:
            return ["a gain is odd"] if samples.time[0] == leaking.time[0] else []

    events: list[Event] = []
    source = Replay(leaking, Quality(), speed=None, clock=clock)
    watch(source, pipeline, events.append, clock=clock, scales=Scales())
    assert [e.text for e in events if isinstance(e, Noted)] == ["a gain is odd"]
    assert isinstance(events[0], Noted)
