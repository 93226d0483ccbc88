"""A fleet, a store and a bus that are made up: what the HTTP service sees of the others, and nothing more."""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fdd.errors import InputError
from fdd.service.http.answers import AxisDetail, AxisStatus, Bands, Series
from fdd.service.http.doors import Action

BASE = {"leakage": 6.5e-12, "bulk_modulus": 1.16e9, "coulomb_friction": 310.0, "viscous_friction": 950.0}
UNITS = {"leakage": "m^3/(s*Pa)", "bulk_modulus": "Pa", "coulomb_friction": "N", "viscous_friction": "N*s/m"}
BALANCES = ("volume", "force", "torque", "coherence", "reservoir")
SPAN_S, HZ = 600, 10
DONE = {
    "acknowledge": "ACKNOWLEDGED",
    "shelve": "SHELVED",
    "unshelve": "UNSHELVED",
    "out_of_service": "OUT_OF_SERVICE",
    "in_service": "IN_SERVICE",
}


@dataclass
class Event:
    kind: str
    axis: str
    time: float
    data: dict[str, Any]


@dataclass
class Subscription:
    waiting: queue.Queue[Event] = field(default_factory=lambda: queue.Queue(1000))
    closed: bool = False

    def get(self, timeout: float) -> Event | None:
        try:
            return self.waiting.get(timeout=timeout)
        except queue.Empty:
            return None

    def close(self) -> None:
        self.closed = True


class FakeBus:
    def __init__(self) -> None:
        self.listeners: list[Subscription] = []

    def subscribe(self) -> Subscription:
        self.listeners.append(Subscription())
        return self.listeners[-1]

    def publish(self, kind: str, axis: str, **data: Any) -> None:
        for listener in self.listeners:
            if not listener.closed:
                listener.waiting.put_nowait(Event(kind, axis, 600.0, data))


class FakeStore:
    def __init__(self) -> None:
        self.rows: dict[int, dict[str, Any]] = {}
        self.records: list[dict[str, Any]] = []

    def alarms(self, states: Sequence[str] | None = None, limit: int = 1000) -> list[dict[str, Any]]:
        found = [r for r in self.rows.values() if states is None or r["state"] in states]
        return sorted(found, key=lambda r: -r["raised_wall"])[:limit]

    def alarm(self, id: int) -> dict[str, Any] | None:
        return self.rows.get(id)

    def axes(self) -> list[dict[str, Any]]:
        return []

    def meta(self, key: str) -> str | None:
        return None

    def rollups(self, axis: str, quantity: str, level: str, since: float) -> list[dict[str, Any]]:
        if quantity not in BASE:
            return []
        step = {"minute": 60.0, "hour": 3600.0, "day": 86400.0}[level]
        begin = max(since, time.time() - {"minute": 0.5, "hour": 20, "day": 300}[level] * 86400.0)
        wall = np.arange(math.ceil(begin / step) * step, time.time(), step)
        random = np.random.default_rng(len(axis))
        slope = 0.5 if "aileron-R" in axis else 0.03
        mean = BASE[quantity] * (1.0 + slope * np.linspace(0, 1, wall.size) ** 2)
        mean = mean * (1.0 + 0.01 * random.standard_normal(wall.size))
        return [
            {"start_wall": w, "n": 60, "mean": m, "std": 0.02 * m, "min": 0.96 * m, "max": 1.05 * m}
            for w, m in zip(wall.tolist(), mean.tolist(), strict=True)
        ]

    def audit(self, alarm_id: int | None = None, limit: int = 1000) -> list[dict[str, Any]]:
        found = [r for r in self.records if alarm_id is None or r["alarm_id"] == alarm_id]
        return found[::-1][:limit]

    def record(self, who: str, action: str, row: dict[str, Any], note: str = "") -> None:
        self.records.append(
            {
                "id": len(self.records) + 1,
                "wall": time.time(),
                "who": who,
                "action": action,
                "alarm_id": row["id"],
                "axis": row["axis"],
                "note": note,
            }
        )


