"""The MQTT source against a real broker: killed, with passwords, garbage, retained and repeated messages."""

from __future__ import annotations

import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from fdd.service.blocks import Block, Decoder, encode_arrow, encode_json
from fdd.service.config_sources import MqttSource
from fdd.service.sources import Source, open_source
from tests.service.brokers import Broker, Client, needs_mosquitto
from tests.service.senders import Taker, a_block, certificate, ordered, until

pytestmark = needs_mosquitto
Brokers = Callable[..., Broker]


@pytest.fixture(params=["3.1.1", "5"])
def version(request: pytest.FixtureRequest) -> str:
    """Of the protocol."""
    return str(request.param)


@pytest.fixture
def broker_of(tmp_path: Path) -> Iterator[Brokers]:
    """Starts one with settings of its own."""
    made: list[Broker] = []
    yield lambda *settings: made.append(Broker(tmp_path, *settings)) or made[-1]
    for one in made:
        one.kill()


@pytest.fixture
def broker(broker_of: Brokers) -> Broker:
    return broker_of()


def source_of(broker: Broker, **more: object) -> Source:
    given = {"type": "mqtt", "host": "127.0.0.1", "port": broker.port, "topics": ["rigs/#"]}
    return open_source(MqttSource.model_validate({**given, "client_id": "fdd-test", **more}))


@pytest.fixture
def sender(broker: Broker) -> Iterator[Client]:
    with closing(Client(broker, client_id="sender", clean_session=False)) as client:
        yield client


def connected(source: Source) -> Source:
    until(lambda: source.status()["connected"])
    return source


Start, Reading = Callable[[Source], Source], Callable[..., Source]


@pytest.fixture
def reading(broker: Broker, start: Start, version: str) -> Reading:
    """Makes a source of the broker, which gives the taker what comes."""
    return lambda **more: connected(start(source_of(broker, version=version, **more)))


def positions(count: int) -> np.ndarray:
    """Of the first blocks."""
    return np.concatenate([a_block(k).samples["position"] for k in range(count)])


def test_topics_with_wildcards_or_the_message_name_the_axis(
    reading: Reading, taker: Taker, sender: Client
) -> None:
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


def test_garbage_faults_of_fdd_and_retained_messages_are_counted_and_hold_up_nothing(
    version: str, reading: Reading, taker: Taker, sender: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(self: Decoder, payload: bytes, *given: object, **more: object) -> Block:
        if payload == b"fault":
            raise RuntimeError("a fault")
        return decode(self, payload, *given, **more)  # type: ignore[arg-type]

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


def test_acknowledgements_go_in_the_order_in_which_messages_came(
    version: str, broker_of: Brokers, tmp_path: Path, taker: Taker, start: Start
) -> None:
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


def test_nothing_is_acknowledged_before_it_is_accepted(
    version: str, broker: Broker, reading: Reading, taker: Taker, stop: threading.Event, sender: Client
) -> None:
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


def test_a_broker_that_is_killed_loses_nothing_and_tells_nothing_twice(
    broker: Broker, reading: Reading, taker: Taker, sender: Client
) -> None:
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


def test_a_broker_that_comes_later_is_found(broker: Broker, start: Start) -> None:
    broker.kill()
    source = start(source_of(broker))
    told = until(lambda: source.status()["last_error"])
    assert told == f"mqtt 127.0.0.1:{broker.port}: the broker cannot be reached; check host, port and tls"
    broker.start()
    connected(source)


def test_a_wrong_password_is_told_in_one_line(
    version: str, broker_of: Brokers, tmp_path: Path, start: Start
) -> None:
    (tmp_path / "users").write_text("rig:right\n")
    subprocess.run(["mosquitto_passwd", "-U", str(tmp_path / "users")], check=True)
    broker = broker_of("allow_anonymous false", f"password_file {tmp_path / 'users'}")
    (tmp_path / "password").write_text("wrong\n")
    given = {"user": "rig", "password_file": tmp_path / "password", "version": version}
    source = start(source_of(broker, **given))
    told = until(lambda: source.status()["last_error"])
    assert told.startswith(f"mqtt 127.0.0.1:{broker.port}: the broker refuses the connection (")
    assert told.endswith("check user, password_file and client_id") and "wrong" not in told
    assert not source.status()["connected"]
    (tmp_path / "password").write_text("right\n")
    connected(start(source_of(broker, **given, client_id="other")))


def test_tls_is_spoken_with_the_authority_that_is_named_and_no_other(
    broker_of: Brokers, tmp_path: Path, start: Start
) -> None:
    (ours, key), (other, _) = certificate(tmp_path, "ours"), certificate(tmp_path, "other")
    broker = broker_of(f"certfile {ours}", f"keyfile {key}", "allow_anonymous true")
    connected(start(source_of(broker, tls={"ca": ours})))
    for wrong in ({"tls": {"ca": other}}, {}):
        source = start(source_of(broker, client_id="wrong", **wrong))
        told = until(lambda source=source: source.status()["last_error"])
        time.sleep(0.3)
        assert not source.status()["connected"] and "\n" not in told
