"""Inbox and bus: bounded, fair, and nothing is lost without being counted."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from fdd.bounds import MOST_AXES
from fdd.errors import InputError
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.bus import Bus, Event
from fdd.service.inbox import Inbox


def block(axis: str, number: int, seconds: float = 1.0, **more: object) -> Block:
    time = number * seconds + np.linspace(0.0, seconds, 10, endpoint=False)
    return Block(axis, Samples(time, {"position": time}), number, "test", 0.0, **more)  # type: ignore[arg-type]


def test_blocks_come_out_oldest_first_and_in_turn() -> None:
    inbox = Inbox()
    for number in range(5):
        inbox.put(block("busy", number))
    inbox.put(block("calm", 0))
    taken = inbox.take(0.0)
    assert [b.axis for b in taken[:3]] == ["busy", "calm", "busy"]
    assert [b.sequence for b in taken if b.axis == "busy"] == list(range(5))
    assert inbox.take(0.0) == []


def test_the_axis_that_lags_loses_its_oldest_and_no_other() -> None:
    inbox, told = Inbox(most_seconds=3.0), []
    for number in range(8):
        inbox.put(block("slow", number, accepted=lambda n=number: told.append(n)))
    assert inbox.problems() == ["overloaded: the oldest samples are dropped of slow"]
    inbox.put(block("fine", 0))
    counters = {axis: inbox.counters(axis) for axis in ("slow", "fine")}
    assert counters["slow"]["dropped_samples"] == 50
    assert counters["slow"]["lag_s"] == pytest.approx(3.0) and counters["fine"]["dropped_samples"] == 0
    assert [b.sequence for b in inbox.take(0.0) if b.axis == "slow"] == [5, 6, 7]
    assert told == [], "what is not stored is not acknowledged"
    assert inbox.counters("slow")["lag_s"] == 0.0
    one = block("x", 0)
    inbox = Inbox(most_bytes=6 * (one.nbytes + 1000))
    for number in range(2):
        inbox.put(block("short", number, seconds=0.1))
    for number in range(6):
        inbox.put(block("long", number))
    assert inbox.counters("short")["dropped_samples"] == 0
    assert inbox.counters("long")["dropped_samples"] == 2 * len(one.samples)


def test_a_patient_sender_waits_for_room_and_loses_nothing() -> None:
    size = block("A1", 0).nbytes + 1000
    inbox, told = Inbox(most_seconds=3.0, most_bytes=5 * size), []

    def send() -> None:
        for number in range(20):
            inbox.put(block("A1", number, patient=True, accepted=lambda n=number: told.append(n)))

    sender = threading.Thread(target=send)
    sender.start()
    taken = inbox.take(5.0)
    while len(taken) < 20:
        taken += inbox.take(5.0)
    sender.join(5.0)
    assert [b.sequence for b in taken] == list(range(20)) and told == []


def test_a_closed_inbox_holds_no_sender_and_takes_nothing_from_it() -> None:
    one = block("A1", 0, patient=True)
    inbox, told = Inbox(most_seconds=0.5, most_bytes=one.nbytes + 1000), []
    inbox.put(one)
    assert inbox.problems() == ["overloaded: senders wait, more than 0.5 s behind are A1"]
    late = block("A1", 1, patient=True, accepted=lambda: told.append(1))
    sender = threading.Thread(target=inbox.put, args=(late,))
    sender.start()
    inbox.close()
    sender.join(5.0)
    assert not sender.is_alive() and len(inbox.take(0.0)) == 1 and told == []


def test_more_axes_than_a_service_watches_are_refused() -> None:
    inbox = Inbox()
    one = block("A", 0)
    for number in range(MOST_AXES):
        inbox.put(replace(one, axis=f"A{number}"))
    with pytest.raises(InputError, match="more than 1000 axes"):
        inbox.put(replace(one, axis="one-more"))
    inbox.put(replace(one, axis="A7"))
    patient = threading.Thread(target=inbox.put, args=(replace(one, axis="one-more", patient=True),))
    patient.start()
    assert "one-more" not in {b.axis for b in inbox.take(0.0)}, "not refused either: it waits for a place"
    patient.join(5.0)
    assert not patient.is_alive()


def test_many_threads_put_and_all_is_taken_or_counted() -> None:
    inbox, names, each = Inbox(most_seconds=5.0), [f"A{k}" for k in range(6)], 200

    def send(name: str) -> None:
        for number in range(each):
            inbox.put(block(name, number, seconds=0.1))

    taken: list[Block] = []
    with ThreadPoolExecutor(len(names)) as pool:
        sending = [pool.submit(send, name) for name in names]
        while not all(s.done() for s in sending):
            taken += inbox.take(0.2)
    while more := inbox.take(0.0):
        taken += more
    for name in names:
        own = [b for b in taken if b.axis == name]
        assert [b.sequence for b in own] == sorted(b.sequence for b in own)  # type: ignore[type-var]
        dropped = inbox.counters(name)["dropped_samples"]
        assert sum(len(b.samples) for b in own) + dropped == 10 * each


def event(number: int, kind: str = "status") -> Event:
    return Event(kind, "A1", float(number), {})  # type: ignore[arg-type]


def test_each_subscriber_hears_its_kinds_in_order_and_a_slow_one_loses_the_oldest() -> None:
    bus = Bus()
    bus.publish(event(0))
    every, alarms, slow = bus.subscribe(), bus.subscribe(["alarm"]), bus.subscribe(most=10)
    for number in range(1, 101):
        bus.publish(event(number, "alarm" if number == 2 else "status"))
    assert [every.get().time for _ in range(100)] == [float(k) for k in range(1, 101)]  # type: ignore[union-attr]
    assert alarms.get() == event(2, "alarm")
    assert every.get() is alarms.get() is None
    assert (slow.lost, every.lost) == (90, 0) and slow.get() == event(91)


def test_many_threads_publish_and_every_event_arrives_once() -> None:
    bus = Bus()
    subscription = bus.subscribe(most=10_000)

    def publish(k: int) -> None:
        bus.subscribe(most=1)
        for n in range(500):
            bus.publish(event(1000 * k + n))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(publish, range(8)))
    heard = [e.time for e in iter(subscription.get, None)]
    assert sorted(heard) == [1000.0 * k + n for k in range(8) for n in range(500)]
    assert subscription.lost == 0
