"""A connection to SQLite or PostgreSQL that behaves alike: what is committed is on the disk."""

from __future__ import annotations

from typing import Any

import orjson
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError

from fdd.errors import InputError
from fdd.service.store.troubles import told

BUSY_TIMEOUT_S = 5.0
"""For which a writer waits for another one."""
WRITES = "fdd_writes"
"""Option of a connection whose transactions write."""
_LOCK = 0x666464
"""Any number that no other program's lock in the database has; "fdd"."""
_URLS = "sqlite:///fdd.db or postgresql://user@host/database"


def connect(url: str, busy_timeout: float = BUSY_TIMEOUT_S) -> tuple[Engine, str]:
    """An engine, and what its database is called in messages. A damaged database is refused.

    Raises
    ------
    InputError : not such a URL, no driver, or a damaged file. StoreTrouble : not to be reached now.

    Examples
    --------
    >>> engine, where = connect("sqlite:///fdd.db"); where; engine.dispose()
    'fdd.db'
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
        return _sqlite(parsed, options, busy_timeout)
    if parsed.drivername in ("postgresql", "postgres", "postgresql+psycopg"):
        return _postgres(parsed.set(drivername="postgresql+psycopg"), options)
    raise InputError(f"no store of the kind {parsed.drivername}", mend=f"give {_URLS}")


def _sqlite(url: URL, options: dict[str, Any], busy_timeout: float) -> tuple[Engine, str]:
    where = url.database or ""
    if where in ("", ":memory:"):
        raise InputError("a store in memory keeps nothing", mend="name a file, e.g. sqlite:///fdd.db")
    engine = create_engine(url, connect_args={"timeout": busy_timeout}, **options)
    event.listen(engine, "connect", _prepared)
    event.listen(engine, "begin", _begun)
    with told(where), engine.connect() as connection:
        problem = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar_one()
        if problem != "ok":
            raise InputError(
                f"the store is damaged ({problem})", where=where,
                mend="nothing was changed; move the file away, or put a backup in its place",
            )  # fmt: skip
    return engine, where


def _prepared(connection: Any, _record: Any) -> None:
    # The driver opens no transactions of its own accord: `_begun` does, for changes of the schema too.
    connection.isolation_level = None
    for pragma in (
        "auto_vacuum=INCREMENTAL",  # of an empty file only; room is then given back without writing all anew
        "journal_mode=WAL",  # readers and the writer do not wait for each other
        "synchronous=FULL",  # what was committed outlives a loss of power: a source is told so
        "secure_delete=OFF",  # Debian's is on: deleting a journal would cost as much as writing it
    ):
        connection.execute(f"PRAGMA {pragma}").fetchall()


def _begun(connection: Connection) -> None:
    # A writer that began as a reader could not wait for another one.
    writes = connection.get_execution_options().get(WRITES)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def _postgres(url: URL, options: dict[str, Any]) -> tuple[Engine, str]:
    where = url.render_as_string(hide_password=True)
    try:
        # A connection that the server closed meanwhile is replaced before it is used.
        engine = create_engine(url, pool_pre_ping=True, connect_args={"connect_timeout": 10}, **options)
    except ModuleNotFoundError:
        raise InputError("needs the package psycopg", where=where, mend="install fdd[postgres]") from None
    event.listen(engine, "begin", _alone)
    with told(where), engine.connect():
        return engine, where


def _alone(connection: Connection) -> None:
    # One writer at a time, as with SQLite: sums are read, added to and written.
    if connection.get_execution_options().get(WRITES):
        connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({_LOCK})")
