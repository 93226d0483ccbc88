"""The fleet: what it says live is what the pipeline says of the whole, and nothing is lost or told twice."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from watched import RECEIVED, ROWS, blocks_of, disordered, fleet_of, leaking, made, passing, send, settle

from fdd.service.fleet import Fleet
from fdd.service.store import Store, StoreTrouble
from fdd.service.storing import Backlog
from tests.service.senders import until
from tests.service.servers import postgres_url

KILLS = int(os.environ.get("FDD_TEST_KILLS", "2"))


def told(store: Store) -> dict[str, list[Any]]:
    """What the store has that people are told, of each axis."""
    rows = [
        (f["axis"], [f[k] for k in ("time", "fault", "onset", "confidence", "severity")])
        for f in store.findings()
    ]
    rows += [(a["axis"], [a["action"], a["time"]]) for a in store.audit() if a["action"] != "STATE_DISCARDED"]
    rows += [(a["axis"], [a["fault"], a["state"]]) for a in store.alarms()]
    return {axis: [row for name, row in rows if name == axis] for axis in ("A1", "A2")}


@pytest.mark.parametrize("lags", [False, True])
def test_live_is_what_the_pipeline_says_of_the_whole(lags, store, log, whole):
    """Blocks that come twice, out of their order, or many at a time, change nothing."""
    blocks, rng = blocks_of(log), random.Random(1)
    for k in range(0, len(blocks) - 3, 7):
        blocks[k], blocks[k + 2] = blocks[k + 2], blocks[k]
    blocks = [b for block in blocks for b in [block] * (1 + (rng.random() < 0.1))]
    fleet = fleet_of(store)
    for block in blocks:
        fleet.inbox.put(block)
        if not lags:
            fleet.step(0.0)
    while fleet.step(0.0):
        pass
    fleet.keep()
    found = [(f["fault"], f["onset"], f["severity"], f["time"]) for f in store.findings()]
    assert found == [(f.fault, f.onset_s, f.severity, f.detected_s) for f in whole]
    (alarm,) = store.alarms()
    assert (alarm["state"], alarm["fault"]) == ("UNACK", "internal_leakage")
    (status,) = fleet.axes()
    assert status.samples == len(log) and status.state == "unacknowledged"
    assert "since 2023-11-14 22:13:49 UTC; no samples come since 2023-11-14 22:14:19" in status.headline
    assert status.silent and status.clock == pytest.approx(RECEIVED, abs=0.5)
    assert fleet.axis("A1").findings[0].detected_s == whole[0].detected_s, "not that of the last look"
    assert alarm["body"]["detected_s"] == whole[0].detected_s
    assert status.quality["repeated"] > 0 and status.quality["reordered"] > 0


@pytest.mark.slow
def test_an_axis_that_is_put_off_loses_nothing_and_tells_nothing_twice_over_restarts(store, log, monkeypatch):
    due = list[list[str]]()
    monkeypatch.setattr(Backlog, "is_due", lambda self, now: True)
    monkeypatch.setattr(Backlog, "turn", lambda self, *given: due.pop() if due else [])
    blocks = list(zip(blocks_of(log, "A1"), blocks_of(log, "A2"), strict=True))[:480]
    fleet = fleet_of(store)
    for n, pair in enumerate(blocks):
        due += [["A2"]] if n in (250, 380) else []
        send(fleet, list(pair))
        if n == 320:
            behind = fleet.axis("A2").status
            assert fleet.axis("A1").status.samples > behind.samples > 24_000
            assert behind.lag_s == pytest.approx(7.0, abs=1.0) and not behind.silent
            assert "overloaded: 7 s behind" in behind.headline
            assert "overloaded: 1 of 2 axes are followed" in fleet.problems()[0]
        if n == 350:
            assert store.checkpoint("A1") is not None and store.journal("A2"), "some is in the journal alone"
            fleet = fleet_of(store)
        if n in (350, 450):
            while fleet.catch_up():
                pass
            assert fleet.problems() == [] and store.meta("worked A2") is None
    fleet.keep()
    said = told(store)
    assert len(said["A1"]) == 3 and said["A1"] == said["A2"]
    assert [s.samples for s in fleet.axes()] == [48_000] * 2
    again = fleet_of(store)
    assert {s.state for s in again.axes()} == {"unacknowledged"} and told(store) == said


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_kill_at_any_instant_loses_nothing_and_tells_nothing_twice(kind, store, tmp_path):
    """While it starts, works, waits for a block before another one, is put off or catches up."""
    log = leaking(24.0, 8.0)
    np.savez(tmp_path / "log.npz", time=log.time, **log.columns)
    program = [sys.executable, str(Path(__file__).with_name("watched.py"))]
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}

    undisturbed = fleet_of(store)
    send(undisturbed, disordered(log))
    settle(undisturbed)
    whole = told(store)
    assert len(whole["A1"]) == 3 and whole["A1"] == whole["A2"]
    rng, kills, lives = random.Random(7), 0, 0
    while kills < KILLS:
        lives += 1
        url = f"sqlite:///{tmp_path}/{lives}.db" if kind == "sqlite" else postgres_url()
        accepted: dict[str, set[int]] = {"A1": set(), "A2": set()}
        lines, patience = [""], 2.0
        while lines[-1] != "done":
            given = [*program, url, str(tmp_path / "log.npz"), str(kills)]
            process = subprocess.Popen(given, stdout=subprocess.PIPE, text=True, env=env)
            starts = rng.random() < 0.2
            assert process.stdout is not None and (starts or process.stdout.readline() == "ready\n")
            timer = threading.Timer(rng.uniform(0.0, patience), process.send_signal, [signal.SIGKILL])
            patience *= 1.2  # a slow machine gets done too
            timer.start()
            whole_lines, _, _ = process.stdout.read().rpartition("\n")  # a kill may cut the last one
            lines = whole_lines.splitlines() or [""]
            process.wait()
            timer.cancel()
            kills += lines[-1] != "done"
            for axis, number in (x.split() for x in lines if x.startswith("A") and x[-1].isdigit()):
                accepted[axis].add(int(number))
            kept = Store(url)
            settle(fleet := fleet_of(kept))
            samples = {status.name: status.samples for status in fleet.axes()}
            for axis, blocks in accepted.items():
                first = next(k for k in count() if k not in blocks)  # those after it wait for this one
                assert samples.get(axis, 0) >= min(ROWS * first, len(log)), "what was accepted is there"
            kept.close()
        assert told(Store(url)) == whole


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_store_that_fails_or_loses_its_answer_is_tried_again(kind, log, tmp_path, monkeypatch):
    """A disk that is full; a server that ends, or a cable that is pulled, after it committed and before it
    said so. Meanwhile nothing is accepted."""
    plain, answered, sending = Store.transaction, list[int](), [0]

    @contextmanager
    def failing(self: Store):
        number = next(tries)
        assert len(answered) == sending[0]
        if number % 5 == 0:
            raise StoreTrouble("full", where=self.where)
        with plain(self) as t:
            yield t
        if number % 3 == 0:
            raise StoreTrouble("answers no more", where=self.where)

    def worked(url: str) -> tuple[Any, ...]:
        store = Store(url)
        fleet = fleet_of(store, targets={(kind, True): ["there"] for kind in ("alarm", "finding")})
        answered.clear()
        for k, block in enumerate(blocks_of(log)[:370]):
            sending[0] = k
            send(fleet, [replace(block, accepted=lambda k=k: answered.append(k))])
        sending[0] = 370
        assert answered == list(range(370)) and fleet.writer.trouble is None
        fleet.keep()
        sums = [r["n"] for r in store.rollups("A1", "leakage", "minute")]
        sent = [(p.kind, p.body["axis"] if p.kind == "finding" else "") for p in store.outbox(99, "there")]
        return told(store), sums, sent, store.journal("A1"), fleet

    whole = worked(f"sqlite:///{tmp_path / 'whole.db'}")
    tries = count()
    monkeypatch.setattr(Store, "transaction", failing)
    again = worked(f"sqlite:///{tmp_path / 'again.db'}" if kind == "sqlite" else postgres_url())
    assert again[-1].writer.errors > 100 and len(whole[0]["A1"]) == 3, "else this shows nothing"
    assert again[:-1] == whole[:-1]


def test_what_a_stop_amid_a_trouble_left_untold_is_told_after_the_next_start(store, log, monkeypatch):
    """The store fails as the alarm comes, the service is stopped, and just then the store works again."""
    blocks, stop, plain = blocks_of(log)[:450], threading.Event(), Store.transaction
    fleet = fleet_of(store)
    send(fleet, blocks[:300])
    assert not store.findings()

    def failing(self: Store) -> Any:
        if not stop.is_set():
            stop.set()
            raise StoreTrouble("full", where=self.where)
        return plain(self)

    monkeypatch.setattr(Store, "transaction", failing)
    monkeypatch.setattr(Fleet, "resume", lambda self: None)
    for block in blocks[300:]:
        fleet.inbox.put(block)
    for module in ("queues", "fleet"):
        monkeypatch.setattr(f"fdd.service.{module}.MOST_TAKEN", len(blocks))
    fleet.run(stop)
    monkeypatch.undo()
    again = fleet_of(store)
    assert again.axes()[0].samples <= 30_000, "none of it was accepted"
    send(again, blocks[300:])
    again.keep()
    assert len(store.findings()) == 1 and again.axes()[0].samples == 45_000


def test_an_axis_that_goes_silent_gives_what_it_has(store, log, ticking):
    wall = [RECEIVED]
    fleet = fleet_of(store, clock=lambda: wall[0])
    send(fleet, [replace(b, sequence=None, received=RECEIVED) for b in blocks_of(log)[:30]])
    assert fleet.axes()[0].state != "silent"
    passing(fleet, ticking, 9.0, *[0.2] * 13)  # the first is no silence but a machine that was busy
    assert fleet.axes()[0].samples < 3000
    passing(fleet, ticking, 0.2, 0.2)
    wall[0] -= 3600.0  # a clock that is set back hides no silence
    fleet.step(0.0)
    (status,) = fleet.axes()
    assert status.samples == 3000 and status.state == "silent"
    assert fleet_of(store).axes()[0].samples == 3000


def test_a_sender_that_the_service_keeps_waiting_is_not_silent(store, log, ticking, monkeypatch):
    """A batch of other axes takes long; the block that a hole waits for comes only then."""
    fleet = fleet_of(store)
    blocks = blocks_of(log)[:20]
    send(fleet, [b for b in blocks[:12] if b.sequence != 8])
    plain = Store.transaction

    def slow(self: Store) -> Any:
        ticking[0] += 5.0
        return plain(self)

    monkeypatch.setattr(Store, "transaction", slow)
    send(fleet, blocks_of(log, "B2")[:3])
    monkeypatch.undo()
    send(fleet, [blocks[8], *blocks[12:]])
    fleet.keep()
    (status,) = (s for s in fleet.axes() if s.name == "A1")
    assert status.samples == 2000 and status.quality["late"] == 0


@pytest.mark.parametrize("stops", [True, False])
def test_what_waits_for_a_block_waits_over_a_restart(stops, store, log):
    blocks = blocks_of(log)[:20]
    fleet = fleet_of(store)
    send(fleet, [b for b in blocks[:12] if b.sequence != 10])
    if stops:
        fleet.keep()
    again = fleet_of(store)
    again.step(0.0)
    send(again, [blocks[10], *blocks[12:]])
    again.keep()
    (status,) = again.axes()
    assert status.samples == 2000 and status.quality["late"] == 0


def test_it_answers_while_it_resumes(store, log, monkeypatch):
    fleet = fleet_of(store)
    # The first one alone: most is in the journal.
    monkeypatch.setattr("fdd.service.storing.CHECKPOINT_S", 1e9)
    send(fleet, blocks_of(log.rows(0, 40_000)))
    again = made(store)
    resuming, told = threading.Thread(target=again.resume), set()
    resuming.start()
    while resuming.is_alive():
        asked = time.monotonic()
        told.update(again.problems())
        assert again.count <= 1 and time.monotonic() - asked < 1.0
        time.sleep(0.005)
    assert len(told) > 5 and all(line.startswith("resuming, ") for line in told)
    assert again.problems() == [] and again.axes()[0].samples == 40_000


def test_a_store_that_is_away_at_the_start_is_waited_for(store, stop, monkeypatch):
    monkeypatch.setattr("fdd.service.storing.BACKOFF_S", (0.01, 0.01))
    plain, failures = Store.book, iter(range(3))

    def failing(self: Store) -> Any:
        if next(failures, None) is not None:
            raise StoreTrouble("away", where=self.where)
        return plain(self)

    monkeypatch.setattr(Store, "book", failing)
    fleet = made(store, fallback=None)
    running = threading.Thread(target=fleet.run, args=(stop,))
    running.start()
    until(lambda: fleet.resumed >= 1.0)
    assert fleet.writer.errors == 3 and fleet.problems() == []
    stop.set()
    running.join(10.0)
