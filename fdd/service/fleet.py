"""All axes of one process: blocks in, findings and alarms stored and told, state kept."""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TooLate
from dataclasses import replace
from functools import partial
from typing import Any

from fdd.bounds import MOST_AXES
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.samples import Samples
from fdd.service import storing
from fdd.service.alarms import ITSELF, Action, AlarmBook, Transition
from fdd.service.axis import AxisWatch, Look
from fdd.service.backlog import Backlog
from fdd.service.blocks import Block, Decoder, encode_arrow
from fdd.service.bus import Bus, Event
from fdd.service.inbox import MOST_TAKEN, Inbox
from fdd.service.life import profile_key, said_key, worked_key
from fdd.service.profiles import Profiles
from fdd.service.status import AxisDetail, AxisStatus, status_of
from fdd.service.store import LeaseLost, Store, StoreTrouble, Transaction
from fdd.service.storing import Batch, Targets, Writer

LOG = logging.getLogger("fdd.service")

SILENT_S = 3.0
"""Without data of an axis, after which its reorder buffer is flushed. Only time counts in which the fleet had
nothing to do, and of a step no more than it should take: a sender that waits for this process, or for the
machine, is not silent. A lost segment of TCP, or a new connection to a broker, takes one or two seconds."""
CHECKPOINT_S, CHECKPOINT_AXIS_S = 1.0, 0.4
"""Least time between two checkpoints of an axis, and for each axis that there is: one takes some 20 ms, which
is 5 % of the processor's time. No block is lost for it: the journal holds what came since."""
PACE_S = 0.1
"""Blocks are gathered for so long: what they bring is stored at once."""
FORGOTTEN_S = 60.0
"""Silence after which an axis goes that was refused, or sent less than its units can be checked by."""
PORTION = 64
"""Stored blocks that are worked between two steps: some hundredths of a second."""
MOST_REFUSED, MOST_TOLD = 100, 3
"""Names of refused axes that are known, as strangers may give any number, and that health tells."""
ACT_S = 10.0
"""Seconds that somebody waits for what he did to be stored."""


