"""Logs replayed and logs that drop into a folder: all of each, in order, once."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.errors import InputError
from fdd.logs import read_log
from fdd.samples import Samples
from fdd.service.config_sources import FolderSource, ReplaySource
from fdd.service.order import Order
from fdd.service.sources import Source, open_source
from tests.service.senders import Taker, until


@pytest.fixture(autouse=True)
def soon_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are taken for whole after half a second, not after two."""
    monkeypatch.setattr("fdd.service.sources.logs.AT_REST_S", 0.5)


def log(path: Path, seed: int = 0, seconds: float = 6.0) -> Path:
    """A log at 100 Hz; it appears whole."""
    rng, n = np.random.default_rng(seed), int(100 * seconds)
    sizes = {"position": 0.01, "pump_speed": 100.0, "pressure_difference": 1e6}
    columns = {c: size * rng.standard_normal(n) for c, size in sizes.items()}
    frame = pd.DataFrame({"time": 0.01 * np.arange(n), **columns})
    path.parent.mkdir(exist_ok=True)
    frame.to_parquet(path.with_suffix(".part"))
    path.with_suffix(".part").rename(path)
    os.utime(path, (1e9 + seed, 1e9 + seed))
    return path


def same(found: Samples, path: Path) -> None:
    wanted = read_log(path).samples
    assert np.array_equal(found.time, wanted.time)
    assert all(np.array_equal(found[n], wanted[n], equal_nan=True) for n in wanted.channels)


def folder(path: Path, **more: object) -> Source:
    return open_source(FolderSource.model_validate({"type": "folder", "folder": path, "every": 0.05, **more}))


@pytest.mark.parametrize("speed", ["max", 20.0])
def test_logs_of_several_axes_are_replayed_and_what_cannot_be_is_told(
    speed: str | float, tmp_path: Path, taker: Taker, stop: threading.Event
) -> None:
    logs = {"A1": log(tmp_path / "a.parquet"), "B2": log(tmp_path / "b.parquet", 1)}
    source = open_source(ReplaySource.model_validate({"type": "replay", "logs": logs, "speed": speed}))
    started = time.monotonic()
    source.start(taker.put, stop)
    until(lambda: not source.status()["running"])
    assert speed == "max" or time.monotonic() - started > 5.9 / 20.0
    for axis, path in logs.items():
        same(taker.joined(axis), path)
        assert taker.numbers(axis) == list(range(len(taker.numbers(axis))))
    source = open_source(ReplaySource(type="replay", logs={"A1": tmp_path / "none.csv"}))
    source.start(taker.put, stop)
    until(lambda: not source.status()["running"])
    assert "none.csv: " in source.status()["last_error"] and not source.status()["connected"]
    slow = Taker()  # of a store that takes its time
    slow.accepting = False
    open_source(ReplaySource(type="replay", logs={"A1": logs["A1"]}, speed="max")).start(slow.put, stop)
    until(lambda: len(slow.blocks) == 4)
    time.sleep(0.3)
    assert len(slow.blocks) == 4
    slow.accept()
    until(lambda: len(slow.blocks) == 6)


def test_logs_of_a_folder_are_read_once(tmp_path: Path, taker: Taker) -> None:
    first, second = log(tmp_path / "A1" / "1.parquet", 1), log(tmp_path / "A1" / "2.parquet", 2)
    (tmp_path / "A1" / "bad.csv").write_text("nothing\n")
    (tmp_path / "stray.parquet").write_bytes(first.read_bytes())
    (tmp_path / "A1" / ".hidden").write_text("x")
    before = sorted(p.name for p in tmp_path.rglob("*"))
    for _ in range(2):  # again, as after a restart
        stop = threading.Event()
        source = folder(tmp_path)
        source.start(taker.put, stop)
        until(lambda source=source: source.status()["files"] == 2 and source.status()["bad_files"] == 2)
        time.sleep(0.3)
        stop.set()
        until(lambda source=source: not source.status()["connected"])
    assert taker.numbers() == [*range(6), *range(6)]
    order = Order()
    found = Samples.concatenate([*(order.take([b]) for b in taker.blocks), order.flush()])
    assert len(found) == 1200 and order.counts["repeated"] == order.counts["late"] == 0
    wanted = np.concatenate([read_log(p).samples["position"] for p in (first, second)])
    assert np.array_equal(found["position"], wanted, equal_nan=True)
    note = json.loads((tmp_path / ".fdd-done.json").read_text())
    assert note["schema"] == "fdd.done/1"
    assert (
        "bad.csv" in note["files"]["A1/bad.csv"]["error"] and "\n" not in note["files"]["A1/bad.csv"]["error"]
    )
    assert "no name of an axis" in note["files"]["stray.parquet"]["error"]
    assert sorted(p.name for p in tmp_path.rglob("*")) == sorted([*before, ".fdd-done.json"])


def test_a_file_is_read_when_it_is_whole(tmp_path: Path, taker: Taker, stop: threading.Event) -> None:
    whole = log(tmp_path / "elsewhere" / "a.parquet")
    content, target = whole.read_bytes(), tmp_path / "drop" / "a.parquet"
    target.parent.mkdir()
    source = folder(target.parent, axis="A1")
    source.start(taker.put, stop)
    with target.open("wb") as out:
        for k in range(6):
            out.write(content[k * len(content) // 6 : (k + 1) * len(content) // 6])
            out.flush()
            time.sleep(0.15)
            assert not taker.blocks
    until(lambda: source.status()["files"] == 1)
    same(taker.joined(), whole)
    assert source.status()["bad_files"] == 0


def test_a_restart_in_the_middle_of_a_file_goes_on_there(tmp_path: Path, taker: Taker) -> None:
    path, stop, source = log(tmp_path / "a.parquet"), threading.Event(), folder(tmp_path, axis="A1")
    taker.accepting = False
    source.start(taker.put, stop)
    until(lambda: len(taker.blocks) == 4)
    for block in taker.blocks[:2]:
        block.accepted()
    until(lambda: len(taker.blocks) == 6)
    stop.set()
    until(lambda: not source.status()["connected"])
    stored = taker.blocks[:2]
    again, stop = Taker(), threading.Event()
    source = folder(tmp_path, axis="A1")
    source.start(again.put, stop)
    until(lambda: source.status()["files"] == 1)
    stop.set()
    assert again.numbers() == [2, 3, 4, 5]
    same(Samples.concatenate([b.samples for b in [*stored, *again.blocks]]), path)


def test_a_file_that_is_replaced_is_read_again(tmp_path: Path, taker: Taker, stop: threading.Event) -> None:
    (tmp_path / "a.parquet").write_text("nothing")
    os.utime(tmp_path / "a.parquet", (1e9, 1e9))
    source = folder(tmp_path, axis="A1")
    source.start(taker.put, stop)
    until(lambda: source.status()["bad_files"] == 1)
    path = log(tmp_path / "a.parquet", 5)
    until(lambda: source.status()["files"] == 1)
    same(taker.joined(), path)
    assert source.status()["bad_files"] == 0


def test_a_damaged_note_is_not_overwritten(tmp_path: Path, taker: Taker, stop: threading.Event) -> None:
    (tmp_path / ".fdd-done.json").write_text('{"schema": "fdd.done/1", "files": 3}')
    with pytest.raises(InputError, match="not a note of what is done; remove it"):
        folder(tmp_path).start(taker.put, stop)
    assert "3}" in (tmp_path / ".fdd-done.json").read_text()
    with pytest.raises(InputError, match="no such folder"):
        folder(tmp_path / "none").start(taker.put, stop)
