"""Source and output of MQTT against a real broker, which dies, forgets, refuses and comes back."""

import json
import re
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fdd.service.blocks import Block, Decoder, encode_arrow, encode_json
from fdd.service.config import MqttOutput
from fdd.service.config_sources import MqttSource
from fdd.service.outputs import Undelivered, targets
from fdd.service.outputs.targets import MqttPublisher
from fdd.service.service import open_source
from fdd.service.sources import Source
from tests.service.senders import (
    Taker,
    a_block,
    certificate,
    finding,
    message,
    ordered,
    sent,
    transition,
    until,
)
from tests.service.servers import Broker, Client, needs_mosquitto

pytestmark = needs_mosquitto


@pytest.fixture(params=["3.1.1", "5"])
def version(request) -> str:
    return str(request.param)


@pytest.fixture
def broker_of(tmp_path) -> Iterator[Callable[..., Broker]]:
    """Starts one with settings of its own."""
    with ExitStack() as kills:

        def started(*settings: str, **more: bool) -> Broker:
            one = Broker(tmp_path, *settings, **more)
            kills.callback(one.kill)
            return one

        yield started


@pytest.fixture
def broker(broker_of) -> Broker:
    return broker_of()


def source_of(broker: Broker, **more: object) -> Source:
    given = {"type": "mqtt", "host": "127.0.0.1", "port": broker.port, "topics": ["rigs/#"]}
    return open_source(MqttSource.model_validate({**given, "client_id": "fdd-test", **more}))


@pytest.fixture
def sender(broker) -> Iterator[Client]:
    with closing(Client(broker, client_id="sender", clean_session=False)) as client:
        yield client


def connected(source: Source) -> Source:
    until(lambda: source.status()["connected"])
    return source


@pytest.fixture
def reading(broker, start, version) -> Callable[..., Source]:
    """Makes a source of the broker, which gives the taker what comes."""
    return lambda **more: connected(start(source_of(broker, version=version, **more)))


def positions(count: int) -> np.ndarray:
    return np.concatenate([a_block(k).samples["position"] for k in range(count)])


def test_topics_with_wildcards_or_the_message_name_the_axis(reading, taker, sender):
    source = reading(topics=["rigs/{axis}/x/#", "all/+"])
    without = encode_json(a_block(0)).replace(b'"axis":"A1",', b"")
    for topic in ("rigs/R1/x/deep/er", "rigs/R5/x", "rigs/R4/y", "all/two"):
        sender.publish(topic, without)
    sender.publish("rigs/R2/x", encode_arrow(a_block(0, "R2")))
    sender.publish("rigs/R3/x", encode_json(a_block(0, "R9")))
    sender.publish("all/one", encode_json(a_block(0, "A7")))
    until(lambda: source.status()["received"] == 4 and source.status()["refused"] == 2)
    assert sorted(b.axis for b in taker.blocks) == ["A7", "R1", "R2", "R5"]
    assert np.array_equal(taker.joined("R2")["position"], a_block(0).samples["position"])


def test_garbage_faults_and_retained_messages_hold_up_nothing(version, reading, taker, sender, monkeypatch):
    def failing(self: Decoder, payload: bytes, *given: object, **more: object) -> Block:
        if payload == b"fault":
            raise RuntimeError("a fault")
        return decode(self, payload, *given, **more)

    decode = Decoder.decode
    monkeypatch.setattr(Decoder, "decode", failing)
    # It has to be there before the source subscribes, or it would come as any other.
    sender.publish("rigs/A1", encode_json(a_block(99)), retain=True).wait_for_publish(60.0)
    source = reading()
    bad = (b"", b"garbage", b"fault", b"\xff\xff\xff\xff\x10", b'{"schema": 3}')
    for k in range(450):  # more than may be on their way unacknowledged
        sender.publish("rigs/A1", bad[k % 5])
    until(lambda: source.status()["refused"] == 450)
    assert source.status()["last_error"].startswith("topic rigs/A1: ")
    sender.publish("rigs/A1", b"fault")
    for k in range(5):
        sender.publish("rigs/A1", encode_json(a_block(k)))
    until(lambda: taker.numbers() == [0, 1, 2, 3, 4])
    status = source.status()
    assert status["refused"] == 451 and status["last_error"] == "internal error: RuntimeError: a fault"
    assert status.get("retained", 0) == (version == "3.1.1")


