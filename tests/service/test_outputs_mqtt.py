"""MQTT against a real broker, which forgets, refuses, dies and comes back."""

from __future__ import annotations

import json
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fdd.service.config import MqttOutput
from fdd.service.outputs import targets
from fdd.service.outputs.delivery import Undelivered
from fdd.service.outputs.targets import MqttPublisher
from fdd.service.store import Store
from tests.service.brokers import Broker, Client, needs_mosquitto
from tests.service.senders import finding, message, sent, transition, until

pytestmark = needs_mosquitto


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    one = Broker(tmp_path, keeps=False)
    yield one
    one.kill()


@pytest.fixture
def listen(broker: Broker) -> Iterator[Callable[[], Client]]:
    with ExitStack() as open_ones:
        yield lambda: open_ones.enter_context(closing(Client(broker, listens="#")))


@pytest.fixture
def publish(broker: Broker) -> Iterator[Callable[..., MqttPublisher]]:
    """Starts a publisher, and waits until it is connected unless it is to be refused."""
    stops = ExitStack()

    def publisher(
        standing: Any = lambda: (), store: Any = None, connects: bool = True, **given: Any
    ) -> MqttPublisher:
        config = MqttOutput(host="127.0.0.1", port=broker.port, prefix="plant/fdd", **given)
        kept = {"outbox": store.outbox, "settle": store.settle} if store else {}
        made = MqttPublisher(config, SimpleNamespace(alarms=lambda states: standing(), **kept))
        stops.callback(made.stop)
        made.start()
        until(lambda: not connects or (made.status()["connected"] and made.connections))
        return made

    with stops:
        yield publisher


VERSIONS = pytest.mark.parametrize("version", ["3.1.1", "5"])


@VERSIONS
def test_what_is_retained_and_what_is_not(publish: Any, listen: Any, version: str) -> None:
    live, publisher = listen(), publish(version=version)
    publisher.note("hall/A1", {"state": "in alarm"})
    publisher.tick()
    publisher.deliver(message("alarm", transition(axis="hall/A1")))
    publisher.deliver(message("finding", {"axis": "hall/A1", **finding()}))
    state, alarm, found = (f"plant/fdd/axis/hall/A1/{end}" for end in ("state", "alarm/1", "finding"))
    until(lambda: live.of(found) and live.of(state))
    assert json.loads(live.of(found)[0][0])["fault"] == "pump_wear"
    late = listen()
    until(lambda: late.of("plant/fdd/status") and late.of(alarm) and late.of(state))
    assert late.of("plant/fdd/status") == [(b"online", True)]
    assert json.loads(late.of(alarm)[0][0]) == transition(axis="hall/A1")["alarm"]
    assert json.loads(late.of(state)[0][0]) == {"state": "in alarm"}
    publisher.deliver(message("alarm", transition("ACKNOWLEDGED", "NORMAL", axis="hall/A1")))
    until(lambda: live.of(alarm)[-1:] == [(b"", False)])
    later = listen()
    until(lambda: later.of(state))
    assert not later.of(alarm) and not later.of(found)


def test_a_state_is_told_not_too_often(publish: Any, listen: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    live, publisher = listen(), publish()
    monkeypatch.setattr(targets, "EVERY_S", 0.4)
    begun = time.monotonic()
    while time.monotonic() - begun < 1.0:
        publisher.note("A1", {"n": int((time.monotonic() - begun) * 50)})
        publisher.note("A2", {"n": 0})
        publisher.tick()
        time.sleep(0.01)
    until(lambda: len(live.of("plant/fdd/axis/A1/state")) >= 2)
    time.sleep(0.2)
    assert len(live.of("plant/fdd/axis/A1/state")) <= 3
    assert len(live.of("plant/fdd/axis/A2/state")) == 1
    publisher.note("A2", {})  # it was removed
    until(lambda: publisher.tick() or len(live.of("plant/fdd/axis/A2/state")) == 2)
    later = listen()
    until(lambda: later.of("plant/fdd/axis/A1/state"))
    assert not later.of("plant/fdd/axis/A2/state")


@VERSIONS
def test_a_broker_that_was_killed_is_told_everything_again(
    broker: Broker, publish: Any, listen: Any, version: str, store: Store
) -> None:
    stands = list[dict[str, Any]]()
    publisher = publish(lambda: stands, store, version=version)
    publisher.note("A1", {"state": "healthy"})
    publisher.tick()
    broker.kill()
    until(lambda: not publisher.status()["connected"])
    stands.append(transition(id=1, state="ACKED")["alarm"])
    sent(store, "alarm", transition(id=3), "mqtt")
    publisher.once()
    assert publisher.counts["failed"] == 1 and publisher.last_error
    broker.start()
    until(lambda: publisher.connections == 2)
    until(lambda: publisher.tick() or publisher.once() or publisher.counts["delivered"])
    late = listen()
    base = "plant/fdd/axis/A1"
    until(lambda: late.of(f"{base}/alarm/3") and late.of(f"{base}/alarm/1") and late.of(f"{base}/state"))
    assert json.loads(late.of(f"{base}/state")[0][0]) == {"state": "healthy"}


def test_a_broken_link_is_told_and_a_store_in_trouble_asked_again(publish: Any, listen: Any) -> None:
    asked: list[int] = []

    def standing() -> list[dict[str, Any]]:
        asked.append(1)
        if len(asked) == 1:
            raise RuntimeError("locked")
        return [transition()["alarm"]]

    live, publisher = listen(), publish(standing)
    with pytest.raises(RuntimeError):
        publisher.tick()
    publisher.tick()
    until(lambda: live.of("plant/fdd/axis/A1/alarm/1") and live.of("plant/fdd/status"))
    publisher._client.socket().shutdown(socket.SHUT_RDWR)
    until(lambda: [payload for payload, _ in live.of("plant/fdd/status")][-2:] == [b"offline", b"online"])
    publisher.stop()
    until(lambda: live.of("plant/fdd/status")[-1][0] == b"offline")


def test_a_wrong_password_is_told_in_a_line(broker: Broker, publish: Any, tmp_path: Path) -> None:
    secrets = tmp_path / "users"
    secrets.write_text("fdd:right\n")
    if subprocess.run(["mosquitto_passwd", "-U", str(secrets)], check=False).returncode:
        pytest.skip("mosquitto_passwd does not work here")
    broker.kill()
    broker.start("allow_anonymous false", f"password_file {secrets}")
    for word in ("right", "wrong"):
        (tmp_path / word).write_text(f"{word}\n")
    refused = publish(user="fdd", password_file=tmp_path / "wrong", connects=False)
    until(lambda: "refuses" in refused.status()["link_error"])
    assert "Not authorized" in refused.status()["link_error"]
    with pytest.raises(Undelivered, match="refuses the connection"):
        refused.deliver(message("alarm", transition()))
    publisher = publish(user="fdd", password_file=tmp_path / "right")
    publisher.deliver(message("alarm", transition()))
