"""JSON lines stay whole through rotation and full disks."""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from outputs_fakes import message, transition

from fdd.service.outputs import targets
from fdd.service.outputs.targets import JsonLines, Undelivered


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


def test_a_full_file_makes_room_and_the_folder_stays_bounded(tmp_path: Path) -> None:
    path, older = tmp_path / "events.jsonl", tmp_path / "events.jsonl.1"
    lines = JsonLines(path, most_bytes=100)
    for n in range(100):
        lines.append({"n": n})
    assert sorted(tmp_path.iterdir()) == [path, older]
    assert all(file.stat().st_size <= 100 for file in (path, older))
    kept = [*numbers(older), *numbers(path)]
    assert kept == list(range(kept[0], 100)) and len(kept) > 10


def test_a_full_disk_leaves_whole_lines_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path)
    with no_file_beyond(1105):
        told = 0
        for n in range(10):
            try:
                lines.append({"n": n, "text": "x" * 180})
                told += 1
            except Undelivered as error:
                assert error.down and str(path) in str(error)
        assert 0 < told < 10 and 1105 - path.stat().st_size > 100, "the disk was not full"
        assert numbers(path) == list(range(told))
    lines.append({"n": told})
    assert numbers(path) == list(range(told + 1))


def test_a_file_that_others_move_away_is_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path)
    lines.append({"n": 0})
    path.rename(tmp_path / "taken")
    lines.append({"n": 1})
    assert numbers(path) == [1]


def test_all_is_synced_and_statuses_are_thinned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.fstat(file).st_size))
    path = tmp_path / "events.jsonl"
    lines = JsonLines(path)
    for value in (1.0, float("nan")):
        lines.note("A1", {"value": value})
    lines.deliver(message("alarm", transition(), id=3))
    assert len(synced) == 2 and synced[-1] == path.stat().st_size
    monkeypatch.setattr(targets, "STATUS_EVERY_S", 0.0)
    lines.note("A1", {"value": float("nan")})
    told = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
    assert [line["kind"] for line in told] == ["status", "alarm", "status"]
    assert told[1] == {"id": 3, "kind": "alarm", "data": transition()}
    assert told[2]["data"] == {"value": None}, "NaN is no JSON"
