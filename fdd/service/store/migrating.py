"""A database brought to this version's tables, or refused."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, inspect

from fdd.errors import InputError
from fdd.service.store.connecting import WRITES
from fdd.service.store.schema import METADATA
from fdd.service.store.troubles import told

VERSION_TABLE = "fdd_revision"


def migrate(engine: Engine, where: str, revision: str = "head", existing: bool = False) -> None:
    """Run the revisions that the database lacks, all or none.

    Parameters
    ----------
    where : the database, for messages. revision : to go up to. existing : refuse an empty database.

    Raises
    ------
    InputError : the database is of a newer fdd, of another program, or empty.

    Examples
    --------
    >>> migrate(*connect("sqlite:///fdd.db"))  # doctest: +SKIP
    """
    config = Config()
    folder = Path(__file__).parent / "migrations"
    config.set_main_option("script_location", str(folder).replace("%", "%%"))
    script = ScriptDirectory.from_config(config)
    # One transaction: of two that start at once, one waits and then finds nothing to do.
    with told(where), engine.connect().execution_options(**{WRITES: True}) as connection, connection.begin():
        context = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE})
        current = context.get_current_revision()
        if current is None and existing:
            raise InputError("is no store of fdd serve", where=where, mend="name that of serve.yaml")
        if current is None:
            _require_ours_alone(set(inspect(connection).get_table_names()), engine.dialect.name, where)
        elif current not in {r.revision for r in script.walk_revisions()}:
            raise InputError(
                f"the store is of a newer fdd (its schema is {current}, this fdd knows up to "
                f"{script.get_current_head()})", where=where, mend="update fdd",
            )  # fmt: skip
        config.attributes["connection"] = connection
        command.upgrade(config, revision)


def _require_ours_alone(found: set[str], dialect: str, where: str) -> None:
    # Other programs' tables may stand beside ours on a server, but not in a file.
    foreign = found if dialect == "sqlite" else found & set(METADATA.tables)
    if foreign:
        raise InputError(
            f"is a database of another program (it has a table {min(foreign)})",
            where=where, mend="name another file, or a database of its own",
        )  # fmt: skip
