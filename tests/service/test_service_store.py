"""What the store keeps, on SQLite and, where there is one, on a PostgreSQL server; and its troubles."""

import hashlib
import json
import os
import shutil
import sqlite3
import threading
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import create_engine, text
from sqlalchemy.exc import DBAPIError

from fdd.diagnosis.findings import FaultFinding
from fdd.errors import InputError
from fdd.service.alarms import Action, AlarmBook, Transition
from fdd.service.store import Checkpoint, LeaseLost, Rollup, Store, StoreTrouble
from fdd.service.store.schema import unpacked
from tests.service.senders import LEAK
from tests.service.servers import postgres_url

DAY, WALL = 86400.0, 1_700_000_000.0


def sqlite(path: Path) -> str:
    return f"sqlite:///{path}"


def url_of(kind: str, folder: Path) -> str:
    return sqlite(folder / "fdd.db") if kind == "sqlite" else postgres_url()


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request, tmp_path) -> str:
    return url_of(request.param, tmp_path)


@pytest.fixture
def store(url) -> Iterator[Store]:
    with closing(Store(url)) as store:
        yield store


def values_of(name: str, values: np.ndarray, start: float = WALL) -> Rollup:
    few = float(values.min()), float(values.max())
    return Rollup("A1", name, start, values.size, float(values.mean()), float(values.std()), *few)


def test_everything_comes_back_as_it_was_written(store, url):
    book = AlarmBook()
    (raised,) = book.update("A1", 15.0, WALL, [LEAK])
    with store.transaction() as t:
        t.axis("A1", wall=WALL, unit="axis_a", profile_sha256="p", model_sha256="m")
        t.axis("A1", wall=WALL + 5.0, last_time=20.0, state="in alarm")
        t.found("A1", 15.0, WALL, LEAK)
        t.transition(raised)
        t.audit(WALL + 1.0, "ann", "LOGIN", note='naïve "油"\x00\udcff', body={"value": float("nan")})
        t.meta("name", "rig")
        t.meta("name", "rig 7")
    store.close()
    again = Store(url)
    assert again.axes() == [
        {"name": "A1", "unit": "axis_a", "profile_sha256": "p", "model_sha256": "m", "first_wall": WALL,
         "last_wall": WALL + 5.0, "last_time": 20.0, "state": "in alarm"}
    ]  # fmt: skip
    (found,) = again.findings()
    assert FaultFinding.model_validate(found["body"]) == LEAK
    assert (found["low"], found["high"], found["onset"]) == (0.5, 0.7, 3.0)
    login, audited = again.audit()
    assert (login["note"], login["body"]) == ('naïve "油"', {"value": None})
    assert (audited["action"], audited["body"]["before"], audited["time"]) == ("RAISED", "NORMAL", 15.0)
    assert [r["id"] for r in again.audit(alarm_id=1)] == [audited["id"]]
    assert json.loads(json.dumps(again.alarm(1))) == json.loads(json.dumps(asdict(raised.alarm)))
    assert [a["id"] for a in again.alarms(["UNACK"])] == [1]
    assert again.alarms(["ACKED"]) == [] and again.alarm(2) is None
    assert again.meta("name") == "rig 7" and again.meta("none") is None
    again.close()


def test_a_book_goes_on_from_the_store_as_if_it_had_never_stopped(store):
    """Raised for 50 s each 200 s, never acknowledged: one alarm that chatters, whoever restarts."""
    book, whole, time = AlarmBook(), AlarmBook(), 0.0

    def look(*stands: FaultFinding, seconds: float = 5.0) -> list[Transition]:
        nonlocal time
        time += seconds
        moved = book.update("A1", time, WALL + time, stands)
        assert moved == whole.update("A1", time, WALL + time, stands)
        with store.transaction() as t:
            t.alarm(*book.alarms("A1"))
            for transition in moved:
                t.transition(transition)
        return moved

    for number in range(400):
        if number % 7 == 0:
            book = AlarmBook()
            book.restore(store.book())
        look(*[LEAK] * (number % 40 < 10))
    (row,) = store.alarms()
    assert (row["count"], row["chattering"]) == (10, True)
    with store.transaction() as t:
        t.transition(book.act(Action("acknowledge", 1, "ann"), WALL))
    whole.act(Action("acknowledge", 1, "ann"), WALL)
    for seconds in (4000.0, 4000.0):
        look(seconds=seconds)
    assert [a["state"] for a in store.alarms()] == ["NORMAL"]
    book.restore(store.book())
    assert [t.alarm.id for t in look(LEAK, seconds=500.0)] == [2], "no id is given twice"


