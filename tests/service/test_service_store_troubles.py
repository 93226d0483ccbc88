"""A store that is damaged, locked, full, read-only, foreign, of another version; and killed writers."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from stores import LEAK, WALL, blocks_of

from fdd.diagnosis.findings import FaultFinding
from fdd.errors import InputError
from fdd.service.alarms import AlarmBook
from fdd.service.store import Checkpoint, Rollup, Store, StoreTrouble

KILLS = 50


def url_of(path: Path) -> str:
    return f"sqlite:///{path}"


def filled(path: Path) -> Path:
    """A closed store with some hundred pages."""
    store = Store(url_of(path))
    with store.transaction() as t:
        t.accept_all(blocks_of("A1", [os.urandom(8000) for _ in range(50)]))
        for _ in range(200):
            t.found("A1", 1.0, WALL, LEAK)
        t.audit(WALL, "ann", "LOGIN")
    store.compact(WALL)
    store.close()
    return path


def one_line(error: BaseException, path: Path) -> None:
    assert str(error).startswith(str(path)) and len(str(error).splitlines()) == 1


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"time,position\n0,1\n" * 100,
        lambda data: b"X" + data[1:],
        lambda data: data[:4096] + b"\xff" * 4096 + data[8192:],
        lambda data: data[: len(data) // 2],
        lambda data: data[:100] + bytes(4096 - 100) + data[4096:],
    ],
    ids=["csv", "header", "page", "half", "schema"],
)
def test_a_damaged_file_is_named_and_left_as_it_is(damage: Callable[[bytes], bytes], tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    data = damage(path.read_bytes())
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged|malformed|not a database") as caught:
        Store(url_of(path))
    one_line(caught.value, path)
    assert not isinstance(caught.value, StoreTrouble), "waiting mends nothing"
    assert path.read_bytes() == data


def test_an_empty_file_becomes_a_store(tmp_path: Path) -> None:
    (tmp_path / "fdd.db").touch()
    store = Store(url_of(tmp_path / "fdd.db"))
    assert store.axes() == []
    store.close()


def test_a_locked_store_is_a_trouble_that_passes(tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    store = Store(url_of(path), busy_timeout=0.1)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreTrouble, match="is locked") as caught, store.transaction() as t:
        t.audit(WALL, "ann", "LOGOUT")
    one_line(caught.value, path)
    assert len(store.audit()) == 1, "readers go on"
    other.execute("ROLLBACK")
    with store.transaction() as t:
        t.audit(WALL, "ann", "LOGOUT")
    assert len(store.audit()) == 2
    store.close()
    other.execute("PRAGMA locking_mode=EXCLUSIVE")
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(StoreTrouble, match="is locked"):
        Store(url_of(path), busy_timeout=0.1)
    other.close()


def test_a_writer_waits_for_another_one(tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    store = Store(url_of(path))
    other = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    other.execute("BEGIN IMMEDIATE")
    threading.Timer(0.3, other.execute, ["COMMIT"]).start()
    with store.transaction() as t:
        t.audit(WALL, "ann", "LOGOUT")
    assert len(store.audit()) == 2
    store.close()


def test_a_transaction_that_only_read_so_far_keeps_other_writers_out(tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    store, other = Store(url_of(path)), Store(url_of(path), busy_timeout=0.1)
    with store.transaction() as t:
        with pytest.raises(StoreTrouble, match="is locked"), other.transaction():
            raise AssertionError("what the first one reads would be old when it writes")
        t.audit(WALL, "ann", "LOGOUT")
    assert len(other.audit()) == 2
    store.close()
    other.close()


def test_a_full_disk_is_a_trouble_that_passes(tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    store = Store(url_of(path))
    before = store.journal("A1")
    with pytest.raises(StoreTrouble, match="disk is full") as caught, store.transaction() as t:
        t.accept_all(blocks_of("A1", [b"first"]))
        t._connection.exec_driver_sql("PRAGMA max_page_count=1")
        t.accept_all(blocks_of("A1", [bytes(8000)] * 100))
    one_line(caught.value, path)
    assert store.journal("A1") == before, "nothing of it may be there"
    store.close()
    store = Store(url_of(path))
    with store.transaction() as t:
        t.accept_all(blocks_of("A1", [bytes(8000)] * 100))
    assert len(store.journal("A1")) == len(before) + 100
    store.close()


def test_a_file_that_may_not_grow_is_a_trouble_and_nothing_is_half_there(tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    program = (
        "import resource, sys\n"
        "from fdd.service.store import Store, StoreTrouble\n"
        "store = Store(sys.argv[1])\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (800_000, 800_000))\n"
        "try:\n"
        "    for k in range(50):\n"
        "        with store.transaction() as t:\n"
        "            t.accept_all([('A2', bytes(8000))] * 10)\n"
        "except StoreTrouble as trouble:\n"
        "    print(k, trouble)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, url_of(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    written, line = done.stdout.strip().split(" ", 1)
    assert "disk I/O error" in line and int(written) > 0
    store = Store(url_of(path))
    assert len(store.journal("A2")) == 10 * int(written)
    assert len(store.journal("A1")) == 50
    store.close()


@pytest.mark.parametrize("gone", ["fdd.db", ""])
def test_a_store_whose_files_are_moved_away_takes_nothing_until_they_are_back(
    gone: str, tmp_path: Path
) -> None:
    path = tmp_path / "state" / "fdd.db"
    path.parent.mkdir()
    store = Store(url_of(filled(path)))
    with store.transaction() as t:
        t.accept_all(blocks_of("A2", [b"before"]))
    (path.parent / gone).rename(tmp_path / "away")
    for _ in range(2):
        with (
            pytest.raises(StoreTrouble, match="file is gone; put it back") as caught,
            store.transaction() as t,
        ):
            t.accept_all(blocks_of("A2", [b"meanwhile"]))
        one_line(caught.value, path)
    assert not path.exists(), "no empty one in its place"
    (tmp_path / "away").rename(path.parent / gone)
    with store.transaction() as t:
        t.accept_all(blocks_of("A2", [b"after"]))
    copy = tmp_path / "as-after-a-kill"
    shutil.copytree(path.parent, copy)
    store.close()
    killed = Store(url_of(copy / "fdd.db"))
    assert [payload for _, payload in killed.journal("A2")] == [b"before", b"after"]
    killed.close()


def test_a_read_only_store_is_told(tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    store = Store(url_of(path))
    with pytest.raises(InputError, match="readonly database") as caught, store.transaction() as t:
        t._connection.exec_driver_sql("PRAGMA query_only=ON")
        t.audit(WALL, "ann", "LOGOUT")
    one_line(caught.value, path)
    store.close()


@pytest.mark.parametrize(
    ("url", "line"),
    [
        ("fdd.db", "URL cannot be read; e.g. sqlite:///"),
        ("mysql://host/x", "no store of the kind mysql"),
        ("sqlite://", "a store in memory keeps nothing"),
        ("sqlite:///{tmp}/none/fdd.db", "unable to open"),
        ("sqlite:///{tmp}", "unable to open"),
    ],
)
def test_urls_that_are_no_store(url: str, line: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=line) as caught:
        Store(url.format(tmp=tmp_path))
    assert len(str(caught.value).splitlines()) == 1


def test_a_server_that_cannot_be_reached_is_told_without_its_password() -> None:
    with pytest.raises(InputError) as caught:
        Store("postgresql://fdd:secret@127.0.0.1:9/fdd")
    assert "127.0.0.1" in str(caught.value) and "secret" not in str(caught.value)
    try:
        import psycopg  # noqa: F401
    except ImportError:
        assert "install fdd[postgres]" in str(caught.value)
    else:
        assert isinstance(caught.value, StoreTrouble)


def test_the_driver_of_a_server_is_not_loaded_for_a_file(tmp_path: Path) -> None:
    program = (
        "import sys; from fdd.service.store import Store; Store(sys.argv[1])\n"
        "assert 'psycopg' not in sys.modules and 'sqlalchemy' in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", program, url_of(tmp_path / "a.db")]).returncode == 0


def test_another_programs_database_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "bookmarks.db"
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE bookmark (url TEXT)")
    with pytest.raises(InputError, match="of another program") as caught:
        Store(url_of(path))
    one_line(caught.value, path)
    with sqlite3.connect(path) as other:
        assert other.execute("SELECT name FROM sqlite_master").fetchall() == [("bookmark",)]


@pytest.mark.parametrize("version", ["0001", "9999"])
def test_a_store_of_another_version_is_refused_in_one_line(version: str, tmp_path: Path) -> None:
    path = filled(tmp_path / "fdd.db")
    with sqlite3.connect(path) as other:
        other.execute(f"UPDATE fdd_revision SET version_num = '{version}'")
    wanted = rf"of another version of fdd \(its tables are {version}, here 0002\); use that fdd"
    with pytest.raises(InputError, match=wanted) as caught:
        Store(url_of(path))
    one_line(caught.value, path)


def write_for_ever(url: str, told: int) -> None:
    """Transactions that touch every table and count; each tells its number once it is committed."""
    store, book = Store(url), AlarmBook()
    book.restore(store.book())
    n = len(store.audit(limit=1_000_000))
    while True:
        n += 1
        fault = FaultFinding(**{**LEAK.model_dump(), "fault": f"fault_{n}", "ambiguity": [f"fault_{n}"]})
        with store.transaction() as t:
            t.accept_all(blocks_of("A1", [b"%d" % n] * 3))
            t.axis("A1", wall=WALL + n, last_time=float(n))
            t.found("A1", float(n), WALL, fault)
            for transition in book.update("A1", 1.0, WALL, [fault]):
                t.transition(transition)
            t.rollup(Rollup("A1", "n", WALL, 1, float(n), 0.0, float(n), float(n)))
            t.send("alarm", {"n": n}, "webhook", WALL)
            if n % 5 == 0:
                t.checkpoint(Checkpoint("A1", float(n), WALL, 3 * n, "", "", "", b"%d" % n * 5000))
        os.write(told, b"%d\n" % n)


def check_whole(store: Store, committed: int) -> int:
    """How many transactions are there: `committed` or one more, and the same in every table."""
    n = len(store.audit(limit=1_000_000))
    assert committed <= n <= committed + 1
    assert len(store.alarms(limit=1_000_000)) == len(store.findings(limit=1_000_000)) == n
    assert [p.body["n"] for p in store.outbox(1_000_000, "webhook")] == list(range(1, n + 1))
    for level in ("minute", "hour", "day"):
        (row,) = store.rollups("A1", "n", level)
        assert (row["n"], row["max"]) == (n, float(n))
        assert row["mean"] == pytest.approx((n + 1) / 2.0)
    assert store.axes()[0]["last_time"] == float(n)
    checkpoint = store.checkpoint("A1")
    held = n // 5 * 5
    assert (checkpoint.body if checkpoint else b"") == b"%d" % held * 5000 * (held > 0)
    assert [payload for _, payload in store.journal("A1")] == [
        b"%d" % k for k in range(held + 1, n + 1) for _ in range(3)
    ]
    assert store.book()["next_id"] == n + 1
    return n


@pytest.mark.slow
def test_a_writer_that_is_killed_at_any_instant_leaves_whole_transactions(tmp_path: Path) -> None:
    draw = random.Random(7)
    url, committed = url_of(tmp_path / "fdd.db"), 0
    Store(url).close()
    in_the_middle = 0
    for _ in range(KILLS):
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                write_for_ever(url, write)
            finally:
                os._exit(1)
        os.close(write)
        with os.fdopen(read, "rb") as numbers:
            first = numbers.readline()
            assert first, "the writer could not begin"
            time.sleep(draw.uniform(0.0, 0.06))
            os.kill(child, signal.SIGKILL)
            assert os.waitpid(child, 0)[1] == signal.SIGKILL
            last = [first, *numbers.read().splitlines()][-1]
        store = Store(url)
        there = check_whole(store, int(last))
        store.close()
        in_the_middle += there > int(last)
        assert there > committed
        committed = there
    assert committed > KILLS
    # Told after it was committed: now and then the kill falls between the two.
    assert in_the_middle < KILLS
