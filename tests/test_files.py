"""Files written whole or not at all."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from fdd.errors import InputError
from fdd.files import require_writable, whole_file, write_text


@pytest.fixture(params=[0o022, 0o077, 0o002])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_the_file_is_as_readable_as_any_other(umask: int, tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.touch()
    write_text(tmp_path / "text", "x")
    assert mode(tmp_path / "text") == mode(plain) == 0o666 & ~umask


def test_nothing_has_the_name_until_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "run.csv"
    with whole_file(target) as temporary:
        assert temporary.parent == tmp_path
        temporary.write_text("half")
        assert not target.exists()
        with temporary.open("a") as more:
            more.write(" and half")
    assert target.read_text() == "half and half"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, InputError])
def test_a_failure_leaves_what_was_there(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "run.csv"
    target.write_text("the old one")
    with pytest.raises(error, match="told"), whole_file(target) as temporary:
        temporary.write_text("half")
        raise error("told")
    assert target.read_text() == "the old one"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("call", ["replace", "open"])
def test_a_full_disk_is_one_line_that_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    target = tmp_path / "run.csv"

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, call, full)
        with pytest.raises(InputError) as caught:
            write_text(target, "x")
    assert str(caught.value).startswith(f"{target}: cannot be written (No space left on device)")
    assert "\n" not in str(caught.value) and ".part" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    target = tmp_path / "no" / "run.csv"
    with pytest.raises(InputError, match="no such folder") as caught, whole_file(target):
        pass
    assert str(target) in str(caught.value)
    assert not target.parent.exists()


def test_a_folder_that_may_not_be_written_to_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Patched rather than with chmod, which does not hold back a superuser.
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InputError, match="permission denied") as caught, whole_file(tmp_path / "run.csv"):
        pass
    assert str(tmp_path / "run.csv") in str(caught.value)


def test_a_folder_is_not_written_over(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        write_text(tmp_path, "x")
    assert tmp_path.is_dir()


def test_a_pipe_is_not_written_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="device or pipe"):
        write_text(tmp_path / "pipe", "x")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


@pytest.mark.parametrize("name", ["n" * 255, "ü" * 127])
def test_the_longest_names_are_written(tmp_path: Path, name: str) -> None:
    write_text(tmp_path / name, "x")
    assert [f.name for f in tmp_path.iterdir()] == [name]


def test_a_name_too_long_for_the_disk_is_one_line(tmp_path: Path) -> None:
    for attempt in (lambda p: write_text(p, "x"), require_writable):
        with pytest.raises(InputError, match="name too long"):
            attempt(tmp_path / ("n" * 300))
    assert list(tmp_path.iterdir()) == []


def test_writers_at_the_same_time_do_not_clash(tmp_path: Path) -> None:
    target, writers = tmp_path / "run.csv", 8
    together = Barrier(writers, timeout=20)

    def one(k: int) -> Path:
        with whole_file(target) as temporary:
            together.wait()
            temporary.write_text(str(k) * 100_000)
            together.wait()
        return temporary

    with ThreadPoolExecutor(writers) as pool:
        names = set(pool.map(one, range(writers)))
    assert len(names) == writers
    text = target.read_text()
    assert text in {str(k) * 100_000 for k in range(writers)}
    assert list(tmp_path.iterdir()) == [target]