def test_a_checkpoint_takes_the_blocks_that_it_holds_out_of_the_journal(store):
    def at(sequence: int, *values: float) -> Checkpoint:
        return Checkpoint("A1", 3.0, WALL, sequence, "profile", "model", "5", {"a": np.array(values)})

    with store.transaction() as t:
        t.accept_all([("A2", b"4")])
        second = t.accept_all([("A1", b"1"), ("A1", b"2")])
        third = t.accept_all([("A1", b"3")])
        t.checkpoint(at(second, 1.0))
    assert store.journal("A1") == [(third, b"3")]
    assert [payload for _, payload in store.journal("A2")] == [b"4"]
    state = at(third, *np.random.default_rng(1).random(20_000), *np.zeros(20_000))
    with store.transaction() as t:
        t.checkpoint(state)
    found = store.checkpoint("A1")
    assert found is not None and np.array_equal(found.arrays["a"], state.arrays["a"])
    assert replace(found, arrays={}) == replace(state, arrays={})
    assert store.journal("A1") == [] and store.checkpoint("A2") is None
    with store.transaction() as t:
        assert t.accept_all([("A1", b"5")]) > third, "ids of rows that are gone must not come again"


def merged(parts: list[list[float]]) -> Rollup:
    return reduce(Rollup.merged, (values_of("q", np.array(part)) for part in parts))


@given(st.lists(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20), min_size=1, max_size=8))
def test_merged_parts_are_what_numpy_says_of_the_whole(parts):
    whole, total = np.concatenate(parts), merged(parts)
    size = np.abs(whole).max()
    assert (total.n, total.min, total.max) == (whole.size, whole.min(), whole.max())
    assert total.mean == pytest.approx(whole.mean(), rel=1e-12, abs=1e-12 * size)
    assert total.std == pytest.approx(whole.std(), rel=1e-9, abs=1e-12 * size)


def test_std_of_small_changes_on_a_large_mean_keeps_its_digits():
    values = 1e9 + np.random.default_rng(2).normal(size=1000)
    total = merged([[value] for value in values])
    assert total.std == pytest.approx(values.std(), rel=1e-6)


def test_minutes_hours_and_days_are_each_the_whole(store):
    random, start = np.random.default_rng(3), WALL // DAY * DAY
    stamps = start + np.sort(random.uniform(0.0, 2 * DAY, 3000))
    values = random.normal(6e-12, 1e-13, 3000)
    for some in np.array_split(random.permutation(3000), 20):
        with store.transaction() as t:
            t.rollup(*(values_of("leakage", values[[k]], float(stamps[k])) for k in some))
            t.rollup(*(values_of("friction", values[[k]] * 2.0, float(stamps[k])) for k in some[:3]))
    for level, span in (("minute", 60.0), ("hour", 3600.0), ("day", DAY)):
        rows = store.rollups("A1", "leakage", level)
        starts = stamps // span * span
        assert [r["start_wall"] for r in rows] == sorted(set(starts))
        for row in rows:
            mine = values[starts == row["start_wall"]]
            assert (row["n"], row["min"], row["max"]) == (mine.size, mine.min(), mine.max())
            assert row["mean"] == pytest.approx(mine.mean(), rel=1e-12)
            assert row["std"] == pytest.approx(mine.std(), rel=1e-9, abs=1e-26)
    hours = {s for s in stamps // 3600 if s * 3600 >= start + DAY}
    assert len(store.rollups("A1", "leakage", "hour", since=start + DAY)) == len(hours)
    assert sum(r["n"] for r in store.rollups("A1", "friction", "day")) == 60


def test_what_is_old_goes_and_the_rest_stays(store):
    ages = np.array([1.0, 29.0, 31.0, 729.0, 731.0, 4000.0])
    with store.transaction() as t:
        for age in ages:
            wall = WALL - age * DAY
            t.rollup(values_of("leakage", np.array([age]), wall))
            t.found("A1", 1.0, wall, LEAK)
            t.audit(wall, "ann", "LOGIN")
        sent = [t.send("alarm", {"n": n}, "webhook", WALL) for n in range(3)]
    store.settle(sent[0], done=True)
    store.settle(sent[1], done=False)
    assert store.compact(WALL) == {"minutes": 4, "hours": 2, "outbox": 1}
    left = [(p.id, p.body, p.attempts) for p in store.outbox(9, "webhook")]
    assert left == [(sent[1], {"n": 1}, 1), (sent[2], {"n": 2}, 0)]
    assert [len(store.rollups("A1", "leakage", level)) for level in ("minute", "hour", "day")] == [2, 4, 6]
    assert len(store.findings()) == len(store.audit()) == 6
    assert store.compact(WALL, findings=30)["findings"] == 4 and len(store.audit()) == 6
    assert store.compact(WALL)["minutes"] == 0


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        *(("sqlite", f"UPDATE audit SET {column}") for column in ("who = 'eve'", "note = note")),
        *(("sqlite", f"DELETE FROM audit{rows}") for rows in ("", " WHERE id = 1")),
        ("sqlite", "INSERT OR REPLACE INTO audit (id, wall, who, action, note, body) "
                   "VALUES (1, 0, 'eve', '', '', '')"),
        ("sqlite", "REPLACE INTO audit SELECT * FROM audit"),
        ("postgresql", "UPDATE audit SET who = 'eve'"),
        ("postgresql", "DELETE FROM audit"),
        ("postgresql", "TRUNCATE audit"),
    ],
)  # fmt: skip
def test_the_audit_only_grows_whoever_opens_it(kind, change, tmp_path):
    url = url_of(kind, tmp_path)
    store = Store(url)
    with store.transaction() as t:
        t.audit(WALL, "ann", "LOGIN")
    before = store.audit()
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with pytest.raises(DBAPIError, match="only grows"), engine.begin() as connection:
        connection.execute(text(change))
    assert store.audit() == before and len(before) == 1
    store.close()


