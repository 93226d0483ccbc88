"""The tables. A change here needs a new `VERSION`."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from sqlalchemy import JSON, BigInteger, Boolean, Column, Double, Index, Integer, LargeBinary, Table, Text

METADATA = sa.MetaData()
VERSION = "0002"
"""Of the tables; a store of another one is refused."""


def _key(name: str, kind: Any) -> Column[Any]:
    return Column(name, kind, primary_key=True)


def _needed(kind: Any, *names: str) -> list[Column[Any]]:
    return [Column(name, kind, nullable=False) for name in names]


def _known(kind: Any, *names: str) -> list[Column[Any]]:
    """Columns that may be empty."""
    return [Column(name, kind) for name in names]


def _counted(name: str, *parts: Any) -> Table:
    """A table of numbered rows. Ids of rows that are gone never come again: a checkpoint names one."""
    id = _key("id", BigInteger().with_variant(Integer, "sqlite"))  # SQLite counts up only what is an INTEGER
    return Table(name, METADATA, id, *parts, sqlite_autoincrement=True)


REVISION = Table("fdd_revision", METADATA, _key("version_num", sa.String(32)))
META = Table("meta", METADATA, _key("key", Text), *_needed(Text, "value"))
AXIS = Table(
    "axis",
    METADATA,
    _key("name", Text),
    *_known(Text, "unit", "profile_sha256", "model_sha256", "state"),
    *_needed(Double, "first_wall", "last_wall"),
    *_known(Double, "last_time"),
)
FINDING = _counted(
    "finding",
    *_needed(Text, "axis", "fault", "family"),
    *_needed(Double, "time", "wall", "confidence"),
    *_known(Double, "onset", "severity", "low", "high"),
    *_needed(JSON, "body"),
    Index("finding_by_axis", "axis", "wall"),
)
ALARM = Table(
    "alarm",
    METADATA,
    Column("id", BigInteger, primary_key=True, autoincrement=False),  # the alarm book gives the ids
    *_needed(Text, "axis", "key", "state", "priority", "note"),
    *_needed(Double, "raised_time", "raised_wall"),
    *_known(Double, "returned_wall", "acked_wall", "shelved_until"),
    *_known(Text, "acked_by", "shelved_by"),
    *_needed(Integer, "count"),
    *_needed(Boolean, "chattering"),
    *_needed(JSON, "body"),
    Index("alarm_by_key", "axis", "key", "id"),
    Index("alarm_by_state", "state"),
)
AUDIT = _counted(
    "audit",
    *_needed(Double, "wall"),
    *_known(Double, "time"),
    *_needed(Text, "who", "action", "note"),
    *_known(BigInteger, "alarm_id"),
    *_known(Text, "axis"),
    *_needed(JSON, "body"),
    Index("audit_by_alarm", "alarm_id"),
)
ROLLUP = Table(
    "rollup",
    METADATA,
    *(_key(name, Text) for name in ("axis", "quantity", "level")),
    _key("start_wall", Double),
    *_needed(BigInteger, "n"),
    *_needed(Double, "mean", "std", "min", "max"),
    Index("rollup_by_age", "level", "start_wall"),
    sqlite_with_rowid=False,  # its key is most of a row: kept once, not beside it again
)
CHECKPOINT = Table(
    "checkpoint",
    METADATA,
    _key("axis", Text),
    *_needed(Double, "time", "wall"),
    *_needed(BigInteger, "sequence"),
    *_needed(Text, "profile_sha256", "model_sha256", "version", "sha256"),
    *_needed(LargeBinary, "body"),
)
JOURNAL = _counted(
    "journal",
    *_needed(Text, "axis"),
    *_needed(LargeBinary, "payload"),
    Index("journal_by_axis", "axis", "id"),
)
_TO_DO = sa.text("NOT done")
OUTBOX = _counted(
    "outbox",
    *_needed(Text, "kind", "target"),
    *_needed(JSON, "body"),
    *_needed(Integer, "attempts"),
    *_needed(Double, "next_wall"),
    Column("done", Boolean, nullable=False, server_default=sa.false()),
    Index("outbox_to_do", "target", "id", sqlite_where=_TO_DO, postgresql_where=_TO_DO),
)

# The audit only grows, whoever writes. INSERT OR REPLACE deletes without asking a trigger for deletes.
_REFUSED = "BEGIN SELECT RAISE(ABORT, 'the audit only grows'); END"
GROWS = {
    "sqlite": (
        f"CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit {_REFUSED}",
        f"CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit {_REFUSED}",
        "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit "
        f"WHEN EXISTS (SELECT 1 FROM audit WHERE id = NEW.id) {_REFUSED}",
    ),
    "postgresql": (
        "CREATE FUNCTION audit_grows() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN RAISE EXCEPTION 'the audit only grows'; END $$",
        "CREATE TRIGGER audit_grows BEFORE UPDATE OR DELETE ON audit "
        "FOR EACH ROW EXECUTE FUNCTION audit_grows()",
        "CREATE TRIGGER audit_stays BEFORE TRUNCATE ON audit "
        "FOR EACH STATEMENT EXECUTE FUNCTION audit_grows()",
    ),
}
