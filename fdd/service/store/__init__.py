"""What the service keeps, in SQLite or PostgreSQL: one writer at a time, readers from any thread."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from typing import Any

import sqlalchemy as sa
from sqlalchemy import delete, func, insert, select
from sqlalchemy.dialects import postgresql, sqlite

from fdd.diagnosis.findings import FaultFinding
from fdd.service.alarms import ITSELF, Alarm, Transition, readable
from fdd.service.store.database import WRITES, LeaseLost, StoreTrouble, connect, prepare, told
from fdd.service.store.schema import (
    ALARM,
    AUDIT,
    AXIS,
    CHECKPOINT,
    FINDING,
    JOURNAL,
    META,
    OUTBOX,
    ROLLUP,
    SPANS_S,
    Checkpoint,
    Rollup,
    packed,
    unpacked,
)

__all__ = ["Checkpoint", "LeaseLost", "OutboxMessage", "Rollup", "Store", "StoreTrouble", "Transaction"]

DAY_S = 86400.0
Row = dict[str, Any]
_WRITTEN, _OWNER = "written", "serve"
"""Words of the store: token of the last batch; number of the process that claimed it last."""
profile_key, said_key, worked_key = "profile {}".format, "said {}".format, "worked {}".format
"""Words of the store: a profile (YAML) by its SHA-256; by what name an axis's blocks call their profile; the
journal's last row that was worked, of an axis put off."""
_ACCEPT, _LAST = insert(JOURNAL), select(func.max(JOURNAL.c.id))


@dataclass(frozen=True)
class OutboxMessage:
    """What must arrive at a target."""

    id: int
    kind: str
    body: Mapping[str, Any]
    attempts: int


