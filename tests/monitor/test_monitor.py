"""JSON lines to samples, whatever arrives; the monitor's loop gives what the offline diagnosis gives."""

import json
import threading
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.bounds import MAX_LINE_BYTES
from fdd.diagnosis.findings import Diagnosis, Quality
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.monitor import Event, Found, JsonLines, LineParser, Noted, Replay, Status, WallClock, watch
from fdd.monitor.stream import CLOCK_GAP_S, split_lines
from fdd.plant.rig import SpringLoad
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit


def line(**row: object) -> bytes:
    return json.dumps(row).encode()


def steady(start: float, count: int, **more: float) -> list[bytes]:
    return [line(time=start + 0.001 * k, position=0.001 * k, **more) for k in range(count)]


@given(
    text=st.lists(st.binary(max_size=30).map(lambda b: b.replace(b"\n", b"")), max_size=20),
    cuts=st.lists(st.integers(0, 400), max_size=10),
)
def test_however_the_stream_is_cut_its_lines_are_the_same(text, cuts):
    stream = b"\n".join(text)
    edges = [0, *sorted(min(c, len(stream)) for c in cuts), len(stream)]
    found, tail = [], b""
    for start, stop in pairwise(edges):
        lines, tail, _ = split_lines(tail, stream[start:stop], ended=False)
        found += lines
    lines, tail, _ = split_lines(tail, b"", ended=True)
    assert found + lines == [t for t in text if t.strip()]
    assert tail == b""


def test_a_line_without_end_stays_small_and_is_counted_once():
    tail, overlong = b"", 0
    for _ in range(10):
        lines, tail, more = split_lines(tail, b"x" * MAX_LINE_BYTES, ended=False)
        overlong += more
        assert lines == [] and len(tail) <= MAX_LINE_BYTES + 1
    lines, tail, more = split_lines(tail, b'\n{"time": 1}\n', ended=False)
    assert lines == [b'{"time": 1}'] and overlong + more == 1


@pytest.mark.parametrize("listed", [True, False])
def test_blocks_give_back_the_samples(listed):
    """As docs/serve-blocks.md describes them."""
    lines, stamps, position = [], 1e-3 * np.arange(2000), np.sin(np.arange(2000.0))
    for number, start in enumerate(range(0, 2000, 500)):
        rows = slice(start, start + 500)
        time = stamps[rows].tolist() if listed else {"start": stamps[start], "period": 0.001, "n": 500}
        columns = {"position": position[rows].tolist()}
        lines.append(line(schema="fdd.block/1", axis="A1", sequence=number, time=time, columns=columns))
    found = LineParser().samples(lines)
    np.testing.assert_allclose(found.time, stamps, atol=1e-12)
    assert np.array_equal(found["position"], position)


@pytest.mark.parametrize(
    "bad",
    [
        b"nonsense",
        b"[1, 2]",
        b"3",
        b"\xff\xfe\x00",
        *(b'{"time": 0.0005, "position": %s}' % value for value in (b'"far"', b"[1]", b"true")),
        *(b'{%s"position": 0.1}' % time for time in (b"", b'"time": null, ', b'"time": NaN, ')),
        b'{"time": 0.0005, "position": 0.1',
        b"[" * 5000,
        # A block that says more stamps than it has values.
        line(
            schema="fdd.block/1",
            time={"start": 0.0, "period": 1e-3, "n": 10**15},
            columns={"position": [0.0]},
        ),
    ],
)
def test_a_malformed_line_is_counted_and_spoils_no_other(bad):
    parser = LineParser()
    good = steady(0.0, 3)
    block = parser.samples([good[0], bad, *good[1:]])
    assert block.time.tolist() == [0.0, 0.001, 0.002]
    assert parser.malformed == 1
    assert parser.quality().notes == ["malformed lines left out: 1"]
    assert len(parser.remarks()) == 1
    parser.samples([bad])
    assert parser.malformed == 2 and parser.remarks() == []


