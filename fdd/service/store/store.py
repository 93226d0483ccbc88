"""The store: one writer at a time, any number of readers, from any thread."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, delete, func, or_, select

from fdd.service.alarms import ITSELF
from fdd.service.store.database import BUSY_TIMEOUT_S, WRITES, LeaseLost, connect, told
from fdd.service.store.records import Checkpoint, unpacked
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
    prepare,
)
from fdd.service.store.transaction import Transaction

DAY_S = 86400.0
Row = dict[str, Any]


@dataclass(frozen=True)
class OutboxMessage:
    """What must arrive at a target."""

    id: int
    kind: str
    body: Mapping[str, Any]
    target: str
    attempts: int


class Store:
    """Open a store, and make its tables where there are none.

    Rows that it gives are dicts that JSON takes, with the columns' names; times are `time`, s of the stream's
    clock, and `wall`, Unix seconds. Whatever reads or writes raises `StoreTrouble` (locked, full, server
    away: try again, nothing was written) or `InputError` (damaged, read-only: somebody must mend it).

    Parameters
    ----------
    url : ``sqlite:///fdd.db`` or ``postgresql://user@host/database``.
    busy_timeout : s for which SQLite waits for another writer. existing : refuse to make one.
    leases : name to number, as another process has `claim`ed them: those under which this one writes.

    Attributes
    ----------
    leases : with them each transaction is refused (`LeaseLost`) once somebody else has claimed one.

    Raises
    ------
    InputError : wrong URL, damaged, of another fdd, of another program.
    """

    def __init__(
        self, url: str, busy_timeout: float = BUSY_TIMEOUT_S, existing: bool = False,
        leases: Mapping[str, str] | None = None,
    ) -> None:  # fmt: skip
        self.leases = dict(leases or {})
        self._engine, self.where = connect(url, busy_timeout, existing)
        prepare(self._engine, self.where, existing)

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()

    @contextmanager
    def transaction(self) -> Iterator[Transaction]:
        """Write: all of the block, on the disk when it ends, or nothing if it raises."""
        with (
            told(self.where),
            self._engine.connect().execution_options(**{WRITES: True}) as connection,
            connection.begin(),
        ):
            # Of writers one at a time: whoever claims a lease comes before this transaction, or after it.
            t = Transaction(connection)
            held = t.metas(self.leases) if self.leases else {}
            lost = next((name for name, number in self.leases.items() if held.get(name) != number), None)
            if lost is not None:
                raise LeaseLost(self.where, lost)
            yield t

    def claim(self, name: str) -> None:
        """Be from now on the only one who writes under a name; whoever was it before is refused.

        Raises LeaseLost: one of the leases that it has already is another's.
        """
        with self.transaction() as t:
            number = str(int(t.metas([name]).get(name, "0")) + 1)
            t.meta(name, number)
        self.leases[name] = number

    def _rows(self, statement: Select[Any]) -> list[Row]:
        with told(self.where), self._engine.connect() as connection:
            return [dict(row._mapping) for row in connection.execute(statement)]

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
        return next((r["body"] for r in self._rows(select(ALARM.c.body).where(ALARM.c.id == id))), None)

    def book(self) -> Row:
        """What `AlarmBook.restore` takes: alarms that are not over, each key's last one, and the next id."""
        c = ALARM.c
        last = select(func.max(c.id)).group_by(c.axis, c.key)
        kept = self._rows(select(c.id, c.body).where(or_(c.state != "NORMAL", c.id.in_(last))).order_by(c.id))
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
        found = self._rows(select(CHECKPOINT).where(CHECKPOINT.c.axis == axis))
        if not found:
            return None
        row = found[0]
        row["body"] = unpacked(row["body"], row.pop("sha256"), self.where)
        return Checkpoint(**row)

    def journal(self, axis: str) -> list[tuple[int, bytes]]:
        """Blocks (id, payload) that came after an axis's checkpoint, in their order."""
        c = JOURNAL.c
        rows = self._rows(select(c.id, c.payload).where(c.axis == axis).order_by(c.id))
        return [(row["id"], row["payload"]) for row in rows]

    def journal_rows(self) -> int:
        """Blocks of all axes that came after their checkpoints."""
        return int(self._rows(select(func.count().label("n")).select_from(JOURNAL))[0]["n"])

    def meta(self, key: str) -> str | None:
        """A word about the store itself."""
        return next((r["value"] for r in self._rows(select(META.c.value).where(META.c.key == key))), None)

    def outbox(self, limit: int, target: str) -> list[OutboxMessage]:
        """The oldest messages for a target that did not arrive yet, in their order."""
        c = OUTBOX.c
        waiting = (
            select(c.id, c.kind, c.body, c.target, c.attempts)
            .where(~c.done, c.target == target)
            .order_by(c.id)
            .limit(limit)
        )
        return [OutboxMessage(**row) for row in self._rows(waiting)]

    def delivered(self, id: int) -> None:
        """A message arrived."""
        with self.transaction() as t:
            t.sent(id, done=True)

    def put_off(self, id: int) -> None:
        """A message did not arrive: count the attempt."""
        with self.transaction() as t:
            t.sent(id, attempts=OUTBOX.c.attempts + 1)

    def give_up(self, id: int, note: str) -> None:
        """A message will never arrive: it is done with, and put on record."""
        with self.transaction() as t:
            t.sent(id, done=True)
            t.audit(time.time(), ITSELF, "GIVEN_UP", note=note, body={"outbox": id})

    def compact(
        self, now: float, minutes: float = 30 * DAY_S, hours: float = 730 * DAY_S,
        findings: float | None = None,
    ) -> dict[str, int]:  # fmt: skip
        """Forget what is old, and give its room on the disk back; how many rows of each went.

        Days are kept for ever, so are alarms and the audit.

        Parameters
        ----------
        now : Unix seconds. minutes, hours, findings : s for which each is kept; None is for ever.
        """
        c = ROLLUP.c
        old = {
            "minutes": delete(ROLLUP).where(c.level == "minute", c.start_wall < now - minutes),
            "hours": delete(ROLLUP).where(c.level == "hour", c.start_wall < now - hours),
            "outbox": delete(OUTBOX).where(OUTBOX.c.done),
        }
        if findings is not None:
            old["findings"] = delete(FINDING).where(FINDING.c.wall < now - findings)
        with self.transaction() as t:
            gone = {name: t.gone(rows) for name, rows in old.items()}
        if self._engine.dialect.name == "sqlite":
            with told(self.where), self._engine.connect() as connection:
                driver: Any = connection.connection.driver_connection
                # As a script: it gives one page back at a step, and the driver else takes the first alone.
                driver.executescript("PRAGMA incremental_vacuum; PRAGMA wal_checkpoint(TRUNCATE)")
        return gone
