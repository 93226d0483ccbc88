"""The tables. A change here needs a new revision in `migrations/versions`; a test compares the two."""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Double,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    false,
    text,
)

METADATA = MetaData()
BIG = BigInteger().with_variant(Integer, "sqlite")
"""SQLite counts up only what is called INTEGER."""


def _needed(name: str, kind: Any) -> Column[Any]:
    return Column(name, kind, nullable=False)


def _key(name: str, kind: Any) -> Column[Any]:
    return Column(name, kind, primary_key=True)


META = Table("meta", METADATA, _key("key", Text), _needed("value", Text))

AXIS = Table(
    "axis",
    METADATA,
    _key("name", Text),
    Column("unit", Text),
    Column("profile_sha256", Text),
    Column("model_sha256", Text),
    _needed("first_wall", Double),
    _needed("last_wall", Double),
    Column("last_time", Double),
    Column("state", Text),
)

FINDING = Table(
    "finding",
    METADATA,
    _key("id", BIG),
    _needed("axis", Text),
    _needed("time", Double),
    _needed("wall", Double),
    Column("onset", Double),
    _needed("fault", Text),
    _needed("family", Text),
    _needed("confidence", Double),
    Column("severity", Double),
    Column("low", Double),
    Column("high", Double),
    _needed("body", JSON),
    Index("finding_by_axis", "axis", "wall"),
    sqlite_autoincrement=True,
)

ALARM = Table(
    "alarm",
    METADATA,
    # The alarm book gives the ids.
    Column("id", BigInteger, primary_key=True, autoincrement=False),
    _needed("axis", Text),
    _needed("key", Text),
    _needed("state", Text),
    _needed("priority", Text),
    _needed("raised_time", Double),
    _needed("raised_wall", Double),
    Column("returned_wall", Double),
    Column("acked_by", Text),
    Column("acked_wall", Double),
    Column("shelved_by", Text),
    Column("shelved_until", Double),
    _needed("count", Integer),
    _needed("chattering", Boolean),
    _needed("note", Text),
    _needed("body", JSON),
    Index("alarm_by_key", "axis", "key", "id"),
    Index("alarm_by_state", "state"),
)

AUDIT = Table(
    "audit",
    METADATA,
    _key("id", BIG),
    _needed("wall", Double),
    Column("time", Double),
    _needed("who", Text),
    _needed("action", Text),
    Column("alarm_id", BigInteger),
    Column("axis", Text),
    _needed("note", Text),
    _needed("body", JSON),
    Index("audit_by_alarm", "alarm_id"),
    sqlite_autoincrement=True,
)

ROLLUP = Table(
    "rollup",
    METADATA,
    _key("axis", Text),
    _key("quantity", Text),
    _key("level", Text),
    _key("start_wall", Double),
    _needed("n", BigInteger),
    _needed("mean", Double),
    _needed("std", Double),
    _needed("min", Double),
    _needed("max", Double),
    Index("rollup_by_age", "level", "start_wall"),
    # Its key is most of a row: kept once, not beside it again.
    sqlite_with_rowid=False,
)

COUNTS = ("dropped", "late", "repeated", "gaps", "nan")
QUALITY = Table(
    "quality",
    METADATA,
    _key("axis", Text),
    _key("start_wall", Double),
    *(_needed(name, BigInteger) for name in COUNTS),
)

CHECKPOINT = Table(
    "checkpoint",
    METADATA,
    _key("axis", Text),
    _needed("time", Double),
    _needed("wall", Double),
    _needed("sequence", BigInteger),
    _needed("profile_sha256", Text),
    _needed("model_sha256", Text),
    _needed("version", Text),
    _needed("body", LargeBinary),
    _needed("sha256", Text),
)

JOURNAL = Table(
    "journal",
    METADATA,
    _key("id", BIG),
    _needed("axis", Text),
    _needed("payload", LargeBinary),
    Index("journal_by_axis", "axis", "id"),
    # Ids of rows that are gone never come again: a checkpoint names the last one that it holds.
    sqlite_autoincrement=True,
)

OUTBOX = Table(
    "outbox",
    METADATA,
    _key("id", BIG),
    _needed("kind", Text),
    _needed("body", JSON),
    _needed("target", Text),
    _needed("attempts", Integer),
    _needed("next_wall", Double),
    Column("done", Boolean, nullable=False, server_default=false()),
    Index("outbox_to_do", "target", "id", sqlite_where=text("NOT done"), postgresql_where=text("NOT done")),
    sqlite_autoincrement=True,
)
