"""Recordings hold what was measured around an alarm, as fdd.logs reads them, whatever cuts them off."""

from __future__ import annotations

import json
import os
import resource
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from outputs_fakes import measured, transition

from fdd.logs import read_log
from fdd.samples import Samples
from fdd.service.bus import Bus, Event
from fdd.service.config import Recording
from fdd.service.outputs import recorder as recorder_module
from fdd.service.outputs.recorder import Recorder, keep_within

RATE = 100
START = 1000.0
"""s of the stream's clock, which begins anywhere."""


def signal(first: float, last: float) -> Samples:
    """Rows from `first` to before `last`, s, the same however they are cut."""
    k = np.arange(round(first * RATE), round(last * RATE))
    time = k / RATE
    return Samples(
        time,
        {
            "position": 0.02 * np.sin(time),
            "pump_angle": 1e6 + 40.0 * time,
            "pressure_1": np.where(k % 97 == 0, np.nan, 5e6 + 1e5 * np.cos(3 * time)),
            "pressure_2": 4e6 + 1e5 * np.sin(3 * time),
        },
    )


class Rig:
    """A recorder that is worked by hand, and its bus."""

    def __init__(self, folder: Path, **given: Any) -> None:
        usual = {"folder": folder, "before": 20.0, "after": 20.0, "most_bytes": 1 << 30}
        self.folder, self.bus = folder, Bus()
        self.recorder = Recorder(Recording(**{**usual, **given}), self.bus, lambda axis: "name: x\n")

    def stream(self, first: float, last: float, axis: str = "A1", block: float = 0.3) -> None:
        edges = [*np.arange(first, last, block), last]
        for a, b in pairwise(edges):
            self.bus.publish(measured(axis, signal(a, b)))
            self.work()

    def alarm(self, time: float, axis: str = "A1", **given: Any) -> None:
        told = transition(axis=axis, onset=time - 5, detected=time, **given)
        self.bus.publish(Event("alarm", axis, time, told))
        self.work()

    def status(self, time: float, leakage: float, axis: str = "A1") -> None:
        data = {
            "estimates": {"leakage": {"value": leakage, "std": 1e-13, "observable": True}},
            "probabilities": {"healthy": 0.75}, "samples": 5,
        }  # fmt: skip
        self.bus.publish(Event("status", axis, time, data))
        self.work()

    def work(self) -> None:
        self.recorder.work()

    def files(self) -> list[Path]:
        return sorted(self.folder.glob("*.mcap"))


