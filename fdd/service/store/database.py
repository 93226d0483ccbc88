"""SQLite or PostgreSQL behind one engine, with our tables: what is committed is on the disk."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import orjson
import sqlalchemy as sa
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, OperationalError
from sqlalchemy.exc import TimeoutError as NoConnection

from fdd.errors import InputError
from fdd.service.store.schema import GROWS, METADATA, REVISION, VERSION

WRITES = "fdd_writes"
"""Option of a connection whose transactions write."""
_LOCK = 0x666464
"""Any number that no other program's lock in the database has; "fdd"."""
_AWAY = {
    "connect_timeout": 10, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 2,
    "tcp_user_timeout": 20_000,
}  # fmt: skip
"""A server whose machine or network is gone without a word is noticed after 20 s, not 15 minutes."""
_URLS = "sqlite:///fdd.db or postgresql://user@host/database"
_DAMAGE = ("DatabaseError", "InternalError")
_NO_RIGHTS = "42501"
_BACKUP = "nothing was changed; move the file away, or put a backup in its place"


class StoreTrouble(InputError):
    """The store cannot be used now (locked, full, server away): try again later, nothing was written."""


class LeaseLost(InputError):
    """Somebody else has taken over what this process wrote; nothing was written, and never will be."""

    def __init__(self, where: str) -> None:
        super().__init__("another fdd serve has taken over", where=where, mend="stop one of them")


@contextmanager
def told(where: str) -> Iterator[None]:
    """Tell a database's trouble in one line; what is a mistake of the program goes on as it is.

    Raises StoreTrouble: it may pass. InputError: somebody must mend it.
    """
    try:
        yield
    except NoConnection:
        raise StoreTrouble("the store has no free connection", where=where, mend="try again") from None
    except (DBAPIError, sqlite3.Error) as error:
        # The driver's own come from settings that are made on a new connection.
        cause = error.orig if isinstance(error, DBAPIError) else error
        said = f"the store says: {' '.join(str(cause).split())}"
        if isinstance(error, OperationalError | sqlite3.OperationalError):
            mend = "look at the disk, at the server, and at who else has it open"
            raise StoreTrouble(said, where=where, mend=mend) from None
        if type(error).__name__ in _DAMAGE:
            raise InputError(said, where=where, mend=_BACKUP) from None
        if getattr(cause, "sqlstate", None) == _NO_RIGHTS:
            raise InputError(said, where=where, mend="correct the role's rights") from None
        raise


def connect(url: str) -> tuple[Engine, str]:
    """An engine, and what its database is called in messages.

    Raises InputError: not such a URL, no driver, or a damaged file. StoreTrouble: not to be reached now.
    """
    try:
        parsed = make_url(url)
    except ArgumentError:
        raise InputError("the store's URL cannot be read", mend=f"e.g. {_URLS}") from None
    options: dict[str, Any] = {
        # Of a non-finite number JSON knows nothing: null.
        "json_serializer": lambda value: orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode(),
        "json_deserializer": orjson.loads,
    }
    if parsed.drivername in ("sqlite", "sqlite+pysqlite"):
        return _sqlite(parsed, options)
    if parsed.drivername in ("postgresql", "postgres", "postgresql+psycopg"):
        return _postgres(parsed.set(drivername="postgresql+psycopg"), options)
    raise InputError(f"no store of the kind {parsed.drivername}", mend=f"give {_URLS}")


def _sqlite(url: URL, options: dict[str, Any]) -> tuple[Engine, str]:
    where = url.database or ""
    if where in ("", ":memory:"):
        raise InputError("a store in memory keeps nothing", mend="name a file, e.g. sqlite:///fdd.db")
    engine = create_engine(url, **options)  # a writer waits 5 s for another one, or as long as ?timeout= says
    known: list[tuple[int, int]] = []

    def require_there(*_: object) -> None:
        """What goes to a file that was moved or removed is lost, and SQLite would make a new one."""
        try:
            found = Path(where).stat()
        except OSError:
            found = None
        if known and (found is None or (found.st_dev, found.st_ino) != known[0]):
            raise StoreTrouble("the store's file is gone", where=where, mend="put it back")
        if found is not None and not known:
            known.append((found.st_dev, found.st_ino))

    def begun(connection: Connection) -> None:
        require_there()
        # A writer that began as a reader could not wait for another one.
        writes = connection.get_execution_options().get(WRITES)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    event.listen(engine, "do_connect", require_there)
    event.listen(engine, "connect", _prepared)
    event.listen(engine, "begin", begun)
    with told(where), engine.connect() as connection:
        problem = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar_one()
        if problem != "ok":
            raise InputError(f"the store is damaged ({problem})", where=where, mend=_BACKUP)
    return engine, where


def _prepared(connection: Any, _record: Any) -> None:
    # The driver opens no transactions of its own accord: `begun` does, for changes of the schema too.
    connection.isolation_level = None
    for pragma in (
        "auto_vacuum=INCREMENTAL",  # of an empty file only; room is then given back without writing all anew
        "journal_mode=WAL",  # readers and the writer do not wait for each other
        "synchronous=FULL",  # what was committed outlives a loss of power: a source is told so
        "secure_delete=OFF",  # Debian's is on: deleting a journal would cost as much as writing it
    ):
        connection.execute(f"PRAGMA {pragma}").fetchall()


def _postgres(url: URL, options: dict[str, Any]) -> tuple[Engine, str]:
    where = url.render_as_string(hide_password=True)
    try:
        # A connection that the server closed meanwhile is replaced before it is used.
        engine = create_engine(url, pool_pre_ping=True, connect_args=_AWAY, **options)
    except ModuleNotFoundError:
        raise InputError("needs the package psycopg", where=where, mend="install fdd[postgres]") from None
    event.listen(engine, "begin", _alone)
    with told(where), engine.connect():
        return engine, where


def _alone(connection: Connection) -> None:
    # One writer at a time, as with SQLite: sums are read, added to and written.
    if connection.get_execution_options().get(WRITES):
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK})")


def prepare(engine: sa.Engine, where: str) -> None:
    """Make the tables of an empty database, all or none.

    Raises InputError: the database is of another version of fdd, or of another program.
    """
    # One transaction: of two that start at once, one waits and then finds nothing to do.
    with told(where), engine.connect().execution_options(**{WRITES: True}) as connection, connection.begin():
        dialect, found = engine.dialect.name, set(sa.inspect(connection).get_table_names())
        if REVISION.name in found:
            version = connection.execute(sa.select(REVISION)).scalar()
            if version != VERSION:
                problem = f"the store is of another version of fdd (its tables are {version}, here {VERSION})"
                raise InputError(problem, where=where, mend="use that fdd, or name another store")
            return
        # Other programs' tables may stand beside ours on a server, but not in a file.
        foreign = found if dialect == "sqlite" else found & set(METADATA.tables)
        if foreign:
            problem = f"is a database of another program (it has a table {min(foreign)})"
            raise InputError(problem, where=where, mend="name another file, or a database of its own")
        METADATA.create_all(connection)
        connection.execute(sa.insert(REVISION), {"version_num": VERSION})
        for statement in GROWS[dialect]:
            connection.exec_driver_sql(statement)
