"""A store that is damaged, locked, full, read-only, foreign, of another version."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from stores import LEAK, WALL

from fdd.errors import InputError
from fdd.service.store import Store, StoreTrouble


def url_of(path: Path) -> str:
    return f"sqlite:///{path}"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Of a closed store with some hundred pages."""
    path = tmp_path / "state" / "fdd.db"
    path.parent.mkdir()
    with closing(Store(url_of(path))) as store:
        with store.transaction() as t:
            t.accept_all([("A1", os.urandom(8000)) for _ in range(50)])
            for _ in range(200):
                t.found("A1", 1.0, WALL, LEAK)
            t.audit(WALL, "ann", "LOGIN")
        store.compact(WALL)
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
def test_a_damaged_file_is_named_and_left_as_it_is(damage: Callable[[bytes], bytes], path: Path) -> None:
    data = damage(path.read_bytes())
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged|malformed|not a database") as caught:
        Store(url_of(path))
    one_line(caught.value, path)
    assert not isinstance(caught.value, StoreTrouble), "waiting mends nothing"
    assert path.read_bytes() == data


def test_a_locked_store_is_a_trouble_that_passes(path: Path) -> None:
    store = Store(f"{url_of(path)}?timeout=0.1")
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(StoreTrouble, match="is locked") as caught, store.transaction() as t:
        t.audit(WALL, "ann", "LOGOUT")
    one_line(caught.value, path)
    assert len(store.audit()) == 1, "readers go on"
    other.execute("ROLLBACK")
    with closing(Store(url_of(path))) as first, first.transaction() as t:
        with pytest.raises(StoreTrouble, match="is locked"), store.transaction():
            raise AssertionError("what the first one, which only read so far, has read would be old")
        t.audit(WALL, "ann", "LOGOUT")
    assert len(store.audit()) == 2
    store.close()
    other.execute("PRAGMA locking_mode=EXCLUSIVE")
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(StoreTrouble, match="is locked"):
        Store(f"{url_of(path)}?timeout=0.1")
    other.close()


def test_a_full_disk_is_a_trouble_that_passes_and_a_read_only_store_is_told(path: Path) -> None:
    store = Store(url_of(path))
    before = store.journal("A1")
    with pytest.raises(StoreTrouble, match="disk is full") as caught, store.transaction() as t:
        t.accept_all([("A1", b"first")])
        t._connection.exec_driver_sql("PRAGMA max_page_count=1")
        t.accept_all([("A1", bytes(8000))] * 100)
    one_line(caught.value, path)
    assert store.journal("A1") == before, "nothing of it may be there"
    store.close()
    store = Store(url_of(path))
    with store.transaction() as t:
        t.accept_all([("A1", bytes(8000))] * 100)
    assert len(store.journal("A1")) == len(before) + 100
    with pytest.raises(InputError, match="readonly database") as refused, store.transaction() as t:
        t._connection.exec_driver_sql("PRAGMA query_only=ON")
        t.audit(WALL, "ann", "LOGOUT")
    one_line(refused.value, path)
    store.close()


@pytest.mark.parametrize("gone", ["fdd.db", ""])
def test_a_store_that_is_moved_away_takes_nothing_until_it_is_back(
    gone: str, path: Path, tmp_path: Path
) -> None:
    def accept(payload: bytes) -> None:
        with store.transaction() as t:
            t.accept_all([("A2", payload)])

    with closing(Store(url_of(path))) as store:
        accept(b"before")
        (path.parent / gone).rename(tmp_path / "away")
        for _ in range(2):
            with pytest.raises(StoreTrouble, match="file is gone; put it back") as caught:
                accept(b"meanwhile")
            one_line(caught.value, path)
        assert not path.exists(), "no empty one in its place"
        (tmp_path / "away").rename(path.parent / gone)
        accept(b"after")
        copy = tmp_path / "as-after-a-kill"
        shutil.copytree(path.parent, copy)
    with closing(Store(url_of(copy / "fdd.db"))) as killed:
        assert [payload for _, payload in killed.journal("A2")] == [b"before", b"after"]


def test_urls_that_are_no_store_or_lead_to_none_are_told_without_the_password(tmp_path: Path) -> None:
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


def test_a_database_of_another_program_or_version_is_left_alone(path: Path, tmp_path: Path) -> None:
    bookmarks = tmp_path / "bookmarks.db"
    with sqlite3.connect(bookmarks) as other:
        other.execute("CREATE TABLE bookmark (url TEXT)")
    with pytest.raises(InputError, match="of another program") as caught:
        Store(url_of(bookmarks))
    one_line(caught.value, bookmarks)
    with sqlite3.connect(bookmarks) as other:
        assert other.execute("SELECT name FROM sqlite_master").fetchall() == [("bookmark",)]
    for version in ("0001", "9999"):
        with sqlite3.connect(path) as other:
            other.execute(f"UPDATE fdd_revision SET version_num = '{version}'")
        wanted = rf"of another version of fdd \(its tables are {version}, here 0002\); use that fdd"
        with pytest.raises(InputError, match=wanted) as caught:
            Store(url_of(path))
        one_line(caught.value, path)