def messages(path: Path) -> dict[str, list[tuple[float, bytes]]]:
    found: dict[str, list[tuple[float, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time / 1e9, message.data))
    return found


def same(samples: Samples, first: float, last: float) -> None:
    """The rows are those of the signal from `first` to before `last`."""
    wanted = signal(first, last)
    assert len(samples) == len(wanted)
    np.testing.assert_allclose(samples.time, wanted.time - wanted.time[0], atol=2e-9)
    for name in wanted.channels:
        np.testing.assert_array_equal(samples[name], wanted[name], err_msg=name)


def test_a_recording_is_what_was_measured_before_and_after(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 100)
    for k in range(10):
        rig.status(START + 10 * k, 6e-12 + k * 1e-13)
    rig.alarm(START + 100)
    assert not rig.files() and rig.recorder.status()["running"] == 1
    rig.stream(START + 100, START + 130)
    [path] = rig.files()
    log = read_log(path)
    same(log.samples, START + 80, START + 80 + len(log.samples) / RATE)
    assert 40.0 <= log.samples.duration <= 42.0
    found = messages(path)
    assert set(found) == {f"/eha/A1/{t}" for t in ("measurement", "estimate", "diagnosis", "events")}
    assert len(found["/eha/A1/estimate"]) == 2
    events = [json.loads(data) for _, data in found["/eha/A1/events"]]
    assert [e["message"][:41] for e in events] == [
        "pump_wear or internal_leakage begins (con", "pump_wear or internal_leakage detected (c",
    ]  # fmt: skip
    begun = found["/eha/A1/measurement"][0][0]
    assert [time - begun for time, _ in found["/eha/A1/events"]] == pytest.approx([15.0, 20.0], abs=1e-3)
    with path.open("rb") as file:
        metadata = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    assert metadata["unit"] == {"yaml": "name: x\n"}
    assert json.loads(metadata["diagnosis"]["json"])["alarms"][0]["action"] == "RAISED"


def test_log_times_are_unix_times_whatever_the_streams_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 1.8e9
    monkeypatch.setattr(recorder_module.time, "time", lambda: now)
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.stream(now - 40, now - 10, "A2")
    rig.alarm(START + 30, id=1)
    rig.alarm(now - 10, "A2", id=2)
    rig.stream(START + 30, START + 51)
    rig.stream(now - 10, now + 11, "A2")
    ends = [messages(path)[f"/eha/{axis}/measurement"][-1][0]
            for path, axis in zip(rig.files(), ("A1", "A2"), strict=True)]  # fmt: skip
    # The first file's clock was tied to ours at the alarm, 21 s of data before its end.
    assert ends[0] == pytest.approx(now + 21, abs=1.0)
    assert ends[1] == pytest.approx(now + 11, abs=1.0)


def test_a_second_alarm_extends_the_file_up_to_a_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.alarm(START + 30, id=1)
    rig.stream(START + 30, START + 45)
    rig.alarm(START + 45, id=2)
    rig.alarm(START + 46, id=2, action="ACKNOWLEDGED", state="ACKED")
    rig.stream(START + 45, START + 60)
    assert not rig.files()
    rig.stream(START + 60, START + 70)
    [path] = rig.files()
    assert read_log(path).samples.duration == pytest.approx(55.0, abs=1.5)
    assert len(messages(path)["/eha/A1/events"]) == 4
    monkeypatch.setattr(recorder_module, "LONGEST_S", 60.0)
    for k in range(10):
        rig.stream(START + 70 + 10 * k, START + 80 + 10 * k)
        rig.alarm(START + 80 + 10 * k, id=3 + k)
    lengths = [read_log(p).samples.duration for p in rig.files()[1:]]
    assert lengths and max(lengths) <= 62.0


def test_what_is_no_new_alarm_records_nothing(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.alarm(START + 30, action="ACKNOWLEDGED", state="ACKED")
    rig.alarm(START + 30, axis="never heard of")
    rig.stream(START + 30, START + 60)
    assert not list(tmp_path.iterdir())


def test_a_clock_that_is_set_back_ends_the_recording(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.alarm(START + 30)
    rig.stream(START + 30, START + 35)
    rig.stream(START - 500, START - 490)
    [path] = rig.files()
    assert read_log(path).samples.duration == pytest.approx(25.0, abs=1.5)
    rig.alarm(START - 490, id=2)
    rig.stream(START - 490, START - 465)
    [*_, other] = rig.files()
    same(read_log(other).samples, START - 500, START - 500 + len(read_log(other).samples) / RATE)


def test_an_axis_that_falls_silent_leaves_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    rig.alarm(START + 30)
    later = recorder_module.time.monotonic() + 21.0
    monkeypatch.setattr(recorder_module.time, "monotonic", lambda: later)
    rig.work()
    assert read_log(rig.files()[0]).samples.duration == pytest.approx(20.0, abs=1.5)


def test_the_folder_stays_within_its_bound_and_others_files_stay(tmp_path: Path) -> None:
    (tmp_path / "notes.mcap").write_bytes(b"x" * 5_000_000)
    most = 1 << 20
    rig = Rig(tmp_path, most_bytes=most, before=5.0, after=5.0)
    rig.stream(START, START + 10)
    for k in range(30):
        rig.alarm(START + 10 + 20 * k, id=k)
        rig.stream(START + 10 + 20 * k, START + 30 + 20 * k)
        ours = [p for p in rig.files() if p.name != "notes.mcap"]
        assert sum(p.stat().st_size for p in ours) <= most
    ids = sorted(int(p.stem.rpartition("_")[2]) for p in ours)
    assert rig.recorder.files == 30 > len(ids) > 1 and (tmp_path / "notes.mcap").exists()
    assert ids == list(range(30))[-len(ids) :], "the oldest went"


def test_the_oldest_go_first_but_never_the_newest(tmp_path: Path) -> None:
    paths = [tmp_path / f"A1_20260101T00000{k}Z_{k}.mcap" for k in range(4)]
    for k, path in enumerate(paths):
        path.write_bytes(b"x" * 100)
        os.utime(path, (1000 + k, 1000 + k))
    keep_within(tmp_path, 250, newest=paths[0])
    assert sorted(tmp_path.iterdir()) == [paths[0], paths[3]]


def test_a_full_disk_is_told_and_the_next_recording_is_whole(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 30)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        rig.alarm(START + 30)
        rig.stream(START + 30, START + 60)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert str(tmp_path) in rig.recorder.status()["last_error"]
    assert rig.recorder.status()["running"] == 0 and not list(tmp_path.iterdir()), "nothing is half-written"
    rig.alarm(START + 60, id=2)
    rig.stream(START + 60, START + 82)
    assert read_log(rig.files()[-1]).samples.duration == pytest.approx(40.0, abs=1.5)
    assert rig.recorder.status()["last_error"] == ""


def test_memory_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(tmp_path)
    rig.stream(START, START + 200)
    axis = rig.recorder._axes["A1"]
    held = lambda: sum(8 * len(part) * (1 + len(part.channels)) for part in axis.ring)  # noqa: E731
    assert held() == axis.size <= (20 + 10 + 1) * RATE * 8 * 5
    monkeypatch.setattr(recorder_module, "MOST_BYTES", 50_000)
    rig.stream(START + 200, START + 210)
    assert held() == axis.size <= 50_000
    rig.alarm(START + 210)
    rig.stream(START + 210, START + 230)
    assert len(rig.files()) == 1, "a recording ends at the bound"
    assert held() <= 51_000
    for k in range(5000):
        rig.bus.publish(measured("A1", signal(START + 300 + k, START + 300 + k + 0.05)))
    rig.work()
    assert rig.recorder.status()["lost_blocks"] == 1000


def test_odd_names_stay_within_the_folder(tmp_path: Path) -> None:
    rig = Rig(tmp_path / "in")
    rig.stream(START, START + 10, "../../hall/A1")
    rig.alarm(START + 10, "../../hall/A1")
    rig.stream(START + 10, START + 31, "../../hall/A1")
    assert [p.name.split("_2")[0] for p in rig.files()] == ["_._.._hall_A1"]
    assert [p.name for p in tmp_path.iterdir()] == ["in"]