class Fleet:
    """Watch the axes whose blocks come into an inbox.

    What a batch of blocks brought is stored in one transaction together with the blocks themselves; only then
    are they accepted and anything told. After a restart an axis goes on from its checkpoint, and works again
    what the journal has since; nothing of that is told twice.

    Parameters
    ----------
    profiles : of the axes.
    hold, learn_s : s, see `AxisWatch`. clock : Unix seconds. has : whether an axis is its own.
    ids : see `AlarmBook`.
    zone : of all axes' clock times, or of each; see `AxisStatus`.

    Attributes
    ----------
    writer : to its store, with what is wrong with it. backlog : axes that are put off under overload.
    resumed : share of the journal that was worked again after a restart, 1 once it is done.
    """

    def __init__(
        self,
        profiles: Profiles,
        model: Model,
        store: Store,
        bus: Bus,
        inbox: Inbox,
        *,
        targets: Targets = {},  # noqa: B006 (nobody changes it)
        hold: float = 0.5,
        learn_s: float = 3600.0,
        clock: Callable[[], float] = time.time,
        has: Callable[[str], bool] = lambda axis: True,
        ids: tuple[int, int] = (1, 1),
        zone: str | Mapping[str, str] | None = None,
        backlog: Backlog | None = None,
    ) -> None:
        self._profiles, self._model, self._zone = profiles, model, zone
        self._store, self._bus, self._inbox, self._targets = store, bus, inbox, targets
        self._hold, self._learn_s, self._clock = hold, learn_s, clock
        self._has, self._book = has, AlarmBook(ids=ids)
        self._axes: dict[str, AxisWatch] = {}
        self._refused: dict[str, AxisStatus] = {}
        self._idle_s, self._ended, self._heard = 0.0, time.monotonic(), dict[str, float]()
        self._asked: queue.Queue[tuple[Callable[[Batch], Any], Future[Any]]] = queue.Queue()
        self._lock = threading.RLock()
        self._profiles_kept: set[str] = set()
        self._decoder = Decoder()
        self.writer, self.resumed, self.backlog = Writer(store), 0.0, backlog or Backlog()

    def run(self, stop: threading.Event) -> None:
        """Work until `stop` is set; state is kept at the end."""
        while not stop.is_set():
            try:
                self.resume()
                break
            except LeaseLost:
                raise
            except StoreTrouble as error:
                self.writer.failed(error)
                stop.wait(storing.BACKOFF_S[1])
        if self.resumed < 1.0:
            return
        while not stop.is_set():
            taken = self.step(PACE_S, stop)
            more_waits = taken == MOST_TAKEN
            if more_waits and not self.backlog.is_full:
                continue
            if not self.catch_up(stop, idle=not taken) and not more_waits:
                stop.wait(PACE_S)
        # A step that was given up has changed states and is not stored: kept, its alarms would count as told.
        if self.writer.trouble is None:
            self.keep(stop)

    def resume(self) -> None:
        """Go on where the last run ended; meanwhile others may ask how things stand."""
        book = self._store.book()
        with self._lock:
            self._axes.clear()
            self.backlog.clear()
            self.writer.last_row.clear()
            self._refused.clear()
            self._book.restore({**book, "alarms": [a for a in book["alarms"] if self._has(a["axis"])]})
        waiting, worked = max(1, self._store.journal_rows()), 0
        for row in self._store.axes():
            name = row["name"]
            if not self._has(name):
                continue
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
                    watch.restore(checkpoint)
        except StoreTrouble:
            raise
        except InputError as error:
            note = str(error)
            watch = self._axes[watch.name] = self._new(watch.name, said)
        worked = self._store.meta(worked_key(watch.name))
        for number, payload in self._stored(watch.name):
            if worked is not None and number > int(worked):  # what it brings is still to be told
                self.backlog.put_off(watch.name, math.nan, self._store.journal_bytes(watch.name))
                break
            with self._lock:
                self.writer.last_row[watch.name] = number
                self._replay(watch, payload)
            yield
        else:
            if worked is not None:
                with self._store.transaction() as t:
                    t.forget(worked_key(watch.name))
        if note is not None:
            LOG.warning("%s", note)
            with self._store.transaction() as t:
                t.audit(self._clock(), ITSELF, "STATE_DISCARDED", axis=watch.name, note=note)

    def _stored(self, name: str, most: int | None = None) -> Iterator[tuple[int, bytes]]:
        """Blocks of an axis (row, payload) that are stored and not in its state, at most so many."""
        last, left = self.writer.last_row.get(name, 0), math.inf if most is None else most
        while left > 0 and (rows := self._store.journal(name, last, int(min(left, PORTION)))):
            yield from rows
            last, left = rows[-1][0], left - len(rows)

    def _replay(self, watch: AxisWatch, payload: bytes) -> list[Look]:
        wall = self._clock() - self._behind_s(watch)
        if not payload:
            return watch.settle(wall, flush=True)
        block = self._decoder.decode(payload, "journal", axis=watch.name)
        return watch.push(replace(block, received=wall))

    def _behind_s(self, watch: AxisWatch) -> float:
        """s of data that are stored and not worked yet, of an axis that is put off."""
        clock = watch.order.clock
        behind = self.backlog.newest.get(watch.name, math.nan) + clock.offset - clock.last_time
        return max(behind, 0.0) if math.isfinite(behind) else 0.0

    def _new(self, name: str, said: str | None) -> AxisWatch:
        def measured(samples: Samples) -> None:
            self._bus.publish(Event("samples", name, float(samples.time[-1]), {"samples": samples}))

        unit = self._profiles.find(name, said)
        return AxisWatch(name, unit, self._model, self._hold, self._learn_s, measured)

    def _opened(self, name: str, said: str | None) -> AxisWatch:
        watch = self._axes.get(name)
        if watch is None:
            if len(self._axes) >= MOST_AXES:
                mend = "remove one, or start another fdd serve for it"
                raise InputError(f"axis {name}: more than {MOST_AXES} axes", mend=mend)
            watch = self._axes[name] = self._new(name, said)
            self._refused.pop(name, None)
        return watch

    def step(self, timeout: float, stop: threading.Event | None = None) -> int:
        """Take what waits, at most some tenths of a second of work; how many blocks.

        Parameters
        ----------
        timeout : s to wait for the first one. stop : ends the waiting for a store that fails.
        """
        blocks = self._inbox.take(timeout)
        self._idle_s += min(time.monotonic() - self._ended, 2.0 * PACE_S)
        try:
            with self._lock:
                batch = self._worked(blocks)
            if not self.writer.write(batch, stop):
                return 0
            for block in blocks:
                block.accepted()
            self._tell(batch)
            return len(blocks)
        finally:
            self._ended = time.monotonic()

    def catch_up(self, stop: threading.Event | None = None, *, idle: bool = True) -> int:
        """Work stored blocks of an axis that is put off, where there is time; how many.

        Parameters
        ----------
        idle : nothing else waits. stop : see `step`.
        """
        with self._lock:
            name = self.backlog.next(len(self._axes) - len(self.backlog.newest), idle=idle)
            if name is None:
                return 0
            watch, batch = self._axes[name], Batch(self._targets, self._clock())
            try:
                rows = list(self._stored(name, PORTION))
            except StoreTrouble as error:
                self.writer.failed(error)
                return 0
            for _, payload in rows:
                wall = self._clock() - self._behind_s(watch)
                self._looked(watch, self._replay(watch, payload), wall, batch)
            last = rows[-1][0] if rows else self.writer.last_row.get(name, 0)
            self.writer.last_row[name] = last
            if len(rows) < PORTION:
                LOG.debug("axis %s is followed again", name)
                self.backlog.followed_again(name)
                batch.writes.append(lambda t: t.forget(worked_key(name)))
            else:
                self.backlog.worked(name, sum(len(payload) for _, payload in rows))
                batch.writes.append(lambda t: t.meta(worked_key(name), str(last)))
        if self.writer.write(batch, stop):
            self._tell(batch)
        return len(rows)

    def _put_off(self, batch: Batch) -> None:
        """Under overload follow fewer axes: those with an alarm first, then those that came first."""
        followed = [name for name in self._axes if name not in self.backlog.newest]
        followed.sort(key=lambda name: not self._book.alarms(name))
        names = self.backlog.turn(time.monotonic(), self._idle_s, followed)
        if names:
            LOG.warning("overloaded: put off are %s", _some(names))
        for name in names:
            self.backlog.put_off(name, math.nan, 0)

        def write(t: Transaction) -> None:
            # The row's number is known only now that this step's blocks are in the journal.
            for name in names:
                t.meta(worked_key(name), str(self.writer.last_row.get(name, 0)))

        if names:
            batch.writes.append(write)

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
        # Checkpoints of the axes whose turn it is, as many as their share of the time allows.
        self._put_off(batch)
        now, rows = time.monotonic(), self.writer.last_row
        every = max(CHECKPOINT_S, CHECKPOINT_AXIS_S * len(self._axes))
        due = [
            w for w in self._axes.values()
            if now - w.kept >= every and w.name in rows and not w.waits and not w.is_new
            and w.name not in self.backlog.newest
        ]  # fmt: skip
        for watch in sorted(due, key=lambda w: w.kept)[: 1 + len(self._axes) // 50]:
            watch.kept = now
            self._keep(watch, batch)
        return batch

    def _tell(self, batch: Batch) -> None:
        for future, answer in batch.answers:
            future.set_result(answer)
        for event in batch.events:
            self._bus.publish(event)

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
        self.backlog.took(sum(block.seconds for block in blocks), followed=name not in self.backlog.newest)
        if name in self.backlog.newest:
            batch.put_off.add(name)
            newest = max((b.samples.time[-1] for b in blocks if len(b.samples)), default=math.nan)
            self.backlog.put_off(name, float(newest), sum(len(payload) for _, payload in stored))
            return
        looks = watch.push(*blocks)
        wall = blocks[-1].received
        if not known:
            known_of = self._about(watch)
            batch.writes += [
                lambda t: t.axis(name, wall, **known_of),
                lambda t: t.meta(said_key(name), blocks[0].unit or ""),
            ]
            about = {"unit": watch.unit.name, "learning": bool(watch.learning)}
            batch.events.append(Event("axis", name, 0.0, about))
        self._looked(watch, looks, wall, batch)

    def _about(self, watch: AxisWatch) -> dict[str, str]:
        """What the store keeps of an axis."""
        shas = {"profile_sha256": watch.profile_sha256, "model_sha256": self._model.sha256}
        return {"unit": watch.unit.name, **shas}

    def _refuse(self, name: str, why: str, samples: int = 0) -> None:
        """Note an axis that sends and cannot be watched."""
        if name not in self._refused:
            LOG.warning("%s", why)
            self._refused[name] = AxisStatus(
                name=name, unit="", state="failed", headline=why, quality={"refused": 0}
            )
        status = self._refused[name]
        status.headline = why
        status.quality["refused"] += samples
        while len(self._refused) > MOST_REFUSED:
            oldest = next(iter(self._refused))
            del self._refused[oldest]
            self._heard.pop(oldest, None)

    def _forget_strangers(self, newcomers: int, batch: Batch) -> None:
        """Let go who sent next to nothing and is silent; at once, where others want the place."""
        # One that the store has and that was not heard since stays.
        for name in [n for n in self._refused if self._idle_s - self._heard.get(n, math.inf) > FORGOTTEN_S]:
            del self._refused[name], self._heard[name]
        new = [
            (self._heard.get(n, self._idle_s), n)
            for n, w in self._axes.items()
            if w.is_new and n not in self.backlog.newest
        ]
        crowded = len(self._axes) + newcomers - MOST_AXES
        for k, (heard, name) in enumerate(sorted(new)):
            if k < crowded or self._idle_s - heard > FORGOTTEN_S:
                LOG.info("axis %s is forgotten: it sent less than 5 s of data", name)
                self._forget(name, ITSELF, batch)

    def _forget(self, name: str, who: str, batch: Batch) -> None:
        """Watch an axis no longer: its state and its life go, its alarms and the audit stay."""
        kept: tuple[dict[str, Any], ...] = (self._axes, self._refused, self._heard, self.writer.last_row)
        for part in kept:
            part.pop(name, None)
        self._inbox.forget(name)
        self.backlog.followed_again(name)
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

    def _keep(self, watch: AxisWatch, batch: Batch) -> None:
        wall, parts = self._clock(), watch.rollups
        watch.rollups = []
        held = watch.checkpoint(wall)
        profile = None if watch.profile_sha256 in self._profiles_kept else watch.unit.to_yaml()
        self._profiles_kept.add(watch.profile_sha256)

        def write(t: Transaction) -> None:
            # The row's number is known only now that the blocks are in the journal.
            t.checkpoint(replace(held, sequence=self.writer.last_row[watch.name]))
            t.rollup(*parts)
            if profile is not None:
                t.meta(profile_key(watch.profile_sha256), profile)
            t.axis(watch.name, watch.last_wall or wall, last_time=held.time, **self._about(watch))

        batch.writes.append(write)

    def keep(self, stop: threading.Event | None = None) -> None:
        """Work what waits, and keep all axes' states now; what is held for a block before it stays held."""
        with self._lock:
            batch = Batch(self._targets, self._clock())
            for watch in self._axes.values():
                wall = self._clock()
                self._looked(watch, watch.settle(wall), wall, batch)
                if watch.name in self.writer.last_row and not watch.is_new:  # else the journal has it all
                    self._keep(watch, batch)
        if self.writer.write(batch, stop):
            self._tell(batch)

    def problems(self) -> list[str]:
        """What hinders it, a line each; answered at once, whatever it does."""
        found = [] if self.writer.trouble is None else [f"the store cannot be written: {self.writer.trouble}"]
        if self.resumed < 1.0:
            found.append(f"resuming, {100 * self.resumed:.0f} %")
        refused = [status.headline for status in list(self._refused.values())[:MOST_TOLD]]
        return found + refused + self._inbox.problems() + self._overloaded()

    def _overloaded(self) -> list[str]:
        with self._lock:
            off = [self._axes[name] for name in self.backlog.newest]
            behind = max(map(self._behind_s, off), default=0.0)
            followed = f"{len(self._axes) - len(off)} of {len(self._axes)} axes are followed"
        if not off:
            return []
        late = f"the others are stored and worked later, {behind:.0f} s behind"
        return [f"overloaded: {followed}, {late}: {_some([watch.name for watch in off])}"]

    @property
    def count(self) -> int:
        """Axes that are watched or refused."""
        return len(self._axes) + len(self._refused)

    def axes(self) -> list[AxisStatus]:
        """How every axis stands."""
        with self._lock:
            return [*map(self._status, self._axes.values()), *self._refused.values()]

    def _status(self, watch: AxisWatch) -> AxisStatus:
        zone = self._zone.get(watch.name) if isinstance(self._zone, Mapping) else self._zone
        counters = self._inbox.counters(watch.name)
        if watch.name in self.backlog.newest:
            counters["lag_s"] += self._behind_s(watch)
            counters["put_off"] = 1.0
        return status_of(watch, self._book.alarms(watch.name), counters, self._clock(), zone)

    def profile_of(self, name: str) -> str | None:
        """An axis's profile as YAML; None where there is no such axis."""
        with self._lock:
            watch = self._axes.get(name)
            return None if watch is None else watch.unit.to_yaml()

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
            transition = self._book.act(action, self._clock())
            batch.moved([transition])
            return transition

        done: Transition = self._ask(work)
        return done

    def remove(self, axis: str, who: str) -> None:
        """Watch an axis no longer, and forget its life; if it sends again it begins anew.

        Raises KeyError: no such axis. StoreTrouble: it could not be stored in time.
        """

        def work(batch: Batch) -> None:
            if axis not in self._axes and axis not in self._refused:
                raise KeyError(axis)
            self._forget(axis, who, batch)

        self._ask(work)

    def _ask(self, work: Callable[[Batch], Any]) -> Any:
        """Let the fleet's thread do something, and wait until it is stored."""
        future: Future[Any] = Future()
        self._asked.put((work, future))
        try:
            return future.result(ACT_S)
        except TooLate:
            future.cancel()
            problem = f"not stored within {ACT_S:g} s: the store is away, or the service is busy"
            raise StoreTrouble(problem, mend="try again") from None


def _some(names: Sequence[str]) -> str:
    """The first names of a list, and how many more."""
    more = f" and {len(names) - MOST_TOLD} more" if len(names) > MOST_TOLD else ""
    return ", ".join(names[:MOST_TOLD]) + more