def test_odd_values_late_rows_and_unknown_names_are_counted_and_told():
    parser = LineParser()
    huge = b'{"time": 0.001, "position": 1' + b"0" * 400 + b"}"
    block = parser.samples([line(time=0.0, position=float("inf")), huge, line(time=0.002, position=0.5)])
    assert np.isnan(block["position"][:2]).all() and block["position"][2] == 0.5
    assert parser.quality().nan_samples == 2
    parser, rows = LineParser(), steady(0.0, 5)
    block = parser.samples([rows[0], rows[2], rows[1], rows[2], rows[3]])
    assert block.time.tolist() == [0.0, 0.002, 0.003]
    assert parser.samples([rows[3], rows[4]]).time.tolist() == [0.004]
    assert "late or repeated lines left out: 3" in parser.quality().notes
    parser = LineParser()
    rows = [line(time=0.001 * k, position=0.0, **{f"extra_{k}": 1}) for k in range(100)]
    assert len(parser.samples(rows)) == 100
    assert 0 < len(parser.remarks()) <= 8
    assert "passed over" in parser.quality().notes[0]


def test_the_time_of_day_is_counted_from_the_start_and_one_wild_stamp_moves_the_rest_little():
    parser = LineParser()
    block = parser.samples(steady(1.7e9, 50))
    assert block.time[0] == 0.0 and abs(block.time[-1] - 0.049) < 1e-6 and parser.clock.offset == -1.7e9
    wild = line(time=1e12, position=0.0)
    block = LineParser().samples([*steady(0.0, 50), wild, *steady(0.051, 49)])
    assert len(block) == 100 and block.time[-1] < 0.1 + 2 * CLOCK_GAP_S


@pytest.mark.parametrize("restart", [0.0, 1e9])
def test_a_clock_that_was_set_is_followed(restart):
    parser = LineParser()
    before = parser.samples(steady(50.0, 100))
    after = parser.samples([*steady(50.1, 10), *steady(restart, 100)])
    assert len(before) == 100 and len(after) == 110
    steps = np.diff(np.concatenate([before.time, after.time]))
    assert np.isclose(steps, 0.001, atol=1e-6).sum() == 208
    assert np.isclose(steps.max(), CLOCK_GAP_S)
    assert parser.quality().time_jumps == 1
    assert any("the clock was set" in r for r in parser.remarks())


def test_a_map_names_and_converts_unless_it_needs_the_whole_log():
    mapped = ChannelMap.from_yaml(
        "time: {column: t, unit: ms}\nposition: {column: x, unit: mm, sign: -1, sign_of: d}\n"
        "pump_speed: {column: rpm, unit: rpm}\npump_angle: {from: pump_speed}"
    )
    signs: list[dict[str, object]] = [{"d": 1}, {"d": -2}, {}]
    rows = [line(t=5.0 + k, x=20.0, rpm=60.0, **sign) for k, sign in enumerate(signs)]
    block = LineParser(mapped).samples(rows)
    assert block.channels == ("position", "pump_speed")
    np.testing.assert_allclose(block.time, [0.005, 0.006, 0.007])
    np.testing.assert_allclose(block["position"], [-0.02, 0.02, 0.02])  # a sign holds until the next
    np.testing.assert_allclose(block["pump_speed"], 2 * np.pi)
    for angle in ("topic: /daq, field: x", "column: a, wrap: 4096", "column: a, sign_of: d"):
        time = "" if "topic" in angle else "time: {column: t}"
        with pytest.raises(InputError, match="stream takes plain columns"):
            LineParser(ChannelMap.from_yaml(f"pump_angle: {{{angle}}}\n{time}"))


def test_bar_declared_as_pascal_is_refused_after_five_seconds():
    parser = LineParser()
    rows = [line(time=0.01 * k, position=0.0, pressure_difference=12.0 + 0.1 * (k % 3)) for k in range(600)]
    parser.samples(rows[:400])
    with pytest.raises(InputError, match="look like bar"):
        parser.samples(rows[400:])


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
def leaking(unit) -> Samples:
    """14 s, leaking from 5 s on, with dropped rows and bursts of NaN."""
    made = {
        "faults": [{"fault": "internal_leakage", "severity": 0.9, "onset": 5.0}],
        "recording": {"dropped": 0.002, "late": 0.001, "nan_bursts_per_minute": 12.0},
        "duty": {"name": "steps", "amplitude": 0.04, "hold": 1.0},
    }
    return simulate(unit, Scenario(duration=14.0, load=SpringLoad(), seed=11, **made)).samples


