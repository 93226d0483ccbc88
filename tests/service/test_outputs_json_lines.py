"""JSON lines stay whole through rotation, crashes and full disks."""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from outputs_fakes import FakeParcel, transition

from fdd.errors import InputError
from fdd.service.outputs import json_lines
from fdd.service.outputs.courier import Undelivered
from fdd.service.outputs.json_lines import JsonLines


def numbers(path: Path) -> list[int]:
    return [json.loads(line)["n"] for line in path.read_text("utf-8").splitlines()]


@contextmanager
def no_file_beyond(size: int) -> Iterator[None]:
    """The system cuts writes off at a size, as a disk does that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_lines_go_on_in_a_new_file_and_the_oldest_go(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path, most_bytes=100)
    for n in range(100):
        lines.append({"n": n})
    files = [path.with_name(f"events.jsonl.{k}") for k in (4, 3, 2, 1)] + [path]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert all(file.stat().st_size <= 100 for file in files)
    kept = [n for file in files for n in numbers(file)]
    assert kept == list(range(kept[0], 100)) and len(kept) > 40


def test_a_full_disk_leaves_whole_lines_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path)
    with no_file_beyond(1105):
        told = 0
        for n in range(10):
            try:
                lines.append({"n": n, "text": "x" * 180}, sync=True)
                told += 1
            except Undelivered as error:
                assert error.down and str(path) in str(error)
        assert 0 < told < 10 and 1105 - path.stat().st_size > 100, "the disk was not full"
        assert numbers(path) == list(range(told))
    lines.append({"n": told})
    assert numbers(path) == list(range(told + 1))


def test_half_a_line_of_a_crash_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    whole = b'{"n":0}\n{"n":1}\n'
    for half in (b"", b"{", b'{"n":2', b'{"text":"' + b"x" * 100_000):
        path.write_bytes(whole + half)
        JsonLines(path).append({"n": 2})
        assert numbers(path) == [0, 1, 2]
    path.write_bytes(b'{"n":')
    JsonLines(path).append({"n": 0})
    assert numbers(path) == [0]


def test_a_file_of_others_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(b"a line\nmore that does not end")
    with pytest.raises(Undelivered, match="none of ours"):
        JsonLines(path).append({"n": 0})
    assert path.read_bytes() == b"a line\nmore that does not end"


def test_a_file_that_others_move_away_is_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path)
    lines.append({"n": 0})
    path.rename(tmp_path / "taken")
    lines.append({"n": 1})
    assert numbers(path) == [1]


def test_alarms_are_synced_and_statuses_thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_size))
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path)
    for value in (1.0, float("nan")):
        lines.note("A1", {"value": value})
    assert not synced
    lines.deliver(FakeParcel(3, "alarm", transition(), "jsonl"))
    assert synced == [path.stat().st_size]
    monkeypatch.setattr(json_lines, "STATUS_EVERY_S", 0.0)
    lines.note("A1", {"value": float("nan")})
    told = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    assert [line["kind"] for line in told] == ["status", "alarm", "status"]
    assert told[1] == {"id": 3, "kind": "alarm", "data": transition()}
    assert told[2]["data"] == {"value": None}, "NaN is no JSON"


def test_a_folder_that_is_missing_is_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        JsonLines(tmp_path / "none" / "events.jsonl")