class FakeFleet:
    """Axes by name; `raise_alarm` and `act` move the alarms as ISA-18.2 does, as far as the page needs it."""

    def __init__(self, store: FakeStore, bus: FakeBus) -> None:
        self.store, self.bus = store, bus
        self.details: dict[str, AxisDetail] = {}
        self.trouble: Exception | None = None
        self._lock = threading.Lock()

    def axes(self) -> list[AxisStatus]:
        return [d.status for d in self.details.values()]

    def axis(self, name: str) -> AxisDetail:
        return self.details[name]

    def add(self, name: str, **given: Any) -> AxisDetail:
        self.details[name] = _detail(name, **given)
        return self.details[name]

    def raise_alarm(self, axis: str, fault: str, family: str, priority: str, **given: Any) -> int:
        id = len(self.store.rows) + 1
        row = {
            "id": id,
            "axis": axis,
            "fault": fault,
            "family": family,
            "priority": priority,
            "state": "UNACK",
            "raised_wall": time.time(),
            "raised_time": 412.0,
            "severity": 0.41,
            "confidence": 0.97,
            **given,
        }
        self.store.rows[id] = row
        self.store.record("fdd", "RAISED", row)
        self._count(axis)
        self.bus.publish("alarm", axis, transition="RAISED", alarm=id, fault=fault, priority=priority)
        return id

    def act(self, action: Action) -> None:
        if self.trouble is not None:
            raise self.trouble
        with self._lock:
            row = self.store.rows[action.alarm_id]
            moves = {
                "acknowledge": ("UNACK", "RTNUN"),
                "shelve": ("UNACK", "ACKED", "RTNUN"),
                "unshelve": ("SHELVED",),
                "in_service": ("OUT_OF_SERVICE",),
                "out_of_service": ("UNACK", "ACKED", "RTNUN", "SHELVED"),
            }
            if row["state"] not in moves[action.kind]:
                raise InputError(
                    f"cannot {action.kind} what is {row['state']}", where=f"alarm {action.alarm_id}"
                )
            now = time.time()
            if action.kind == "acknowledge":
                row |= {"acked_by": action.who, "acked_wall": now, "note": action.note}
                row["state"] = "ACKED" if row["state"] == "UNACK" else "NORMAL"
            elif action.kind == "shelve":
                row |= {"state": "SHELVED", "shelved_by": action.who, "shelved_until": action.until}
                row["note"] = action.note
            else:
                row["state"] = "OUT_OF_SERVICE" if action.kind == "out_of_service" else "UNACK"
            self.store.record(action.who, DONE[action.kind], row, action.note)
            self._count(row["axis"])
        self.bus.publish("alarm", row["axis"], transition=action.kind.upper(), alarm=row["id"])

    def _count(self, axis: str) -> None:
        rows = [r for r in self.store.rows.values() if r["axis"] == axis]
        status = self.details[axis].status
        standing = [r for r in rows if r["state"] in ("UNACK", "ACKED", "RTNUN")]
        fresh = [r for r in standing if r["state"] in ("UNACK", "RTNUN")]
        ranks = ("low", "medium", "high", "urgent")
        status.alarms, status.unacknowledged = len(standing), len(fresh)
        status.priority = max((r["priority"] for r in standing), key=ranks.index, default=None)
        if status.state in ("healthy", "in alarm", "unacknowledged"):
            status.state = "unacknowledged" if fresh else "in alarm" if standing else "healthy"


def _detail(
    name: str,
    *,
    state: str = "healthy",
    headline: str = "Healthy: no fault found in 6.2 h",
    factors: dict[str, float] | None = None,
    family: str = "healthy",
    findings: Sequence[Any] = (),
    misfit: str = "",
    points: int = SPAN_S,
) -> AxisDetail:
    random = np.random.default_rng(sum(name.encode()))
    factors = factors or {}
    when = np.linspace(0.0, SPAN_S, points)
    rise = 1.0 / (1.0 + np.exp(-(when - 410.0) / 6.0))
    estimates, values, stds = {}, {}, {}
    for k, base in BASE.items():
        path = base * (1.0 + (factors.get(k, 1.0) - 1.0) * rise)
        path *= 1.0 + 0.004 * np.cumsum(random.standard_normal(points)) / 6.0 / math.sqrt(points / 600)
        std = base * (0.012 + 0.05 * np.exp(-when / 40.0))
        values[k], stds[k] = path.tolist(), std.tolist()
        estimates[k] = {
            "unit": UNITS[k],
            "baseline": base,
            "value": path[-1],
            "std": std[-1],
            "observable": True,
        }
    hops = np.arange(0.0, SPAN_S, 5.0)
    misfits = {
        b: (
            np.abs(random.standard_normal(hops.size)) * 0.6 + (4.0 if b == misfit else 0.0) * (hops > 415)
        ).tolist()
        for b in BALANCES
    }
    sure = 1.0 / (1.0 + np.exp(-(hops - 430.0) / 8.0)) * (0.96 if family != "healthy" else 0.02)
    chances = {
        "healthy": (1.0 - sure).tolist(),
        (family if family != "healthy" else "leakage"): sure.tolist(),
    }
    t = np.arange(0.0, SPAN_S, 1.0 / HZ)
    motion = 0.04 * np.sin(0.35 * t) * np.sign(np.sin(0.05 * t)) + 0.004 * random.standard_normal(t.size)
    press = 2.1e6 * np.cos(0.35 * t) + 6e4 * random.standard_normal(t.size)
    signals = {
        "position": motion,
        "pressure_difference": press,
        "pump_speed": 80 * np.cos(0.35 * t) + 2 * random.standard_normal(t.size),
    }
    now = {f: round(v[-1], 4) for f, v in chances.items()}
    status = AxisStatus.model_validate(
        {
            "name": name,
            "unit": "axis_a",
            "state": state,
            "last_wall": time.time() - (0.2 if state != "silent" else 754.0),
            "lag_s": 0.3,
            "samples": 22_320_000,
            "rate_hz": 1000.0 if state != "silent" else 0.0,
            "verdict": {"healthy": "healthy", "learning": "inconclusive"}.get(state, "faulty"),
            "headline": headline,
            "probabilities": now,
            "estimates": estimates,
            "quality": {"dropped": 3, "late": 0, "repeated": 0},
        }
    )
    return AxisDetail(
        status=status,
        findings=list(findings),
        estimates=Series(time=when.tolist(), values=values, std=stds),
        misfits=Series(time=hops.tolist(), values=misfits),
        probabilities=Series(time=hops.tolist(), values=chances),
        signals=Bands(
            time=t.tolist(),
            low={k: (v - 0.02 * np.ptp(v)).tolist() for k, v in signals.items()},
            high={k: (v + 0.02 * np.ptp(v)).tolist() for k, v in signals.items()},
        ),
    )


def fake(axes: int = 0) -> tuple[FakeFleet, FakeStore, FakeBus]:
    """An empty fleet, or one of so many healthy axes."""
    store, bus = FakeStore(), FakeBus()
    fleet = FakeFleet(store, bus)
    for k in range(axes):
        fleet.add(f"rig/axis-{k + 1}", points=60)
    return fleet, store, bus
