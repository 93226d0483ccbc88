"""A store and a bus in memory, and made-up transitions, for the tests of the outputs."""

from __future__ import annotations

import itertools
import queue
import socket
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any


@dataclass(frozen=True)
class FakeEvent:
    kind: str
    axis: str
    time: float
    data: Mapping[str, Any]


class FakeSubscription:
    def __init__(self, kinds: Collection[str]) -> None:
        self.kinds, self.events, self.lost = kinds, queue.Queue[FakeEvent](), 0

    def get(self, timeout: float = 0.0) -> FakeEvent | None:
        try:
            return self.events.get(timeout=timeout) if timeout else self.events.get_nowait()
        except queue.Empty:
            return None

    def close(self) -> None:
        self.kinds = ()


class FakeBus:
    def __init__(self) -> None:
        self.subscriptions: list[FakeSubscription] = []

    def subscribe(self, kinds: Collection[str]) -> FakeSubscription:
        self.subscriptions.append(FakeSubscription(tuple(kinds)))
        return self.subscriptions[-1]

    def publish(self, event: FakeEvent) -> None:
        for subscription in self.subscriptions:
            if event.kind in subscription.kinds:
                subscription.events.put(event)


@dataclass(frozen=True)
class FakeParcel:
    id: int
    kind: str
    body: Mapping[str, Any]
    target: str
    attempts: int = 0
    next_wall: float = 0.0


@dataclass
class FakeStore:
    """The outbox's rows by id; done ones go to `arrived`, lost ones to `audited`."""

    rows: dict[int, FakeParcel] = field(default_factory=dict)
    arrived: list[FakeParcel] = field(default_factory=list)
    audited: list[str] = field(default_factory=list)
    standing: list[dict[str, Any]] = field(default_factory=list)
    trouble: Exception | None = None
    ids: Any = field(default_factory=lambda: itertools.count(1))
    lock: Any = field(default_factory=threading.Lock)

    def send(self, kind: str, body: Mapping[str, Any], target: str) -> int:
        id = next(self.ids)
        with self.lock:
            self.rows[id] = FakeParcel(id, kind, body, target)
        return id

    def outbox(self, limit: int, target: str) -> list[FakeParcel]:
        if self.trouble:
            raise self.trouble
        with self.lock:
            mine = [row for _, row in sorted(self.rows.items()) if row.target == target]
        return mine[:limit]

    def delivered(self, id: int) -> None:
        with self.lock:
            self.arrived.append(self.rows.pop(id))

    def put_off(self, id: int, next_wall: float) -> None:
        with self.lock:
            row = self.rows[id]
            self.rows[id] = replace(row, attempts=row.attempts + 1, next_wall=next_wall)

    def give_up(self, id: int, note: str) -> None:
        with self.lock:
            del self.rows[id]
            self.audited.append(note)

    def alarms(self, states: Collection[str]) -> list[dict[str, Any]]:
        return [alarm for alarm in self.standing if alarm["state"] in states]


def finding(onset: float = 3.0, detected: float = 15.0) -> dict[str, Any]:
    return {
        "fault": "pump_wear", "family": "leakage", "ambiguity": ["pump_wear", "internal_leakage"],
        "confidence": 0.9, "onset_s": onset, "detected_s": detected, "severity": 0.6,
        "evidence": ["leakage rose"],
    }  # fmt: skip


def transition(
    action: str = "RAISED", state: str = "UNACK", id: int = 1, axis: str = "A1", **of_finding: float
) -> dict[str, Any]:
    alarm = {
        "id": id, "axis": axis, "state": state, "family": "leakage", "fault": "pump_wear", "priority": "high",
        "body": finding(**of_finding),
    }  # fmt: skip
    return {"action": action, "alarm": alarm, "before": "NORMAL", "wall": 1.7e9, "who": "fdd", "note": ""}


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def until(true: Callable[[], object], seconds: float = 15.0) -> None:
    """Wait until something holds; fail where it does not in time."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)