def test_acknowledgements_go_in_the_order_in_which_messages_came(version, broker_of, tmp_path, taker, start):
    """Else mosquitto before 2.0.13 sends new messages before those that wait for room on their way."""
    log, random = tmp_path / "log", np.random.default_rng(1)
    broker = broker_of("allow_anonymous true", f"log_dest file {log}", "log_type all")
    connected(start(source_of(broker, version=version, topics=["rigs/{axis}"])))
    taker.accepting, sender = False, Client(broker)
    for k in range(120):
        sender.publish("rigs/A1", encode_json(a_block(k, "A1", rows=1)))
        sender.publish("rigs/A2", b"")  # is no block, and done at once
        sender.publish("rigs/A3", encode_json(a_block(k, "A3", rows=1)))
    accepted, end = 0, time.monotonic() + 20.0
    while accepted < 240 and time.monotonic() < end:
        time.sleep(0.01)
        new = taker.blocks[accepted:]
        for place in random.permutation(len(new)):
            new[place].accepted()
        accepted += len(new)
    assert taker.numbers("A1") == taker.numbers("A3") == list(range(120))

    def logged(what: str) -> list[str]:
        return re.findall(rf"{what} fdd-test \(.*?[mM](?:id: )?(\d+)", log.read_text())

    until(lambda: len(logged("Received PUBACK from")) == 360)
    assert logged("Received PUBACK from") == logged("Sending PUBLISH to")
    sender.close()


def test_nothing_is_acknowledged_before_it_is_accepted(version, broker, reading, taker, stop, sender):
    taker.accepting = False
    source = reading()
    for k in range(12):
        sender.publish("rigs/A1", encode_json(a_block(k)))
    until(lambda: len(taker.blocks) == 12)
    for block in taker.blocks[:7]:
        block.accepted()
    time.sleep(0.5)
    stop.set()
    until(lambda: not source.status()["connected"])
    # As after a crash of the service: what was not stored comes again, what was stored does not.
    again, stop = Taker(), threading.Event()
    for k in range(12, 15):
        sender.publish("rigs/A1", encode_json(a_block(k)))
    source_of(broker, version=version).start(again.put, stop)
    until(lambda: set(again.numbers()) >= set(range(7, 15)))
    stop.set()
    # The last acknowledgements may have been on their way.
    assert 0 not in again.numbers() and len(again.blocks) < 15
    found, _ = ordered([*taker.blocks[:7], *again.blocks])
    assert np.array_equal(found["position"], positions(15))


def test_a_broker_that_is_killed_loses_nothing_and_tells_nothing_twice(broker, reading, taker, sender):
    source = reading()
    for k in range(40):
        sender.publish("rigs/A1", encode_json(a_block(k)))
        if k == 20:
            until(lambda: len(taker.blocks) >= 10)
            taker.accepting = False
        if k == 30:
            until(lambda: len(set(taker.numbers())) >= 25)
            broker.kill()
            until(lambda: not source.status()["connected"])
            taker.accept()  # of a connection that is gone: acknowledges nothing
            broker.start()
            taker.accepting = True
    until(lambda: set(taker.numbers()) == set(range(40)), 60.0)
    assert source.status()["reconnects"] >= 1 and "connection was lost" in source.status()["last_error"]
    assert len(taker.blocks) > 40, "some came again"
    found, order = ordered(taker.blocks)
    assert np.array_equal(found["position"], positions(40))
    assert order.counts["repeated"] == 10 * (len(taker.blocks) - 40) and order.counts["late"] == 0


@pytest.mark.slow
def test_a_broker_that_comes_later_is_found(broker, start):
    broker.kill()
    source = start(source_of(broker))
    told = until(lambda: source.status()["last_error"])
    assert told == f"mqtt 127.0.0.1:{broker.port}: the broker cannot be reached; check host, port and tls"
    broker.start()
    connected(source)


