"""The MQTT source against a real broker: killed, with passwords, garbage, retained and repeated messages."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from fdd.samples import Samples
from fdd.service.blocks import Block, Decoder, encode_arrow, encode_json
from fdd.service.config_sources import MqttSource
from fdd.service.order import Order
from fdd.service.sources import Source, open_source
from tests.service.brokers import Broker, Client, needs_mosquitto
from tests.service.senders import Taker, a_block, until

pytestmark = needs_mosquitto
VERSIONS = pytest.mark.parametrize("version", ["3.1.1", "5"])


@pytest.fixture
def broker_of(tmp_path: Path) -> Iterator[Callable[..., Broker]]:
    """Starts one with settings of its own."""
    made: list[Broker] = []
    yield lambda *settings: made.append(Broker(tmp_path, *settings)) or made[-1]
    for one in made:
        one.kill()


@pytest.fixture
def broker(broker_of: Callable[..., Broker]) -> Broker:
    return broker_of()


def source_of(broker: Broker, **more: object) -> Source:
    given = {"type": "mqtt", "host": "127.0.0.1", "port": broker.port, "topics": ["rigs/#"]}
    return open_source(MqttSource.model_validate({**given, "client_id": "fdd-test", **more}))


@pytest.fixture
def sender(broker: Broker) -> Iterator[Client]:
    client = Client(broker, client_id="sender", clean_session=False)
    yield client
    client.close()


def connected(source: Source, taker: Taker, stop: threading.Event) -> Source:
    source.start(taker.put, stop)
    until(lambda: source.status()["connected"])
    return source


Reading = Callable[..., Source]


@pytest.fixture
def reading(broker: Broker, taker: Taker, stop: threading.Event) -> Reading:
    """Makes a source of the broker, which gives the taker what comes."""
    return lambda **more: connected(source_of(broker, **more), taker, stop)


def ordered(blocks: list[Block]) -> tuple[Samples, Order]:
    order = Order()
    return Samples.concatenate([*(order.take([b]) for b in blocks), order.flush()]), order


@VERSIONS
def test_topics_with_wildcards_name_the_axis_or_the_message_does(
    version: str, reading: Reading, taker: Taker, sender: Client
) -> None:
    source = reading(version=version, topics=["rigs/{axis}/x/#", "all/+"])
    without = encode_json(a_block(0)).replace(b'"axis":"A1",', b"")
    sender.publish("rigs/R1/x/deep/er", without)
    sender.publish("rigs/R2/x", encode_arrow(a_block(0, "R2")))
    sender.publish("rigs/R5/x", without)
    sender.publish("rigs/R3/x", encode_json(a_block(0, "R9")))
    sender.publish("rigs/R4/y", without)
    sender.publish("all/one", encode_json(a_block(0, "A7")))
    sender.publish("all/two", without)
    until(lambda: source.status()["received"] == 4 and source.status()["refused"] == 2)
    assert sorted(b.axis for b in taker.blocks) == ["A7", "R1", "R2", "R5"]
    assert np.array_equal(taker.joined("R2")["position"], a_block(0).samples["position"])


@VERSIONS
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
    source, bad = (
        reading(version=version),
        (b"", b"garbage", b"fault", b"\xff\xff\xff\xff\x10", b'{"schema": 3}'),
    )
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


@VERSIONS
def test_acknowledgements_go_in_the_order_in_which_messages_came(
    version: str, broker_of: Callable[..., Broker], tmp_path: Path, taker: Taker, stop: threading.Event
) -> None:
    """Else mosquitto before 2.0.13 sends new messages before those that wait for room on their way."""
    log, random = tmp_path / "log", np.random.default_rng(1)
    broker = broker_of("allow_anonymous true", f"log_dest file {log}", "log_type all")
    connected(source_of(broker, version=version, topics=["rigs/{axis}"]), taker, stop)
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
    sent, acknowledged = (
        lambda what=what: re.findall(rf"{what} fdd-test \(.*?[mM](?:id: )?(\d+)", log.read_text())
        for what in ("Sending PUBLISH to", "Received PUBACK from")
    )
    until(lambda: len(acknowledged()) == 360)
    assert acknowledged() == sent()
    sender.close()


@VERSIONS
def test_nothing_is_acknowledged_before_it_is_accepted(
    version: str, broker: Broker, taker: Taker, stop: threading.Event, sender: Client
) -> None:
    taker.accepting = False
    source = connected(source_of(broker, version=version), taker, stop)
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
    connected(source_of(broker, version=version), again, stop)
    until(lambda: set(again.numbers()) >= set(range(7, 15)))
    stop.set()
    # The last acknowledgements may have been on their way.
    assert 0 not in again.numbers() and len(again.blocks) < 15
    found, _ = ordered([*taker.blocks[:7], *again.blocks])
    assert np.array_equal(
        found["position"], np.concatenate([a_block(k).samples["position"] for k in range(15)])
    )


@VERSIONS
def test_a_broker_that_is_killed_loses_nothing_and_tells_nothing_twice(
    version: str, broker: Broker, reading: Reading, taker: Taker, sender: Client
) -> None:
    source = reading(version=version)
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
    wanted = np.concatenate([a_block(k).samples["position"] for k in range(40)])
    assert np.array_equal(found["position"], wanted)
    assert order.counts["repeated"] == 10 * (len(taker.blocks) - 40) and order.counts["late"] == 0


def test_a_broker_that_comes_later_is_found(broker: Broker, taker: Taker, stop: threading.Event) -> None:
    broker.kill()
    source = source_of(broker)
    source.start(taker.put, stop)
    told = until(lambda: source.status()["last_error"])
    where = f"mqtt 127.0.0.1:{broker.port}"
    assert told == f"{where}: the broker cannot be reached; check host, port and tls"
    broker.start()
    until(lambda: source.status()["connected"])


@VERSIONS
def test_a_wrong_password_is_told_in_one_line(
    version: str, broker_of: Callable[..., Broker], tmp_path: Path, taker: Taker, stop: threading.Event
) -> None:
    (tmp_path / "users").write_text("rig:right\n")
    subprocess.run(["mosquitto_passwd", "-U", str(tmp_path / "users")], check=True)
    broker = broker_of("allow_anonymous false", f"password_file {tmp_path / 'users'}")
    (tmp_path / "password").write_text("wrong\n")
    given = {"user": "rig", "password_file": tmp_path / "password", "version": version}
    source = source_of(broker, **given)
    source.start(taker.put, stop)
    told = until(lambda: source.status()["last_error"])
    assert told.startswith(f"mqtt 127.0.0.1:{broker.port}: the broker refuses the connection (")
    assert told.endswith("check user, password_file and client_id") and "wrong" not in told
    assert not source.status()["connected"]
    (tmp_path / "password").write_text("right\n")
    connected(source_of(broker, **given, client_id="other"), taker, stop)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here")
def test_tls_is_spoken_with_the_authority_that_is_named_and_no_other(
    broker_of: Callable[..., Broker], tmp_path: Path, taker: Taker, stop: threading.Event
) -> None:
    for name in ("ours", "other"):
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
             "-days", "2", "-subj", f"/CN={name}", "-addext", "subjectAltName=IP:127.0.0.1",
             "-keyout", f"{name}.key", "-out", f"{name}.pem"], check=True, capture_output=True, cwd=tmp_path,
        )  # fmt: skip
    files = (f"certfile {tmp_path / 'ours.pem'}", f"keyfile {tmp_path / 'ours.key'}")
    broker = broker_of(*files, "allow_anonymous true")
    connected(source_of(broker, tls={"ca": tmp_path / "ours.pem"}), taker, stop)
    for wrong in ({"tls": {"ca": tmp_path / "other.pem"}}, {}):
        source = source_of(broker, client_id="wrong", **wrong)
        source.start(taker.put, stop)
        told = until(lambda source=source: source.status()["last_error"])
        time.sleep(0.3)
        assert not source.status()["connected"] and "\n" not in told
