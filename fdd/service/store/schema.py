"""What the store holds: its tables (a change needs a new `VERSION`), axes' states, quantities over spans."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import orjson
import pyarrow as pa
import sqlalchemy as sa
from numpy.typing import NDArray
from sqlalchemy import JSON, BigInteger, Boolean, Column, Double, Index, Integer, LargeBinary, Table, Text

from fdd.errors import InputError

METADATA = sa.MetaData()
VERSION = "0002"
"""Of the tables; a store of another one is refused."""
_CODEC = pa.Codec("zstd", 1)
"""States halve, as with zlib in six times the time."""
SPANS_S = {"minute": 60.0, "hour": 3600.0, "day": 86400.0}
"""Level to its span; all begin at whole multiples of it (UTC)."""


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


@dataclass(frozen=True)
class Checkpoint:
    """The state of an axis, from which it goes on after a restart, at `time` (s of the stream's clock) and
    `wall` (Unix seconds). `sequence`: id of the last journal row whose block is in the state; `version`: of
    the state's form; `arrays`: the state, by names of whom it belongs to."""

    axis: str
    time: float
    wall: float
    sequence: int
    profile_sha256: str
    model_sha256: str
    version: str
    arrays: Mapping[str, NDArray[Any]]


def packed(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, str]:
    """What is stored of named arrays, and its SHA-256; NumPy's own archive takes ten times as long."""
    head = orjson.dumps([(name, a.dtype.str, a.shape) for name, a in arrays.items()])
    body = b"".join([len(head).to_bytes(8, "little"), head, *(a.tobytes() for a in arrays.values())])
    small = len(body).to_bytes(8, "little") + _CODEC.compress(body, asbytes=True)
    return small, hashlib.sha256(small).hexdigest()


def unpacked(small: bytes, sha256: str, where: str) -> dict[str, NDArray[Any]]:
    """The arrays of what `packed` gave; raises InputError where it is damaged, or of another version."""
    mend = "the axis must start anew"
    if hashlib.sha256(small).hexdigest() != sha256:
        raise InputError("a checkpoint is damaged", where=where, mend=mend)
    try:
        body: bytes = _CODEC.decompress(small[8:], int.from_bytes(small[:8], "little"), asbytes=True)
        start = 8 + int.from_bytes(body[:8], "little")
        out: dict[str, NDArray[Any]] = {}
        for name, kind, shape in orjson.loads(body[8:start]):
            dtype, count = np.dtype(kind), int(np.prod(shape))
            out[name] = np.frombuffer(body, dtype, count, start).reshape(shape).copy()
            start += count * dtype.itemsize
    except (OSError, ValueError, TypeError, OverflowError, MemoryError):
        raise InputError("a checkpoint is of another version of fdd", where=where, mend=mend) from None
    return out


@dataclass(frozen=True)
class Rollup:
    """What a quantity was over a span, in SI: `n` values, `std` of all (divided by n, not n - 1) with what
    each errs by itself. `start_wall`: Unix seconds, any within the span; the store sets its beginning."""

    axis: str
    quantity: str
    start_wall: float
    n: int
    mean: float
    std: float
    min: float
    max: float

    def over(self, level: str) -> Rollup:
        """The same, of the span of a level that it belongs to."""
        span = SPANS_S[level]
        return replace(self, start_wall=math.floor(self.start_wall / span) * span)

    def merged(self, other: Rollup) -> Rollup:
        """Both parts together, by Chan, Golub and LeVeque's update (1979), which loses no digits."""
        n, apart = self.n + other.n, other.mean - self.mean
        square = (self.n * self.std**2 + other.n * other.std**2 + apart**2 * (self.n * other.n / n)) / n
        return replace(
            self, n=n, mean=self.mean + apart * (other.n / n), std=math.sqrt(square),
            min=min(self.min, other.min), max=max(self.max, other.max),
        )  # fmt: skip