def test_readers_and_writers_of_many_threads_do_not_disturb_each_other(store):
    def write(axis: str) -> None:
        for n in range(25):
            with store.transaction() as t:
                t.accept_all([(axis, b"%d" % n)])
                t.rollup(Rollup("all", "n", WALL, 1, float(n), 0.0, float(n), float(n)))
            assert len(store.journal(axis)) == n + 1

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, ("A0", "A1", "A2", "A3")))
    (minute,) = store.rollups("all", "n", "minute")
    assert minute["n"] == 100 and minute["mean"] == pytest.approx(12.0)


def test_room_on_the_disk_is_given_back_and_a_damaged_checkpoint_refused(tmp_path):
    path = tmp_path / "fdd.db"
    store = Store(sqlite(path))
    with store.transaction() as t:
        last = t.accept_all([("A1", bytes(8000))] * 500)
    with store.transaction() as t:
        t.checkpoint(Checkpoint("A1", 1.0, WALL, last, "", "", "", {"a": np.zeros(100)}))
    store.compact(WALL)
    assert path.stat().st_size < 500_000
    with sqlite3.connect(path) as other:
        body = bytearray(other.execute("SELECT body FROM checkpoint").fetchone()[0])
        body[5] ^= 1
        other.execute("UPDATE checkpoint SET body = ?", (bytes(body),))
    with pytest.raises(InputError, match="a checkpoint is damaged; the axis must start anew"):
        store.checkpoint("A1")
    store.close()
    old = zlib.compress(b"state" * 1000, 1)
    with pytest.raises(InputError, match="of another version of fdd; the axis must start anew"):
        unpacked(old, hashlib.sha256(old).hexdigest(), where="fdd.db")


def test_who_was_taken_over_writes_nothing_and_who_takes_over_waits_for_what_is_written(url):
    old, new = Store(url), Store(url)
    old.claim()
    claiming = threading.Thread(target=new.claim)
    with old.transaction() as t:
        claiming.start()
        claiming.join(0.5)
        assert claiming.is_alive()
        t.axis("A1", wall=WALL)
    claiming.join(20.0)
    with pytest.raises(LeaseLost, match="taken over"), old.transaction() as t:
        t.axis("A2", wall=WALL)
    with pytest.raises(LeaseLost):
        old.claim()
    with new.transaction() as t:
        t.axis("A3", wall=WALL)
    assert [a["name"] for a in new.axes()] == ["A1", "A3"]


@pytest.fixture
def path(tmp_path) -> Path:
    """Of a closed store with some hundred pages."""
    path = tmp_path / "state" / "fdd.db"
    path.parent.mkdir()
    with closing(Store(sqlite(path))) as store:
        with store.transaction() as t:
            t.accept_all([("A1", os.urandom(8000)) for _ in range(50)])
            for _ in range(200):
                t.found("A1", 1.0, WALL, LEAK)
            t.audit(WALL, "ann", "LOGIN")
        store.compact(WALL)
    return path


@contextmanager
def told(kind: type[InputError], words: str, path: Path) -> Iterator[pytest.ExceptionInfo]:
    """In one line that begins with the file."""
    with pytest.raises(kind, match=words) as caught:
        yield caught
    assert str(caught.value).startswith(str(path)) and len(str(caught.value).splitlines()) == 1


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
def test_a_damaged_file_is_named_and_left_as_it_is(damage, path):
    data = damage(path.read_bytes())
    path.write_bytes(data)
    with told(InputError, r"damaged|malformed|not a database", path) as caught:
        Store(sqlite(path))
    assert not isinstance(caught.value, StoreTrouble), "waiting mends nothing"
    assert path.read_bytes() == data