@pytest.fixture(scope="module")
def leaking_lines(leaking) -> bytes:
    """Samples as a machine would stream them: missing values are null or left out by turns."""
    lines = []
    for k, time in enumerate(leaking.time.tolist()):
        values = {name: float(leaking[name][k]) for name in leaking.channels}
        kept = {n: v if np.isfinite(v) else None for n, v in values.items() if np.isfinite(v) or k % 2}
        lines.append(json.dumps({"time": time, **kept}).encode() + b"\n")
    return b"".join(lines)


@pytest.fixture
def pipeline(unit, tiny_model) -> Pipeline:
    return Pipeline(unit, tiny_model, keep_trajectories=False)


@pytest.fixture(scope="module")
def offline(unit, tiny_model, leaking) -> Diagnosis:
    whole = Pipeline(unit, tiny_model)
    whole.push(leaking)
    answer = whole.finish()
    # It begins at 5 s: of the first four stretches none is a reference, so it is told as from the start.
    assert answer.verdict == "faulty" and answer.faults[0].family == "leakage", "else all this shows nothing"
    assert 0.0 <= answer.faults[0].onset_s < 6.0
    return answer


def same(found: Diagnosis, offline: Diagnosis) -> bool:
    return found.model_dump(exclude={"quality"}) == offline.model_dump(exclude={"quality"})


def test_a_replay_gives_the_offline_findings(pipeline, leaking, offline, clock):
    events: list[Event] = []
    answer = watch(Replay(leaking, Quality(), speed=40.0, clock=clock), pipeline, events.append, clock=clock)
    assert same(answer, offline)
    # Ten seconds may be named otherwise than the whole log; the alarm comes when the finding says.
    (found,) = [e for e in events if isinstance(e, Found)]
    assert found.time == found.finding.detected_s <= offline.faults[0].detected_s
    assert clock.now() - 100.0 == pytest.approx(leaking.duration / 40.0, abs=1e-6)


def test_json_lines_give_the_offline_findings(pipeline, leaking_lines, offline):
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


def test_findings_come_with_their_block_and_status_as_often_as_asked(pipeline, leaking, clock):
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


def test_duration_and_stop_end_it(unit, tiny_model, leaking, clock):
    def answer(**options) -> Diagnosis:
        source = Replay(leaking, Quality(), speed=1.0, clock=clock)
        pipeline = Pipeline(unit, tiny_model, keep_trajectories=False)
        return watch(source, pipeline, lambda e: None, clock=clock, **options)

    assert answer(duration=6.0).duration_s == pytest.approx(6.0, abs=0.01)
    started = clock.now()
    assert answer(stopped=lambda: clock.now() - started > 3.0).duration_s == pytest.approx(3.0, abs=0.3)


def test_remarks_become_events_and_an_error_of_the_stream_is_told(pipeline, clock):
    text, events = iter([b'bad\n{"time": 0, "position": 0}\n', b""]), list[Event]()
    source = JsonLines(lambda most: next(text), LineParser(), clock=clock)
    watch(source, pipeline, events.append, clock=clock)
    assert len(events) == 1 and isinstance(events[0], Noted) and "malformed" in events[0].text

    def broken(most: int) -> bytes:
        raise OSError("the line was cut")

    with pytest.raises(OSError, match="the line was cut"):
        watch(JsonLines(broken, LineParser(), clock=clock), pipeline, events.append, clock=clock)


def test_a_long_hole_is_waited_through_in_steps(clock):
    """So that a display stays alive; the log still takes as long as it took."""
    stamps = np.concatenate([np.arange(100) * 0.01, 6.0 + np.arange(100) * 0.01])
    log = Samples(stamps, {"position": np.zeros(200)})
    blocks = list(Replay(log, Quality(), speed=2.0, clock=clock))
    assert Samples.concatenate([b for b in blocks if len(b)]).time.tolist() == stamps.tolist()
    empty = sum(not len(b) for b in blocks)
    assert 20 <= empty <= 26, "half of five seconds, each tenth of a second"
    assert max(clock.slept) <= 0.2 + 1e-9
    assert clock.now() - 100.0 == pytest.approx(stamps[-1] / 2.0)
