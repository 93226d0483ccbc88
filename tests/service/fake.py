"""Axes that are made up behind the real HTTP service: a real store, bus and alarm book, no pipelines."""

import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
from starlette.testclient import TestClient

from fdd.service.alarms import Action, Alarm, AlarmBook, Transition
from fdd.service.config import Listen
from fdd.service.http import Server, web
from fdd.service.queues import Bus, Event
from fdd.service.status import AxisDetail, AxisStatus, Bands, Series
from fdd.service.store import Store
from fdd.service.tokens import Tokens, new_token
from tests.service import senders

BASE = {"leakage": 6.5e-12, "bulk_modulus": 1.16e9, "coulomb_friction": 310.0, "viscous_friction": 950.0}
LEAK = senders.LEAK.model_copy(update={"onset_s": 408.2, "detected_s": 424.0})
PAGE = {"x-fdd": "1"}
"""What the page's own requests carry."""


class World:
    def __init__(self, *names: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="fdd-fake-")
        self.store, self.bus, self.book = Store(f"sqlite:///{self._folder.name}/fdd.db"), Bus(), AlarmBook()
        self.health: dict[str, Any] = {"status": "ok", "problems": [], "axes": len(names)}
        self.details = {name: _detail(name) for name in names}
        self.trouble: Exception | None = None

    def axes(self) -> list[AxisStatus]:
        return [d.status for d in self.details.values()]

    def axis(self, name: str) -> AxisDetail:
        return self.details[name]

    def raise_alarm(self, axis: str, priority: Any = "high", **words: Any) -> int:
        id = max(self.book._alarms, default=0) + 1
        given = {"fault": LEAK.fault, "family": LEAK.family, "severity": 0.41, "confidence": 0.97, **words}
        alarm = Alarm(
            id=id, axis=axis, key=f"key {id}", state="UNACK", priority=priority, level=1, time=424.0,
            seen=424.0, raised_time=424.0, raised_wall=time.time(), body=LEAK.model_dump(mode="json"),
            **given,
        )  # fmt: skip
        self._keep(Transition(action="RAISED", alarm=alarm, before="NORMAL", time=424.0, wall=time.time()))
        return id

    def act(self, action: Action) -> Transition:
        if self.trouble is not None:
            raise self.trouble
        return self._keep(self.book.act(action, time.time()))

    def remove(self, axis: str, who: str) -> None:
        if axis not in self.details:
            raise KeyError(axis)

    def _keep(self, done: Transition) -> Transition:
        alarm = done.alarm
        self.book._alarms[alarm.id] = alarm
        with self.store.transaction() as t:
            t.transition(done)
        mine = [a for a in self.book.alarms(alarm.axis) if a.state in ("UNACK", "ACKED", "RTNUN")]
        status = self.details[alarm.axis].status
        status.alarms, status.unacknowledged = len(mine), sum(a.state != "ACKED" for a in mine)
        status.priority = mine[0].priority if mine else None
        status.state = "unacknowledged" if status.unacknowledged else "in alarm" if mine else "healthy"
        self.bus.publish(Event("alarm", alarm.axis, 424.0, {"action": done.action}))
        return done

    def state_of(self, id: int) -> str:
        return str((self.store.alarm(id) or {})["state"])


def _detail(name: str) -> AxisDetail:
    seconds = np.arange(0.0, 600.0, 5.0)
    series = {k: (v * (1.0 + 0.01 * np.sin(seconds))).tolist() for k, v in BASE.items()}
    stamps, position = seconds.tolist(), {"position": (0.04 * np.sin(0.35 * seconds)).tolist()}
    known = {"unit": "", "observable": True}
    estimates = {k: {**known, "baseline": v, "value": v, "std": 0.01 * v} for k, v in BASE.items()}
    status = AxisStatus.model_validate(
        {"name": name, "unit": "axis_a", "state": "healthy", "headline": "No fault found", "samples": 600_000,
         "rate_hz": 1000.0, "last_wall": time.time(), "probabilities": {"healthy": 0.98},
         "estimates": estimates}
    )  # fmt: skip
    return AxisDetail(
        status=status,
        estimates=Series(time=stamps, values=series, std=series),
        misfits=Series(time=stamps, values={"volume": np.abs(position["position"]).tolist()}),
        probabilities=Series(time=stamps, values={"healthy": [0.98] * len(stamps)}),
        signals=Bands(time=stamps, low=position, high=position),
    )


def made_up() -> World:
    """Axes in all states, with alarms 1 to 4: shelved, acknowledged, and two that nobody has seen yet."""
    world = World(
        "F3/spoiler-2", "F3/elevator-L", "F7/rudder", "F7/aileron-R", "F3/rudder", "F9/aileron-L",
        "rig-2/axis-B", "rig-2/axis-C",
    )  # fmt: skip
    for name, state in (("F9/aileron-L", "learning"), ("rig-2/axis-B", "silent"), ("rig-2/axis-C", "failed")):
        world.details[name].status.state = state
    world.details["F7/aileron-R"].findings.append(LEAK)
    sensor = {"fault": "pressure_sensor_bias", "family": "sensor", "channel": "pressure_1"}
    world.raise_alarm("F3/spoiler-2", "low", **sensor)
    seal = {"fault": "seal_wear", "family": "seal_wear", "count": 4, "chattering": True}
    world.raise_alarm("F3/elevator-L", "medium", **seal)
    world.raise_alarm("F7/rudder", "high", fault="aeration", family="aeration")
    world.raise_alarm("F7/aileron-R", "urgent")
    world.act(Action("shelve", 1, "a.sato", "Sensor is exchanged at the next stop", time.time() + 7200))
    world.act(Action("acknowledge", 2, "r.meier", "Seal kit ordered, watch until Friday"))
    return world


def service_of(world: World, tokens: Tokens | None = None, told: bool = True, **listen: Any) -> Any:
    metrics = lambda accept: (b"fdd_axes 2\n", "text/plain; version=0.0.4; charset=utf-8")  # noqa: E731
    return SimpleNamespace(
        fleet=world, store=world.store, bus=world.bus, health=lambda: world.health, metrics=metrics,
        tokens=tokens,
        config=SimpleNamespace(listen=Listen(**{"port": 0, **listen}), outputs=SimpleNamespace(metrics=told)),
    )  # fmt: skip


def client_of(world: World, **given: Any) -> TestClient:
    app = web(service_of(world, **given), threading.Event())
    return TestClient(app, base_url="http://127.0.0.1:8080", raise_server_exceptions=False)


def three_tokens() -> tuple[Tokens, dict[str, str]]:
    made = {role: new_token(f"{role}-person", role) for role in ("view", "acknowledge", "admin")}
    return Tokens.parse("\n".join(line for _, line in made.values())), {r: t for r, (t, _) in made.items()}


def bearer(token: str) -> dict[str, str]:
    return {"authorization": f"Bearer {token}"}


@contextmanager
def on_a_port(world: World, **given: Any) -> Iterator[Server]:
    server = Server(service_of(world, **given))
    server.start()
    try:
        yield server
    finally:
        assert server.stop(15)