class Transaction:
    """What is written at once, all of it or nothing; `Store.transaction` makes it.

    Times are `time`, s of the stream's clock, and `wall`, Unix seconds.
    """

    def __init__(self, connection: sa.Connection) -> None:
        self._connection = connection

    def once(self, token: str) -> bool:
        """Whether this is still to be written: a try with the same token may have been, its answer lost."""
        last = self.word(_WRITTEN)
        self.meta(_WRITTEN, token)
        return last != token

    def accept_all(self, blocks: Sequence[tuple[str, bytes]]) -> int:
        """Keep blocks, (axis, payload) each, until a checkpoint holds them; the id of the last one of all."""
        if blocks:
            self._connection.execute(_ACCEPT, [{"axis": a, "payload": p} for a, p in blocks])
        # Of this one: nobody else writes meanwhile.
        return int(self._connection.execute(_LAST).scalar_one() or 0)  # none are left after a checkpoint

    def axis(self, name: str, wall: float, **known: Any) -> None:
        """Note an axis and what is known of it now, of the columns of its table."""
        row = {"name": name, "first_wall": wall, "last_wall": wall, **known}
        self._put(AXIS, [row], keep=("first_wall",))

    def remove_axis(self, name: str, words: Sequence[str]) -> None:
        """Take out an axis, its state, its life and its words; alarms, findings and the audit stay."""
        for table, column in ((CHECKPOINT, "axis"), (JOURNAL, "axis"), (ROLLUP, "axis"), (AXIS, "name")):
            self.execute(delete(table).where(table.c[column] == name))
        self.forget(*words)

    def found(self, axis: str, time: float, wall: float, finding: FaultFinding) -> int:
        """Keep a finding; its id."""
        low, high = finding.severity_interval or (None, None)
        return self._add(
            FINDING, axis=axis, time=time, wall=wall, onset=finding.onset_s, fault=finding.fault,
            family=finding.family, confidence=finding.confidence, severity=finding.severity,
            low=low, high=high, body=finding.model_dump(mode="json"),
        )  # fmt: skip

    def alarm(self, *alarms: Alarm) -> None:
        """Keep alarms as they stand now."""
        rows = [asdict(alarm) for alarm in alarms]
        columns = {c.name for c in ALARM.c} - {"body"}
        self._put(ALARM, [{k: v for k, v in row.items() if k in columns} | {"body": row} for row in rows])

    def transition(self, transition: Transition) -> int:
        """Keep what happened to an alarm and the alarm as it stands now; the id of the audit's record."""
        alarm = transition.alarm
        self.alarm(alarm)
        body = {"before": transition.before, "after": alarm.state, "alarm": asdict(alarm)}
        return self.audit(
            transition.wall, transition.who, transition.action, time=transition.time,
            alarm_id=alarm.id, axis=alarm.axis, note=transition.note, body=body,
        )  # fmt: skip

    def audit(self, wall: float, who: str, action: str, note: str = "", **more: Any) -> int:
        """Put something done on record, for ever; its id. May have `time`, `alarm_id`, `axis`, `body`."""
        said = {"who": readable(who), "note": readable(note), "wall": wall, "action": action}
        return self._add(AUDIT, **{"body": {}, **said, **more})

    def rollup(self, *parts: Rollup) -> None:
        """Add parts of minutes to their minutes, hours and days."""
        c, names = ROLLUP.c, ("axis", "quantity", "start_wall")
        fields = select(*(column for column in c if column is not c.level))
        for level in SPANS_S if parts else ():
            new = [part.over(level) for part in parts]
            # What is stored of these axes, quantities and spans; few more than these parts.
            mine = [c[name].in_({getattr(part, name) for part in new}) for name in names]
            stored = self._connection.execute(fields.where(c.level == level, *mine))
            sums: dict[tuple[str, str, float], Rollup] = {}
            for part in [*(Rollup(**row._mapping) for row in stored), *new]:
                key = (part.axis, part.quantity, part.start_wall)
                sums[key] = sums[key].merged(part) if key in sums else part
            touched = {(part.axis, part.quantity, part.start_wall) for part in new}
            self._put(ROLLUP, [{"level": level, **asdict(sums[key])} for key in touched])

    def checkpoint(self, checkpoint: Checkpoint) -> None:
        """Keep an axis's state in place of the last one; the blocks that it holds leave the journal."""
        row = dict(vars(checkpoint))
        row["body"], row["sha256"] = packed(row.pop("arrays"))
        self._put(CHECKPOINT, [row])
        held = (JOURNAL.c.axis == checkpoint.axis) & (JOURNAL.c.id <= checkpoint.sequence)
        self.execute(delete(JOURNAL).where(held))

    def send(self, kind: str, body: Mapping[str, Any], target: str, wall: float) -> int:
        """Put something that must arrive at a target into the outbox; its id."""
        return self._add(OUTBOX, kind=kind, body=body, target=target, attempts=0, next_wall=wall)

    def execute(self, change: sa.Delete | sa.Update) -> int:
        """Delete or change rows; how many."""
        return int(self._connection.execute(change).rowcount)

    def forget(self, *keys: str) -> None:
        """Take out words about the store itself."""
        self.execute(delete(META).where(META.c.key.in_(keys)))

    def meta(self, key: str, value: str) -> None:
        """Keep a word about the store itself."""
        self._put(META, [{"key": key, "value": value}])

    def word(self, key: str) -> str | None:
        """A word about the store itself."""
        return self._connection.execute(select(META.c.value).where(META.c.key == key)).scalar()

    def _add(self, table: sa.Table, **row: Any) -> int:
        return int(self._connection.execute(insert(table).returning(table.c.id), row).scalar_one())

    def _put(self, table: sa.Table, rows: Sequence[Row], keep: tuple[str, ...] = ()) -> None:
        """Insert rows, or update those that are there: all that is given but `keep`."""
        if rows:
            upsert = _upsert(table, self._connection.dialect.name, tuple(rows[0]), keep)
            self._connection.execute(upsert, rows)


