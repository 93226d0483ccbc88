"""The bus: who hears what, who loses what, from many threads."""

from __future__ import annotations

import threading

from fdd.service.bus import Bus, Event


def event(number: int, kind: str = "status") -> Event:
    return Event(kind, "A1", float(number), {})  # type: ignore[arg-type]


def test_each_subscriber_hears_its_kinds_in_order() -> None:
    bus = Bus()
    bus.publish(event(0))
    every, alarms = bus.subscribe(), bus.subscribe(["alarm"])
    for number in (1, 2, 3):
        bus.publish(event(number, "alarm" if number == 2 else "status"))
    assert [every.get().time for _ in range(3)] == [1.0, 2.0, 3.0]  # type: ignore[union-attr]
    assert alarms.get() == event(2, "alarm")
    assert every.get() is alarms.get() is None


def test_a_slow_subscriber_loses_the_oldest_and_nobody_waits_for_it() -> None:
    bus = Bus()
    slow, fast = bus.subscribe(most=10), bus.subscribe(most=1000)
    for number in range(100):
        bus.publish(event(number))
    assert (slow.lost, fast.lost) == (90, 0)
    assert slow.get() == event(90)
    assert fast.get() == event(0)


def test_many_threads_publish_and_every_event_arrives_once() -> None:
    bus = Bus()
    subscription = bus.subscribe(most=10_000)
    threads = [
        threading.Thread(target=lambda k=k: [bus.publish(event(1000 * k + n)) for n in range(500)])
        for k in range(8)
    ]
    for thread in threads:
        thread.start()
        bus.subscribe(most=1)
    for thread in threads:
        thread.join()
    heard = [e.time for e in iter(subscription.get, None)]
    assert sorted(heard) == [1000.0 * k + n for k in range(8) for n in range(500)]
    assert subscription.lost == 0