def test_tls_is_spoken_with_the_authority_that_is_named_and_no_other(broker_of, tmp_path, start):
    (ours, key), (other, _) = certificate(tmp_path, "ours"), certificate(tmp_path, "other")
    broker = broker_of(f"certfile {ours}", f"keyfile {key}", "allow_anonymous true")
    connected(start(source_of(broker, tls={"ca": ours})))
    for wrong in ({"tls": {"ca": other}}, {}):
        source = start(source_of(broker, client_id="wrong", **wrong))
        told = until(lambda source=source: source.status()["last_error"])
        time.sleep(0.3)
        assert not source.status()["connected"] and "\n" not in told


@pytest.fixture
def forgetful(broker_of) -> Broker:
    return broker_of(keeps=False)


@pytest.fixture
def listen(forgetful) -> Iterator[Callable[[], Client]]:
    with ExitStack() as open_ones:
        yield lambda: open_ones.enter_context(closing(Client(forgetful, listens="#")))


@pytest.fixture
def publish(forgetful) -> Iterator[Callable[..., MqttPublisher]]:
    """Starts a publisher, and waits until it is connected unless it is to be refused."""
    with ExitStack() as stops:

        def publisher(
            standing: Any = lambda: (), store: Any = None, connects: bool = True, **given: Any
        ) -> MqttPublisher:
            config = MqttOutput(host="127.0.0.1", port=forgetful.port, prefix="plant/fdd", **given)
            kept = {"outbox": store.outbox, "settle": store.settle} if store else {}
            made = MqttPublisher(config, SimpleNamespace(alarms=lambda states: standing(), **kept))
            stops.callback(made.stop)
            made.start()
            until(lambda: not connects or (made.status()["connected"] and made.connections))
            return made

        yield publisher


def test_what_is_retained_and_what_is_not(publish, listen, version):
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


def test_a_state_is_told_not_too_often(publish, listen, monkeypatch):
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


def test_a_broker_that_was_killed_is_told_everything_again(forgetful, publish, listen, version, store):
    stands = list[dict[str, Any]]()
    publisher = publish(lambda: stands, store, version=version)
    publisher.note("A1", {"state": "healthy"})
    publisher.tick()
    forgetful.kill()
    until(lambda: not publisher.status()["connected"])
    stands.append(transition(id=1, state="ACKED")["alarm"])
    sent(store, "alarm", transition(id=3), "mqtt")
    publisher.once()
    assert publisher.counts["failed"] == 1 and publisher.last_error
    forgetful.start()
    until(lambda: publisher.connections == 2)
    until(lambda: publisher.tick() or publisher.once() or publisher.counts["delivered"])
    late = listen()
    base = "plant/fdd/axis/A1"
    until(lambda: late.of(f"{base}/alarm/3") and late.of(f"{base}/alarm/1") and late.of(f"{base}/state"))
    assert json.loads(late.of(f"{base}/state")[0][0]) == {"state": "healthy"}


def test_a_broken_link_is_told_and_a_store_in_trouble_asked_again(publish, listen):
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


def test_a_wrong_password_is_told_in_one_line(version, forgetful, publish, tmp_path, start):
    users = tmp_path / "users"
    users.write_text("rig:right\n")
    subprocess.run(["mosquitto_passwd", "-U", str(users)], check=True)
    forgetful.kill()
    forgetful.start("allow_anonymous false", f"password_file {users}")
    for word in ("right", "wrong"):
        (tmp_path / word).write_text(f"{word}\n")
    wrong, right = ({"user": "rig", "password_file": tmp_path / word, "version": version}
                    for word in ("wrong", "right"))  # fmt: skip
    source = start(source_of(forgetful, **wrong))
    told = until(lambda: source.status()["last_error"])
    assert told.startswith(f"mqtt 127.0.0.1:{forgetful.port}: the broker refuses the connection (")
    assert told.endswith("check user, password_file and client_id") and "wrong" not in told
    assert not source.status()["connected"]
    connected(start(source_of(forgetful, **right, client_id="other")))
    refused = publish(**wrong, connects=False)
    until(lambda: "refuses" in refused.status()["link_error"])
    assert "Not authorized" in refused.status()["link_error"]
    with pytest.raises(Undelivered, match="refuses the connection"):
        refused.deliver(message("alarm", transition()))
    publish(**right).deliver(message("alarm", transition()))
