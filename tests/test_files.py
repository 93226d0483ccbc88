"""Files written whole or not at all; and the one line that a user reads when something is unusable."""

import os
import stat
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd import InputError, Samples, Unit
from fdd.files import require_writable, whole_file, write_text
from fdd.logs.mcap_writing import write_run
from fdd.logs.tabular_writing import write_table
from tests.refusal import refused


@pytest.fixture(params=[0o022, 0o077, 0o002])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def test_logs_and_profiles_are_as_readable_as_any_other(umask: int, tmp_path: Path) -> None:
    samples = Samples(np.arange(3) * 1e-3, {"position": np.zeros(3)})
    write_table(tmp_path / "a.csv", samples)
    write_table(tmp_path / "a.parquet", samples)
    write_run(tmp_path / "a.mcap", samples, axis="a")
    Unit.load("axis_a").save(tmp_path / "a.yaml")
    (tmp_path / "plain").touch()
    found = {f.name: stat.S_IMODE(f.stat().st_mode) for f in tmp_path.iterdir()}
    assert found == dict.fromkeys(("a.csv", "a.parquet", "a.mcap", "a.yaml", "plain"), 0o666 & ~umask)


def test_nothing_has_the_name_until_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "run.csv"
    with whole_file(target) as temporary:
        assert temporary.parent == tmp_path
        temporary.write_text("half")
        assert not target.exists()
        with temporary.open("a") as more:
            more.write(" and half")
    assert target.read_text() == "half and half" and list(tmp_path.iterdir()) == [target]
    with pytest.raises(ZeroDivisionError), whole_file(target) as temporary:
        temporary.unlink()  # hides no error
        raise ZeroDivisionError


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
def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    target = tmp_path / "run.csv"

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, call, full)
        line = refused(lambda: write_text(target, "x"))
    assert line.startswith(f"{target}: cannot be written (No space left on device)") and ".part" not in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("no/run.csv", "no such folder"), ("", "is a folder"), ("pipe", "device or pipe"),
        ("n" * 300, "name too long"),
    ],
)  # fmt: skip
def test_what_cannot_be_written_is_one_line(tmp_path: Path, name: str, problem: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    target = tmp_path / name
    for attempt in (lambda: write_text(target, "x"), lambda: require_writable(target)):
        line = refused(attempt)
        assert problem in line and str(target) in line
    assert [p.name for p in tmp_path.iterdir()] == ["pipe"] and (tmp_path / "pipe").is_fifo()


def test_a_folder_without_permission_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Patched rather than with chmod, which does not hold back a superuser.
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(InputError, match=r"run\.csv: .*permission denied"), whole_file(tmp_path / "run.csv"):
        pass


@pytest.mark.parametrize("name", ["n" * 255, "ü" * 127])
def test_the_longest_names_are_written(tmp_path: Path, name: str) -> None:
    write_text(tmp_path / name, "x")
    assert [f.name for f in tmp_path.iterdir()] == [name]


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


text = st.text(alphabet=st.characters(codec="utf-8"), max_size=60)


def test_the_line_names_place_problem_and_mend_in_that_order() -> None:
    error = InputError("row 7 is not a number", where=Path("logs/a.csv"), mend="correct that row")
    assert str(error) == "logs/a.csv: row 7 is not a number; correct that row"
    parts = ("logs/a.csv", "row 7 is not a number", "correct that row")
    assert (error.where, error.problem, error.mend) == parts
    inner = InputError("not a number", where="pump.displacement", mend="correct that field")
    assert str(inner.at("unit.yaml")) == "unit.yaml: pump.displacement: not a number; correct that field"
    assert str(InputError("empty").at("unit.yaml")) == "unit.yaml: empty"


@given(text, st.none() | text, st.none() | text)
def test_always_one_line_whatever_it_quotes(problem: str, where: str | None, mend: str | None) -> None:
    assert len(str(InputError(problem, where=where, mend=mend)).splitlines()) <= 1
