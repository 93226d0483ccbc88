"""All axes of one process: blocks in, findings and alarms stored and told, state kept."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TooLate
from functools import partial
from queue import SimpleQueue
from typing import Any, TypeVar

from fdd.bounds import MOST_AXES
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.service import storing
from fdd.service.alarms import ITSELF, Action, AlarmBook, Transition
from fdd.service.axis import AxisWatch, Look
from fdd.service.blocks import Block, encode_arrow
from fdd.service.config import Serve, profile_of
from fdd.service.queues import MOST_TAKEN, Bus, Event, Inbox
from fdd.service.status import AxisDetail, AxisStatus, status_of
from fdd.service.store import Store, StoreTrouble, Transaction, said_key, worked_key
from fdd.service.storing import Backlog, Batch, Targets, Writer

LOG = logging.getLogger("fdd.service")
T = TypeVar("T")
SILENT_S = 3.0
"""Without data of an axis, after which its reorder buffer is flushed. Only time counts in which the fleet had
nothing to do, and of a step no more than it should take: a sender that waits for this process, or for the
machine, is not silent. A lost segment of TCP, or a new connection to a broker, takes one or two seconds."""
PACE_S = 0.1
"""Blocks are gathered for so long: what they bring is stored at once."""
FORGOTTEN_S = 60.0
"""Silence after which an axis goes that was refused, or sent less than its units can be checked by."""
MOST_REFUSED, MOST_TOLD = 100, 3
"""Names of refused axes that are known, as strangers may give any number, and that health tells."""
ACT_S = 10.0
"""Seconds that somebody waits for what he did to be stored."""


class Fleet:
    """Watch the axes whose blocks come into an inbox.

    What a batch of blocks brought is stored in one transaction together with the blocks themselves; only then
    are they accepted and anything told. After a restart an axis goes on from its checkpoint, and works again
    what the journal has since; nothing of that is told twice.
    `resumed` is the share of the journal that was worked again after a restart, 1 once it is done.
    Raises InputError: a model that cannot be used.
    """

    def __init__(
        self, config: Serve, store: Store, bus: Bus, targets: Targets | None = None,
        clock: Callable[[], float] = time.time,
    ) -> None:  # fmt: skip
        self._config, self._store, self._bus, self._targets = config, store, bus, targets or {}
        self._clock = clock
        self._model = Model.load(config.model)
        self.inbox = Inbox(config.limits.inbox_seconds, config.limits.inbox_bytes)
        self._book = AlarmBook()
        self._axes: dict[str, AxisWatch] = {}
        # Axes that send and cannot be watched: why, and how much of theirs was refused.
        self._refused: dict[str, AxisStatus] = {}
        self._idle_s, self._ended, self._heard = 0.0, time.monotonic(), dict[str, float]()
        # What other threads let this one do.
        self._asked = SimpleQueue[tuple[Callable[[Batch], Any], Future[Any]]]()
        self._lock = threading.RLock()
        self.writer, self.resumed = Writer(store), 0.0
        self.backlog = Backlog(store, self.writer, clock, config.limits.backlog_bytes)

    def run(self, stop: threading.Event) -> None:
        """Work until `stop` is set; state is kept at the end."""
        while not stop.is_set():
            try:
                self.resume()
                break
            except StoreTrouble as error:
                self.writer.failed(error)
                stop.wait(storing.BACKOFF_S[1])
        if self.resumed < 1.0:
            return
        caught_up = 0
        while not stop.is_set():
            began, taken = time.monotonic(), self.step(0.0 if caught_up else PACE_S, stop)
            # A step that took longer than its blocks took to come has no time for others.
            quick = not taken or (taken < MOST_TAKEN and time.monotonic() - began < PACE_S)
            caught_up = self.catch_up(stop, idle=not taken) if quick or self.backlog.is_full else 0
            if taken < MOST_TAKEN and not caught_up:  # what came during a long step has gathered
                stop.wait(max(0.0, PACE_S - (time.monotonic() - began)))
        # A step that was given up has changed states and is not stored: kept, its alarms would count as told.
        if self.writer.trouble is None:
            self.keep(stop)

    def resume(self) -> None:
        """Go on where the last run ended; meanwhile others may ask how things stand."""
        book = self._store.book()
        with self._lock:
            for known in (self._axes, self._refused, self.writer.last_row):
                known.clear()
            for name in [*self.backlog.newest]:
                self.backlog.follow_again(name)
            self._book.restore(book)
        waiting, worked = max(1, self._store.journal_rows()), 0
        for row in self._store.axes():
            name = row["name"]
            # As its blocks say it, which is a file's name; the profile's own name may be another one.
            said = self._store.meta(said_key(name))
            said = row["unit"] if said is None else said or None
            try:
                with self._lock:
                    watch = self._opened(name, said)
            except InputError as error:
                self._refuse(name, str(error))
                continue
            for _ in self._restored(watch, said):
                worked += 1
                self.resumed = min(worked / waiting, 0.99)
                if worked % 20 == 0:
                    time.sleep(0.001)  # a lock is not fair: let those in who ask
        self.resumed, self.writer.trouble = 1.0, None
        LOG.info("watching %d %s again", len(self._axes), "axis" if len(self._axes) == 1 else "axes")

    def _restored(self, watch: AxisWatch, said: str | None) -> Iterator[None]:
        """Bring an axis to where the store has it; a step for each row of the journal."""
        note = None
        try:
            checkpoint = self._store.checkpoint(watch.name)
            if checkpoint is not None:
                with self._lock:
                    watch.go_on(checkpoint)
        except StoreTrouble:
            raise
        except InputError as error:
            note = str(error)
            watch = self._axes[watch.name] = self._new(watch.name, said)
        replayed = self.backlog.replayed(watch)
        while True:
            with self._lock:
                if next(replayed, None) is None:
                    break
            yield
        if note is not None:
            LOG.warning("%s", note)
            with self._store.transaction() as t:
                t.audit(self._clock(), ITSELF, "STATE_DISCARDED", axis=watch.name, note=note)

    def _new(self, name: str, said: str | None) -> AxisWatch:
        unit = profile_of(self._config, name, said)
        hold, learn_s = self._config.limits.hold, 60.0 * self._config.learn_minutes
        return AxisWatch(name, unit, self._model, hold, learn_s, self._bus)

    def _opened(self, name: str, said: str | None) -> AxisWatch:
        if name not in self._axes:
            if len(self._axes) >= MOST_AXES:
                mend = "remove one, or start another fdd serve for it"
                raise InputError(f"axis {name}: more than {MOST_AXES} axes", mend=mend)
            self._axes[name] = self._new(name, said)
            self._refused.pop(name, None)
        return self._axes[name]

    def step(self, timeout: float, stop: threading.Event | None = None) -> int:
        """Take what waits, at most some tenths of a second of work; how many blocks.

        `timeout`: s to wait for the first one. `stop` ends the waiting for a store that fails.
        """
        blocks = self.inbox.take(timeout)
        self._idle_s += min(time.monotonic() - self._ended, 2.0 * PACE_S)
        try:
            with self._lock:
                batch = self._worked(blocks)
            return len(blocks) if self._stored(batch, stop, blocks) else 0
        finally:
            self._ended = time.monotonic()

    def catch_up(self, stop: threading.Event | None = None, *, idle: bool = True) -> int:
        """Work stored blocks of an axis that is put off, where there is time; how many."""
        with self._lock:
            name = self.backlog.next(idle=idle)
            if name is None:
                return 0
            watch, batch = self._axes[name], Batch(self._targets, self._clock())
            try:
                payloads, note = self.backlog.portion(watch)
            except StoreTrouble as error:
                self.writer.failed(error)
                return 0
            for payload in payloads:
                wall = self._clock() - self.backlog.behind_s(watch)
                self._looked(watch, self.backlog.work(watch, payload), wall, batch)
            batch.writes.append(note)
        self._stored(batch, stop)
        return len(payloads)

    def _worked(self, blocks: list[Block]) -> Batch:
        batch = Batch(self._targets, self._clock())
        by_axis: dict[str, list[Block]] = {}
        for block in blocks:
            by_axis.setdefault(block.axis, []).append(block)
        self._forget_strangers(len(by_axis.keys() - self._axes.keys()), batch)
        for name, mine in by_axis.items():
            self._work(name, mine, batch)
        self._flush_silent(set(by_axis), batch)
        while not self._asked.empty():
            work, future = self._asked.get()
            if future.set_running_or_notify_cancel():  # else nobody waits for it any more
                try:
                    batch.answers.append((future, work(batch)))
                except (InputError, KeyError) as error:
                    future.set_exception(error)
        batch.moved(self._book.tick(self._clock()))
        now = time.monotonic()
        if self.backlog.is_due(now):  # those with an alarm are followed first, then those that came first
            alarmed = {alarm.axis for alarm in self._book.alarms()}
            followed = [name for name in self._axes if name not in self.backlog.newest]
            followed.sort(key=lambda name: name not in alarmed)
            if names := self.backlog.turn(now, self._idle_s, self.inbox.waiting_s, followed):
                LOG.warning("overloaded: %d of %d axes are put off", len(names), len(followed))
                batch.writes.append(self.backlog.put_off(names))
        for watch in self.writer.due(self._axes.values(), self.backlog.newest, now):
            watch.kept = now
            self.writer.keep(watch, batch)
        return batch

    def _stored(self, batch: Batch, stop: threading.Event | None, blocks: Sequence[Block] = ()) -> bool:
        """Store a batch; only then its blocks are accepted, and anything is told."""
        if not self.writer.write(batch, stop):
            return False
        for block in blocks:
            block.accepted()
        for future, answer in batch.answers:
            future.set_result(answer)
        for event in batch.events:
            self._bus.publish(event)
        return True

    def _work(self, name: str, blocks: list[Block], batch: Batch) -> None:
        known = name in self._axes
        try:
            watch = self._opened(name, blocks[0].unit)
        except InputError as error:
            self._refuse(name, str(error), sum(len(block.samples) for block in blocks))
            self._heard[name] = self._idle_s
            return
        watch.flushed = False
        stored = [(name, block.payload or encode_arrow(block)) for block in blocks]
        batch.journal += stored
        if name in self.backlog.newest:
            batch.put_off.add(name)
            newest = max(float(block.samples.time[-1]) for block in blocks)
            self.backlog.stored(name, newest, sum(len(payload) for _, payload in stored))
            return
        looks = watch.push(*blocks)
        wall = blocks[-1].received
        if not known:
            known_of = watch.about()
            batch.writes += [
                lambda t: t.axis(name, wall, **known_of),
                lambda t: t.meta(said_key(name), blocks[0].unit or ""),
            ]
            about = {"unit": watch.unit.name, "learning": bool(watch.learning)}
            batch.events.append(Event("axis", name, 0.0, about))
        self._looked(watch, looks, wall, batch)

    def _refuse(self, name: str, why: str, samples: int = 0) -> None:
        """Count samples that are refused, and why."""
        if name not in self._refused:
            LOG.warning("%s", why)
            self._refused[name] = AxisStatus(name=name, unit="", state="failed", headline=why)
        told = self._refused[name]
        told.headline, told.quality = why, {"refused": told.quality.get("refused", 0) + samples}
        for oldest in [*self._refused][: max(0, len(self._refused) - MOST_REFUSED)]:
            del self._refused[oldest]
            self._heard.pop(oldest, None)

    def _forget_strangers(self, newcomers: int, batch: Batch) -> None:
        """Let go who sent next to nothing and is silent; at once, where others want the place."""
        # One that the store has and that was not heard since stays.
        for name in [n for n in self._refused if self._idle_s - self._heard.get(n, math.inf) > FORGOTTEN_S]:
            del self._refused[name], self._heard[name]
        new = [n for n, watch in self._axes.items() if watch.is_new and n not in self.backlog.newest]
        heard = {n: self._heard.get(n, self._idle_s) for n in new}
        crowded = len(self._axes) + newcomers - MOST_AXES
        for k, name in enumerate(sorted(new, key=lambda n: (heard[n], n))):
            if k < crowded or self._idle_s - heard[name] > FORGOTTEN_S:
                LOG.info("axis %s is forgotten: it sent less than 5 s of data", name)
                self._forget(name, ITSELF, batch)

    def _forget(self, name: str, who: str, batch: Batch) -> None:
        """Watch an axis no longer: its state and its life go, its alarms and the audit stay."""
        for kept in (self._axes, self._refused, self._heard, self.writer.last_row):
            kept.pop(name, None)
        self.inbox.forget(name)
        self.backlog.follow_again(name)
        wall = self._clock()
        batch.moved(self._book.remove(name, who, wall))
        batch.writes += [
            partial(Transaction.remove_axis, name=name, words=(said_key(name), worked_key(name))),
            partial(Transaction.audit, wall=wall, who=who, action="AXIS_REMOVED", axis=name),
        ]
        batch.events += [Event("axis", name, 0.0, {"removed": True}), Event("status", name, 0.0, {})]

    def _flush_silent(self, busy: set[str], batch: Batch) -> None:
        """End the waiting of axes that have fallen silent; the journal has it as an empty block."""
        for name, watch in self._axes.items():
            if name in busy:
                self._heard[name] = self._idle_s
            silent = self._idle_s - self._heard.setdefault(name, self._idle_s) > SILENT_S
            if silent and not watch.flushed and name not in self.backlog.newest:
                watch.flushed = True
                wall = self._clock()
                if watch.order.held_samples or watch.waits:
                    batch.journal.append((name, b""))
                    self._looked(watch, watch.settle(wall, flush=True), wall, batch)

    def _looked(self, watch: AxisWatch, looks: list[Look], wall: float, batch: Batch) -> None:
        name = watch.name
        for look in looks:
            for finding in look.fresh:
                found = partial(Transaction.found, axis=name, time=look.time, wall=wall, finding=finding)
                batch.writes.append(found)
                body = finding.model_dump(mode="json") | {"axis": name, "time": look.time, "wall": wall}
                batch.told("finding", name, look.time, body)
            batch.moved(self._book.update(name, look.time, wall, look.standing))
        if looks:
            if mine := self._book.alarms(name):  # when each was seen last counts after a restart too
                batch.writes.append(lambda t: t.alarm(*mine))
            status = self._status(watch).model_dump(mode="json")
            batch.events.append(Event("status", name, looks[-1].time, status))

    def keep(self, stop: threading.Event | None = None) -> None:
        """Work what waits, and keep all axes' states now; what is held for a block before it stays held."""
        with self._lock:
            batch = Batch(self._targets, self._clock())
            for watch in self._axes.values():
                wall = self._clock()
                self._looked(watch, watch.settle(wall), wall, batch)
                if self.writer.may_keep(watch):
                    self.writer.keep(watch, batch)
        self._stored(batch, stop)

    def problems(self) -> list[str]:
        """What hinders it, a line each; answered at once, whatever it does."""
        found = [] if self.writer.trouble is None else [f"the store cannot be written: {self.writer.trouble}"]
        if self.resumed < 1.0:
            found.append(f"resuming, {100 * self.resumed:.0f} %")
        off = [watch for name in list(self.backlog.newest) if (watch := self._axes.get(name)) is not None]
        behind = self.backlog.problems(len(self._axes) - len(off), off)
        refused = [status.headline for status in list(self._refused.values())[:MOST_TOLD]]
        return found + refused + self.inbox.problems() + behind

    @property
    def count(self) -> int:
        """Axes that are watched or refused."""
        return len(self._axes) + len(self._refused)

    def axes(self) -> list[AxisStatus]:
        """How every axis stands."""
        with self._lock:
            return [*map(self._status, self._axes.values()), *self._refused.values()]

    def _status(self, watch: AxisWatch) -> AxisStatus:
        zone = self._config.zone
        zone = zone.get(watch.name) if isinstance(zone, dict) else zone
        counters = self.inbox.counters(watch.name)
        if watch.name in self.backlog.newest:
            counters["lag_s"] += self.backlog.behind_s(watch)
            counters["put_off"] = 1.0
        return status_of(watch, self._book.alarms(watch.name), counters, self._clock(), zone)

    def axis(self, name: str) -> AxisDetail:
        """One axis with its last ten minutes. Raises KeyError: no such axis."""
        with self._lock:
            watch = self._axes[name]
            findings = self._book.findings(name)
            return AxisDetail(status=self._status(watch), findings=findings, **watch.recent.drawn())

    def act(self, action: Action) -> Transition:
        """Do something to an alarm, from any thread; stored when this returns.

        Raises InputError: the alarm's state does not allow it. StoreTrouble: it was not stored in time.
        """

        def work(batch: Batch) -> Transition:
            batch.moved([transition := self._book.act(action, self._clock())])
            return transition

        return self._ask(work)

    def remove(self, axis: str, who: str) -> None:
        """Watch an axis no longer, and forget its life; if it sends again it begins anew.

        Raises KeyError: no such axis. StoreTrouble: it could not be stored in time.
        """

        def work(batch: Batch) -> None:
            if axis not in self._axes.keys() | self._refused.keys():
                raise KeyError(axis)
            self._forget(axis, who, batch)

        self._ask(work)

    def _ask(self, work: Callable[[Batch], T]) -> T:
        """Let the fleet's thread do something, and wait until it is stored."""
        future: Future[T] = Future()
        self._asked.put((work, future))
        try:
            return future.result(ACT_S)
        except TooLate:
            future.cancel()
            problem = f"not stored within {ACT_S:g} s: the store is away, or the service is busy"
            raise StoreTrouble(problem, mend="try again") from None