# Building the statement takes five times as long as executing it.
@cache
def _upsert(table: sa.Table, dialect: str, given: tuple[str, ...], keep: tuple[str, ...]) -> sa.Executable:
    new = (sqlite.insert if dialect == "sqlite" else postgresql.insert)(table)
    keys = [c.name for c in table.primary_key]
    values = {k: new.excluded[k] for k in given if k not in {*keys, *keep}}
    return new.on_conflict_do_update(index_elements=keys, set_=values)


class Store:
    """Open a store, and make its tables where there are none.

    Rows that it gives are dicts that JSON takes, with the columns' names; times are `time`, s of the stream's
    clock, and `wall`, Unix seconds. Whatever reads or writes raises `StoreTrouble` (locked, full, server
    away: try again, nothing was written) or `InputError` (damaged, read-only: somebody must mend it).

    Its URL is ``sqlite:///fdd.db`` or ``postgresql://user@host/database``.
    Raises InputError: wrong URL, damaged, of another fdd, of another program.
    """

    def __init__(self, url: str) -> None:
        self._lease: str | None = None
        self._engine, self.where = connect(url)
        prepare(self._engine, self.where)

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()

    @contextmanager
    def transaction(self) -> Iterator[Transaction]:
        """Write: all of the block, on the disk when it ends, or nothing if it raises.

        Raises LeaseLost: somebody else has `claim`ed the store since this one did.
        """
        with (
            told(self.where),
            self._engine.connect().execution_options(**{WRITES: True}) as connection,
            connection.begin(),
        ):
            # Of writers one at a time: whoever claims the store comes before this transaction, or after it.
            t = Transaction(connection)
            if self._lease is not None and t.word(_OWNER) != self._lease:
                raise LeaseLost(self.where)
            yield t

    def claim(self) -> None:
        """Be from now on the only one who writes; whoever was it before is refused."""
        with self.transaction() as t:
            lease = str(int(t.word(_OWNER) or "0") + 1)
            t.meta(_OWNER, lease)
        self._lease = lease

    def _rows(self, statement: sa.Select[Any]) -> list[Row]:
        with told(self.where), self._engine.connect() as connection:
            return [dict(row._mapping) for row in connection.execute(statement)]

    def _value(self, statement: sa.Select[Any]) -> Any:
        with told(self.where), self._engine.connect() as connection:
            return connection.execute(statement).scalar()

    def axes(self) -> list[Row]:
        """All axes, by name."""
        return self._rows(select(AXIS).order_by(AXIS.c.name))

    def alarms(self, states: Collection[str] | None = None, limit: int = 1000) -> list[Row]:
        """`Alarm`s as dicts, the newest first: those in some states, or all."""
        chosen = select(ALARM.c.body).order_by(ALARM.c.id.desc()).limit(limit)
        rows = self._rows(chosen if states is None else chosen.where(ALARM.c.state.in_(states)))
        return [row["body"] for row in rows]

    def alarm(self, id: int) -> Row | None:
        """One `Alarm` as a dict; None where there is none."""
        return self._value(select(ALARM.c.body).where(ALARM.c.id == id))

    def book(self) -> Row:
        """What `AlarmBook.restore` takes: alarms that are not over, each key's last one, and the next id."""
        c = ALARM.c
        last = select(func.max(c.id)).group_by(c.axis, c.key)
        chosen = select(c.id, c.body).where(sa.or_(c.state != "NORMAL", c.id.in_(last)))
        kept = self._rows(chosen.order_by(c.id))
        return {"next_id": kept[-1]["id"] + 1 if kept else 1, "alarms": [row["body"] for row in kept]}

    def findings(self, limit: int = 1000) -> list[Row]:
        """Findings, the newest first."""
        return self._rows(select(FINDING).order_by(FINDING.c.id.desc()).limit(limit))

    def audit(self, alarm_id: int | None = None, limit: int = 1000) -> list[Row]:
        """The audit's records, the newest first: of an alarm, or all."""
        chosen = select(AUDIT).order_by(AUDIT.c.id.desc()).limit(limit)
        return self._rows(chosen if alarm_id is None else chosen.where(AUDIT.c.alarm_id == alarm_id))

    def rollups(self, axis: str, quantity: str, level: str, since: float = 0.0) -> list[Row]:
        """A quantity over the minutes, hours or days (`level`) that begin from a wall time on."""
        c = ROLLUP.c
        mine = (c.axis == axis) & (c.quantity == quantity) & (c.level == level) & (c.start_wall >= since)
        return self._rows(select(ROLLUP).where(mine).order_by(c.start_wall))

    def checkpoint(self, axis: str) -> Checkpoint | None:
        """The last state of an axis; None where there is none. Raises InputError where it is damaged."""
        for row in self._rows(select(CHECKPOINT).where(CHECKPOINT.c.axis == axis)):
            arrays = unpacked(row.pop("body"), row.pop("sha256"), self.where)
            return Checkpoint(**row, arrays=arrays)
        return None

    def journal(self, axis: str, after: int = 0, most: int | None = None) -> list[tuple[int, bytes]]:
        """Blocks (id, payload) that came after an axis's checkpoint and after a row, in their order."""
        c = JOURNAL.c
        mine = select(c.id, c.payload).where(c.axis == axis, c.id > after)
        return [(row["id"], row["payload"]) for row in self._rows(mine.order_by(c.id).limit(most))]

    def journal_bytes(self, axis: str) -> int:
        """Bytes of the blocks that came after an axis's checkpoint."""
        size = func.sum(func.length(JOURNAL.c.payload))
        return int(self._value(select(size).where(JOURNAL.c.axis == axis)) or 0)

    def journal_rows(self) -> int:
        """Blocks of all axes that came after their checkpoints."""
        return int(self._value(select(func.count()).select_from(JOURNAL)))

    def meta(self, key: str) -> str | None:
        """A word about the store itself."""
        return self._value(select(META.c.value).where(META.c.key == key))

    def outbox(self, limit: int, target: str) -> list[OutboxMessage]:
        """The oldest messages for a target that did not arrive yet, in their order."""
        c = OUTBOX.c
        waiting = select(c.id, c.kind, c.body, c.attempts).where(~c.done, c.target == target)
        return [OutboxMessage(**row) for row in self._rows(waiting.order_by(c.id).limit(limit))]

    def settle(self, id: int, *, done: bool, why: str = "") -> None:
        """Count an attempt at a message: it arrived, did not yet, or (`why`, put on record) never will."""
        counted = sa.update(OUTBOX).where(OUTBOX.c.id == id)
        with self.transaction() as t:
            t.execute(counted.values(attempts=OUTBOX.c.attempts + 1, done=done))
            if why:
                t.audit(time.time(), ITSELF, "GIVEN_UP", note=why, body={"outbox": id})

    def compact(
        self, now: float, minutes: int = 30, hours: int = 730, findings: int | None = None
    ) -> dict[str, int]:
        """Forget what is old now (Unix seconds), and give its room on the disk back; how many rows of each.

        Minutes, hours and findings are kept for so many days (None: for ever), days, alarms and audit stay.
        """
        c = ROLLUP.c
        old = {
            "minutes": delete(ROLLUP).where(c.level == "minute", c.start_wall < now - minutes * DAY_S),
            "hours": delete(ROLLUP).where(c.level == "hour", c.start_wall < now - hours * DAY_S),
            "outbox": delete(OUTBOX).where(OUTBOX.c.done),
        }
        if findings is not None:
            old["findings"] = delete(FINDING).where(FINDING.c.wall < now - findings * DAY_S)
        with self.transaction() as t:
            gone = {name: t.execute(rows) for name, rows in old.items()}
        if self._engine.dialect.name == "sqlite":
            with told(self.where), self._engine.connect() as connection:
                driver: Any = connection.connection.driver_connection
                # As a script: it gives one page back at a step, and the driver else takes the first alone.
                driver.executescript("PRAGMA incremental_vacuum; PRAGMA wal_checkpoint(TRUNCATE)")
        return gone
