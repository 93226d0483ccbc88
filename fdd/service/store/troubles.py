"""What a database complains about, in one line that says whether it passes by itself."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as NoConnection

from fdd.errors import InputError


class StoreTrouble(InputError):
    """The store cannot be used now (locked, full, server away): try again later, nothing was written.

    Examples
    --------
    >>> str(StoreTrouble("is full", where="fdd.db", mend="free space"))
    'fdd.db: is full; free space'
    """


class LeaseLost(InputError):
    """Somebody else has taken over what this process wrote; nothing was written, and never will be.

    Examples
    --------
    >>> str(LeaseLost("fdd.db", "shard 3"))
    'fdd.db: another fdd serve has taken over (shard 3); stop one of them'
    """

    def __init__(self, where: str, name: str) -> None:
        super().__init__(f"another fdd serve has taken over ({name})", where=where, mend="stop one of them")


_LOCKED = (StoreTrouble, "is locked by another program", "close what else has it open")
_FULL = (StoreTrouble, "cannot grow, the disk is full", "free space")
_DAMAGED = (
    InputError,
    "is damaged, or no database of SQLite",
    "nothing was changed; move the file away, or put a backup in its place",
)
_READ_ONLY = (InputError, "is read-only", "allow writing to the file and its folder")
_SQLITE: dict[str, tuple[type[InputError], str, str]] = {
    "SQLITE_BUSY": _LOCKED,
    "SQLITE_LOCKED": _LOCKED,
    "SQLITE_FULL": _FULL,
    "SQLITE_IOERR": (StoreTrouble, "cannot be read or written", "look at the disk"),
    "SQLITE_CANTOPEN": (StoreTrouble, "cannot be opened", "look at the folder and its permissions"),
    "SQLITE_NOMEM": (StoreTrouble, "does not get enough memory", "free memory"),
    "SQLITE_CORRUPT": _DAMAGED,
    "SQLITE_NOTADB": _DAMAGED,
    "SQLITE_READONLY": _READ_ONLY,
}
_POSTGRES_PASSING = ("08", "40", "53", "55P03", "57")
"""Classes of SQLSTATE that pass: connection, rolled back for another one, no resources, locked, stopped."""
_POSTGRES_REFUSED = ("28", "3D", "42501")
"""Wrong password, no such database, no rights."""


@contextmanager
def told(where: str) -> Iterator[None]:
    """Tell a database's trouble in one line; what is a mistake of the program goes on as it is.

    Parameters
    ----------
    where : the database's file, or its URL without the password.

    Raises
    ------
    StoreTrouble : it may pass. InputError : somebody must mend it.

    Examples
    --------
    >>> with told("fdd.db"):
    ...     store.alarms()  # doctest: +SKIP
    """
    try:
        yield
    except NoConnection:
        raise StoreTrouble("has no free connection", where=where, mend="try again") from None
    except (DBAPIError, sqlite3.Error) as error:
        # The driver's own come from settings that are made on a new connection.
        cause = error.orig if isinstance(error, DBAPIError) else error
        known = _of_sqlite(cause) or _of_postgres(cause)
        if known is None:
            raise
        kind, problem, mend = known
        raise kind(f"the store {problem}", where=where, mend=mend) from None


def _of_sqlite(cause: object) -> tuple[type[InputError], str, str] | None:
    # SQLITE_IOERR_WRITE, SQLITE_BUSY_SNAPSHOT and the like are kinds of the first two words.
    name = getattr(cause, "sqlite_errorname", "")
    return _SQLITE.get("_".join(name.split("_")[:2]))


def _of_postgres(cause: object) -> tuple[type[InputError], str, str] | None:
    state, said = getattr(cause, "sqlstate", None), f"says: {cause}"
    if state is None:
        # The server was not reached, or the connection broke.
        lost = type(cause).__name__ == "OperationalError" and type(cause).__module__.startswith("psycopg")
        return (StoreTrouble, said, "look at the server") if lost else None
    if state == "25006":
        return _READ_ONLY
    if state.startswith(_POSTGRES_PASSING):
        return StoreTrouble, said, "look at the server"
    if state.startswith(_POSTGRES_REFUSED):
        return InputError, said, "correct the URL, or the role's rights"
    return None
