"""What is written at once: all of it, or nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from typing import Any

from sqlalchemy import Connection, Delete, Executable, Table, delete, func, insert, select, update
from sqlalchemy.dialects import postgresql, sqlite

from fdd.diagnosis.findings import FaultFinding
from fdd.service.alarms import Alarm, Transition, readable
from fdd.service.store.records import SPANS_S, Checkpoint, Rollup, packed
from fdd.service.store.schema import ALARM, AUDIT, AXIS, CHECKPOINT, FINDING, JOURNAL, META, OUTBOX, ROLLUP

Body = Mapping[str, Any]
_WRITTEN = "written"
_ACCEPT, _LAST = insert(JOURNAL), select(func.max(JOURNAL.c.id))


class Transaction:
    """An open transaction; `Store.transaction` makes it.

    Times are `time`, s of the stream's clock, and `wall`, Unix seconds.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def once(self, token: str) -> bool:
        """Whether this is still to be written: a try with the same token may have been, its answer lost."""
        last = self._connection.execute(select(META.c.value).where(META.c.key == _WRITTEN)).scalar()
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

    def remove_axis(self, name: str, said: str) -> None:
        """Take out an axis, its state, its life and a word; alarms, findings and the audit stay."""
        for table in (CHECKPOINT, JOURNAL, ROLLUP):
            self._connection.execute(delete(table).where(table.c.axis == name))
        self._connection.execute(delete(AXIS).where(AXIS.c.name == name))
        self._connection.execute(delete(META).where(META.c.key == said))

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
        for level in SPANS_S if parts else ():
            new = [part.over(level) for part in parts]
            sums: dict[tuple[str, str, float], Rollup] = {}
            for part in [*self._rollups(level, new), *new]:
                key = (part.axis, part.quantity, part.start_wall)
                sums[key] = sums[key].merged(part) if key in sums else part
            touched = {(part.axis, part.quantity, part.start_wall) for part in new}
            self._put(ROLLUP, [{"level": level, **asdict(sums[key])} for key in touched])

    def _rollups(self, level: str, parts: Sequence[Rollup]) -> list[Rollup]:
        """What is stored of the parts' axes, quantities and spans; few more than these parts."""
        c = ROLLUP.c
        fields = [column for column in c if column is not c.level]
        mine = [getattr(c, k).in_({getattr(p, k) for p in parts}) for k in ("axis", "quantity", "start_wall")]
        stored = self._connection.execute(select(*fields).where(c.level == level, *mine))
        return [Rollup(**row._mapping) for row in stored]

    def checkpoint(self, checkpoint: Checkpoint) -> None:
        """Keep an axis's state in place of the last one; the blocks that it holds leave the journal."""
        small, sha256 = packed(checkpoint.body)
        self._put(CHECKPOINT, [{**asdict(checkpoint), "body": small, "sha256": sha256}])
        held = (JOURNAL.c.axis == checkpoint.axis) & (JOURNAL.c.id <= checkpoint.sequence)
        self._connection.execute(delete(JOURNAL).where(held))

    def send(self, kind: str, body: Body, target: str, wall: float) -> int:
        """Put something that must arrive at a target into the outbox; its id."""
        return self._add(OUTBOX, kind=kind, body=body, target=target, attempts=0, next_wall=wall)

    def sent(self, id: int, **now: Any) -> None:
        """Note how a message of the outbox stands."""
        self._connection.execute(update(OUTBOX).where(OUTBOX.c.id == id).values(**now))

    def gone(self, old: Delete) -> int:
        """Delete rows; how many."""
        return int(self._connection.execute(old).rowcount)

    def meta(self, key: str, value: str) -> None:
        """Keep a word about the store itself."""
        self._put(META, [{"key": key, "value": value}])

    def metas(self, keys: Iterable[str]) -> dict[str, str]:
        """Words about the store itself, those that there are."""
        rows = self._connection.execute(select(META.c.key, META.c.value).where(META.c.key.in_(list(keys))))
        return {row.key: row.value for row in rows}

    def _add(self, table: Table, **row: Any) -> int:
        return int(self._connection.execute(insert(table).returning(table.c.id), row).scalar_one())

    def _put(self, table: Table, rows: Sequence[Body], keep: tuple[str, ...] = ()) -> None:
        """Insert rows, or update those that are there: all that is given but `keep`."""
        if rows:
            upsert = _upsert(table, self._connection.dialect.name, tuple(rows[0]), keep)
            self._connection.execute(upsert, list(rows))


# Building the statement takes five times as long as executing it.
@cache
def _upsert(table: Table, dialect: str, given: tuple[str, ...], keep: tuple[str, ...]) -> Executable:
    new = (sqlite.insert if dialect == "sqlite" else postgresql.insert)(table)
    keys = [c.name for c in table.primary_key]
    values = {k: new.excluded[k] for k in given if k not in {*keys, *keep}}
    return new.on_conflict_do_update(index_elements=keys, set_=values)