def test_a_locked_store_is_a_trouble_that_passes(path):
    store = Store(f"{sqlite(path)}?timeout=0.1")
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with told(StoreTrouble, "is locked", path), store.transaction() as t:
        t.audit(WALL, "ann", "LOGOUT")
    assert len(store.audit()) == 1, "readers go on"
    other.execute("ROLLBACK")
    with closing(Store(sqlite(path))) as first, first.transaction() as t:
        with pytest.raises(StoreTrouble, match="is locked"), store.transaction():
            raise AssertionError("what the first one, which only read so far, has read would be old")
        t.audit(WALL, "ann", "LOGOUT")
    assert len(store.audit()) == 2
    store.close()
    other.execute("PRAGMA locking_mode=EXCLUSIVE")
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(StoreTrouble, match="is locked"):
        Store(f"{sqlite(path)}?timeout=0.1")
    other.close()


def test_a_full_disk_is_a_trouble_that_passes_and_a_read_only_store_is_told(path):
    store = Store(sqlite(path))
    before = store.journal("A1")
    with told(StoreTrouble, "disk is full", path), store.transaction() as t:
        t.accept_all([("A1", b"first")])
        t._connection.exec_driver_sql("PRAGMA max_page_count=1")
        t.accept_all([("A1", bytes(8000))] * 100)
    assert store.journal("A1") == before, "nothing of it may be there"
    store.close()
    store = Store(sqlite(path))
    with store.transaction() as t:
        t.accept_all([("A1", bytes(8000))] * 100)
    assert len(store.journal("A1")) == len(before) + 100
    with told(InputError, "readonly database", path), store.transaction() as t:
        t._connection.exec_driver_sql("PRAGMA query_only=ON")
        t.audit(WALL, "ann", "LOGOUT")
    store.close()


@pytest.mark.parametrize("gone", ["fdd.db", ""])
def test_a_store_that_is_moved_takes_nothing_until_it_is_back(gone, path, tmp_path):
    def accept(payload: bytes) -> None:
        with store.transaction() as t:
            t.accept_all([("A2", payload)])

    with closing(Store(sqlite(path))) as store:
        accept(b"before")
        (path.parent / gone).rename(tmp_path / "away")
        for _ in range(2):
            with told(StoreTrouble, "file is gone; put it back", path):
                accept(b"meanwhile")
        assert not path.exists(), "no empty one in its place"
        (tmp_path / "away").rename(path.parent / gone)
        accept(b"after")
        copy = tmp_path / "as-after-a-kill"
        shutil.copytree(path.parent, copy)
    with closing(Store(sqlite(copy / "fdd.db"))) as killed:
        assert [payload for _, payload in killed.journal("A2")] == [b"before", b"after"]


def test_urls_that_are_no_store_or_lead_to_none_are_told_without_the_password(tmp_path):
    for url, line in {
        "fdd.db": "URL cannot be read; e.g. sqlite:///",
        "mysql://host/x": "no store of the kind mysql",
        "sqlite://": "a store in memory keeps nothing",
        f"sqlite:///{tmp_path}/none/fdd.db": "unable to open",
        f"sqlite:///{tmp_path}": "unable to open",
        "postgresql://fdd:secret@127.0.0.1:9/fdd": "127.0.0.1",
    }.items():
        with pytest.raises(InputError, match=line) as caught:
            Store(url)
        assert len(str(caught.value).splitlines()) == 1 and "secret" not in str(caught.value)
    try:
        import psycopg  # noqa: F401
    except ImportError:
        assert "install fdd[postgres]" in str(caught.value)
    else:
        assert isinstance(caught.value, StoreTrouble)


def test_a_database_of_another_program_or_version_is_left_alone(path, tmp_path):
    bookmarks = tmp_path / "bookmarks.db"
    with sqlite3.connect(bookmarks) as other:
        other.execute("CREATE TABLE bookmark (url TEXT)")
    with told(InputError, "of another program", bookmarks):
        Store(sqlite(bookmarks))
    with sqlite3.connect(bookmarks) as other:
        assert other.execute("SELECT name FROM sqlite_master").fetchall() == [("bookmark",)]
    for version in ("0001", "9999"):
        with sqlite3.connect(path) as other:
            other.execute(f"UPDATE fdd_revision SET version_num = '{version}'")
        wanted = rf"of another version of fdd \(its tables are {version}, here 0002\); use that fdd"
        with told(InputError, wanted, path):
            Store(sqlite(path))
