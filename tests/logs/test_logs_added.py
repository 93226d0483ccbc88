"""Formats of packages: when they are asked, and that nothing unusable comes through."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_up_logs import refused_log

from fdd.errors import InputError
from fdd.logs import formats, read_log
from fdd.logs.formats import Format, LogFile, Signal, open_log, suffixes
from fdd.packages import LOG_FORMATS, Addition

ROWS = 4000
TIME = np.arange(ROWS) * 1e-3
SINE, COSINE = np.sin(TIME), np.cos(TIME)
COLUMNS = {"position": 0.02 * SINE, "pump_speed": 100.0 * COSINE, "pressure_difference": 1e6 + 1e5 * SINE}
TEXT = "time,position\n0,1\n1,2\n"


class Own(LogFile):
    """A package's file that gives what a test wants it to."""

    def __init__(self, path: Path, **given: Any) -> None:
        super().__init__(path, given.get("signals", {name: Signal(name) for name in COLUMNS}))
        self.given = given

    def read(self, names: Any) -> Any:
        return self.given["read"](names) if "read" in self.given else {n: COLUMNS[n] for n in names}

    def stamps(self, clock: str) -> Any:
        return self.given.get("stamps", TIME)


@pytest.fixture
def add(monkeypatch) -> Iterator[Callable[..., None]]:
    """Install a format of the files that begin with OWN."""

    def given(opener: Any, sniff: Any = lambda head: head.startswith(b"OWN"), name: str = "own") -> None:
        entry = opener if isinstance(opener, str) else Format("own", (".own", ".txt"), sniff, opener)
        point = SimpleNamespace(load=lambda: entry, group=LOG_FORMATS, value="made_up:FORMAT")
        monkeypatch.setattr(formats, "additions", lambda group: [Addition(name, "made-up 1.0", point)])
        formats._formats.cache_clear()

    yield given
    formats._formats.cache_clear()


@pytest.fixture
def path(tmp_path) -> Path:
    (tmp_path / "a.own").write_bytes(b"OWN 1\n")
    return tmp_path / "a.own"


def test_a_log_of_a_package_is_read_as_any_other_and_the_bounds_hold(add, path, monkeypatch):
    add(Own)
    found = read_log(path).samples
    np.testing.assert_array_equal(found["position"], COLUMNS["position"])
    np.testing.assert_array_equal(found.time, TIME)
    assert ".own" in suffixes()

    def refuse(path: Path) -> LogFile:
        raise InputError("the bench was off", where=path, mend="switch it on")

    add(refuse)
    assert refused_log(path) == f"{path}: the bench was off; switch it on"
    add(Own)
    monkeypatch.setenv("FDD_MAX_VALUES", str(3 * ROWS - 1))
    with pytest.raises(InputError, match=f"{ROWS} rows and 3 columns, at most"):
        read_log(path)
    monkeypatch.setenv("FDD_MAX_VALUES", str(3 * ROWS))
    assert len(read_log(path).samples) == ROWS
    add(lambda path: Own(path, signals={str(k): Signal(str(k)) for k in range(5000)}))
    with pytest.raises(InputError, match="5000 columns, at most 4096"):
        open_log(path)
    monkeypatch.setenv("FDD_MAX_LOG_BYTES", "5")
    with pytest.raises(InputError, match="6 bytes, at most 5"):
        open_log(path)


def test_ours_come_first_and_text_last_and_its_suffix_alone_makes_no_text_its_own(add, tmp_path):
    add(Own, sniff=lambda head: True)
    (tmp_path / "a.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(InputError, match="Parquet"):
        open_log(tmp_path / "a.parquet")
    (tmp_path / "a.csv").write_text(TEXT, "utf-8")
    assert isinstance(open_log(tmp_path / "a.csv"), Own)
    add(Own)
    (tmp_path / "a.txt").write_text(TEXT, "utf-8")
    assert set(open_log(tmp_path / "a.txt").signals) == {"time", "position"}
    (tmp_path / "b.own").write_text(TEXT, "utf-8")
    with pytest.raises(InputError, match="not a own file"):
        open_log(tmp_path / "b.own")


def fails(*_: object) -> Any:
    raise IndexError("list index out of range")


BAD: dict[str, Callable[[Path], Any]] = {
    "it gave a dict, not a LogFile": lambda path: {},
    "stopped (list index out of range)": fails,
    "stopped (list index": lambda path: Own(path, read=fails),
    "it gave a signal '' without a usable name": lambda path: Own(path, signals={"": Signal("")}),
    "it gave a signal 'b' without a usable name": lambda path: Own(path, signals={"b": Signal("a")}),
    "stopped ('pump_speed')": lambda path: Own(path, read=lambda names: {}),
    "could not convert string to float: 'a'": lambda path: Own(
        path, read=lambda names: {n: ["a"] * ROWS for n in names}
    ),
    "numbers of shape (9, 2) on a clock of": lambda path: Own(
        path, read=lambda names: {n: np.ones((9, 2)) for n in names}
    ),
    "numbers of shape (4,) on a clock of 4000 rows": lambda path: Own(
        path, read=lambda names: {n: np.ones(4 + (k > 0)) for k, n in enumerate(names)}
    ),
    "numbers of shape (4000,) on a clock of 7 rows": lambda path: Own(path, stamps=TIME[:7]),
}


@pytest.mark.parametrize("problem", BAD)
def test_what_nothing_can_be_made_of_is_refused_with_the_package(add, path, problem):
    add(BAD[problem])
    line = refused_log(path)
    assert line.startswith(f"{path}: package made-up 1.0, which reads it, ") and problem in line


@pytest.mark.parametrize(
    ("opener", "sniff", "problem"),
    [("no format", None, "is no Format"), (Own, fails, "cannot tell its files (IndexError")],
)
def test_one_that_cannot_be_asked_keeps_no_log_from_being_read(add, tmp_path, capsys, opener, sniff, problem):
    add(opener, sniff=sniff)
    (tmp_path / "a.csv").write_text(TEXT, "utf-8")
    assert set(open_log(tmp_path / "a.csv").signals) == {"time", "position"}
    line = capsys.readouterr().err
    assert line.startswith("fdd: warning: package made-up 1.0: fdd.log_formats 'own': ") and problem in line
    assert len(line.splitlines()) == 1
