"""The monitor's loop gives what the offline diagnosis gives, however its samples come."""

from __future__ import annotations

import json
import threading
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from fdd.diagnosis.findings import Diagnosis, Quality
from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.monitor import Event, Found, JsonLines, LineParser, Noted, Replay, Status, WallClock, watch
from fdd.plant.load import SpringLoad
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit


class FakeClock:
    """Time passes only by sleeping."""

    def __init__(self) -> None:
        self.time = 100.0
        self.slept: list[float] = []

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.time += max(seconds, 0.0)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit.load("axis_a")


@pytest.fixture(scope="module")
def leaking(unit: Unit) -> Samples:
    """14 s, leaking from 5 s on, with dropped rows and bursts of NaN."""
    made = {
        "faults": [{"fault": "internal_leakage", "severity": 0.9, "onset": 5.0}],
        "recording": {"dropped": 0.002, "late": 0.001, "nan_bursts_per_minute": 12.0},
        "duty": {"name": "steps", "amplitude": 0.04, "hold": 1.0},
    }
    return simulate(unit, Scenario(duration=14.0, load=SpringLoad(), seed=11, **made)).samples


@pytest.fixture(scope="module")
def leaking_lines(leaking: Samples) -> bytes:
    """Samples as a machine would stream them: missing values are null or left out by turns."""
    lines = []
    for k, time in enumerate(leaking.time.tolist()):
        values = {name: float(leaking[name][k]) for name in leaking.channels}
        kept = {n: v if np.isfinite(v) else None for n, v in values.items() if np.isfinite(v) or k % 2}
        lines.append(json.dumps({"time": time, **kept}).encode() + b"\n")
    return b"".join(lines)


@pytest.fixture
def pipeline(unit: Unit, tiny_model: Model) -> Pipeline:
    return Pipeline(unit, tiny_model, keep_trajectories=False)


@pytest.fixture(scope="module")
def offline(unit: Unit, tiny_model: Model, leaking: Samples) -> Diagnosis:
    whole = Pipeline(unit, tiny_model)
    whole.push(leaking)
    answer = whole.finish()
    # It begins at 5 s: of the first four stretches none is a reference, so it is told as from the start.
    assert answer.verdict == "faulty" and answer.faults[0].family == "leakage", "else all this shows nothing"
    assert 0.0 <= answer.faults[0].onset_s < 6.0
    return answer


def same(found: Diagnosis, offline: Diagnosis) -> bool:
    return found.model_dump(exclude={"quality"}) == offline.model_dump(exclude={"quality"})


def test_a_replay_gives_the_offline_findings(pipeline, leaking, offline, clock) -> None:
    events: list[Event] = []
    answer = watch(Replay(leaking, Quality(), speed=40.0, clock=clock), pipeline, events.append, clock=clock)
    assert same(answer, offline)
    found = [e for e in events if isinstance(e, Found)]
    assert [e.time for e in found] == [offline.faults[0].detected_s]
    assert clock.now() - 100.0 == pytest.approx(leaking.duration / 40.0, abs=1e-6)


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


def test_findings_come_with_their_block_and_status_as_often_as_asked(pipeline, leaking, clock) -> None:
    class Scales:
        def push(self, samples: Samples) -> list[str]:
            return ["a gain is odd"] if samples.time[0] == leaking.time[0] else []

    events: list[tuple[float, Event]] = []
    watch(
        Replay(leaking, Quality(), speed=1.0, clock=clock), pipeline,
        lambda e: events.append((clock.now() - 100.0, e)), clock=clock, status_every=1.0, scales=Scales(),
    )  # fmt: skip
    assert [e.text for _, e in events if isinstance(e, Noted)] == ["a gain is odd"]
    assert isinstance(events[0][1], Noted), "before its findings"
    (late,) = (now - e.time for now, e in events if isinstance(e, Found))
    assert 0.0 <= late < 0.3
    states = [e for _, e in events if isinstance(e, Status)]
    assert 12 <= len(states) <= 15
    assert states[0].verdict == "inconclusive" and states[-1].verdict == "faulty"
    assert states[-1].probabilities["leakage"] > 0.5
    assert sum(states[-1].probabilities.values()) == pytest.approx(1.0, abs=0.01)


def test_duration_and_stop_end_it(unit, tiny_model, leaking, clock) -> None:
    def answer(**options) -> Diagnosis:
        source = Replay(leaking, Quality(), speed=1.0, clock=clock)
        pipeline = Pipeline(unit, tiny_model, keep_trajectories=False)
        return watch(source, pipeline, lambda e: None, clock=clock, **options)

    assert answer(duration=6.0).duration_s == pytest.approx(6.0, abs=0.01)
    started = clock.now()
    assert answer(stopped=lambda: clock.now() - started > 3.0).duration_s == pytest.approx(3.0, abs=0.3)


def test_remarks_become_events_and_an_error_of_the_stream_is_told(pipeline, clock) -> None:
    text, events = iter([b'bad\n{"time": 0, "position": 0}\n', b""]), list[Event]()
    source = JsonLines(lambda most: next(text), LineParser(), clock=clock)
    watch(source, pipeline, events.append, clock=clock)
    assert len(events) == 1 and isinstance(events[0], Noted) and "malformed" in events[0].text

    def broken(most: int) -> bytes:
        raise OSError("the line was cut")

    with pytest.raises(OSError, match="the line was cut"):
        watch(JsonLines(broken, LineParser(), clock=clock), pipeline, events.append, clock=clock)


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
