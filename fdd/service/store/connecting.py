"""A connection to SQLite or PostgreSQL that behaves alike: what is committed is on the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import orjson
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError

from fdd.errors import InputError
from fdd.service.store.troubles import StoreTrouble, told

BUSY_TIMEOUT_S = 5.0
"""For which a writer waits for another one."""
WRITES = "fdd_writes"
"""Option of a connection whose transactions write."""
_LOG = "fdd_log"
"""What a connection notes of the log that it writes to."""
_LOCK = 0x666464
"""Any number that no other program's lock in the database has; "fdd"."""
_AWAY = {
    "connect_timeout": 10, "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 2,
    "tcp_user_timeout": 20_000,
}  # fmt: skip
"""A server whose machine or network is gone without a word is noticed after 20 s, not 15 minutes."""
_URLS = "sqlite:///fdd.db or postgresql://user@host/database"


def connect(url: str, busy_timeout: float = BUSY_TIMEOUT_S, existing: bool = False) -> tuple[Engine, str]:
    """An engine, and what its database is called in messages. A damaged database is refused.

    Parameters
    ----------
    existing : refuse a file that is not there.

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
        if existing and not Path(parsed.database or "").is_file():
            raise InputError(
                "no such file", where=parsed.database or url, mend="name the store of serve.yaml"
            )
        return _sqlite(parsed, options, busy_timeout)
    if parsed.drivername in ("postgresql", "postgres", "postgresql+psycopg"):
        return _postgres(parsed.set(drivername="postgresql+psycopg"), options)
    raise InputError(f"no store of the kind {parsed.drivername}", mend=f"give {_URLS}")


def _sqlite(url: URL, options: dict[str, Any], busy_timeout: float) -> tuple[Engine, str]:
    where = url.database or ""
    if where in ("", ":memory:"):
        raise InputError("a store in memory keeps nothing", mend="name a file, e.g. sqlite:///fdd.db")
    engine = create_engine(url, connect_args={"timeout": busy_timeout}, **options)
    files = _Files(engine, where)
    event.listen(engine, "do_connect", files.connecting)
    event.listen(engine, "connect", _prepared)
    event.listen(engine, "begin", files.begun)
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


class _Files:
    """Keeps SQLite to the files that it opened: what goes to ones that were moved or removed is lost."""

    def __init__(self, engine: Engine, where: str) -> None:
        self._engine, self._file, self._log = engine, Path(where), Path(f"{where}-wal")
        self._known: dict[Path, tuple[int, int] | None] = {}

    def connecting(self, *_: object) -> None:
        """Before a connection is made: SQLite would make new, empty files."""
        for path in (self._file, self._log):
            if self._is_gone(path):
                raise StoreTrouble("the store's file is gone", where=str(path), mend="put it back")

    def begun(self, connection: Connection) -> None:
        writes = connection.get_execution_options().get(WRITES)
        own = connection.connection.info  # this connection may be older than the log that is there
        log = _identity(self._log)
        if writes and own.get(_LOG, log) != log and not self._is_gone(self._file):
            self._without_log(connection)
        if writes:
            self.connecting()
        # A writer that began as a reader could not wait for another one.
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
        if writes:
            self._known = {path: _identity(path) for path in (self._file, self._log)}
            own[_LOG] = self._known[self._log]

    def _is_gone(self, path: Path) -> bool:
        known = self._known.get(path)
        return known is not None and known != _identity(path)

    def _without_log(self, connection: Connection) -> None:
        """Put what the removed log holds into the file, once; connections that come begin a new one."""
        driver: Any = connection.connection.driver_connection
        if self._is_gone(self._log):
            if driver.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] != 0:
                return  # somebody reads in it now: the next one tries again
            self._engine.dispose()
            del self._known[self._log]
        connection.invalidate()
        raise StoreTrouble("the store's log was removed", where=str(self._log), mend="leave it there")


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


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
