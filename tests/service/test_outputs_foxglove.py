"""Foxglove live: a client of its WebSocket protocol sees a recording's topics and types, and the values."""

from __future__ import annotations

import base64
import json
import re
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from outputs_fakes import event, measured, transition, until
from websockets.sync.client import ClientConnection, connect

from fdd.errors import InputError
from fdd.logs.mcap_writing import write_annotated
from fdd.samples import Samples
from fdd.service.bus import Bus
from fdd.service.config import FoxgloveOutput
from fdd.service.outputs.foxglove import Foxglove, thinned
from fdd.service.outputs.recorder import trajectories

LAYOUT = Path(__file__).parents[2] / "deploy" / "foxglove" / "fdd.json"
FAMILIES = ("healthy", "leakage", "seal_wear", "aeration", "check_valve", "relief_valve", "friction", "motor",
            "sensor", "unknown")  # fmt: skip
STATUS = {
    "estimates": {n: {"value": v, "std": v / 50} for n, v in (("leakage", 7e-12), ("bulk_modulus", 1e9))},
    "probabilities": dict.fromkeys(FAMILIES, 0.1),
}


def moving(start: float = 0.0, rows: int = 1000) -> Samples:
    time = start + np.arange(rows) / 1000.0
    pressures = dict.fromkeys(("pressure_1", "pressure_2", "pressure_accumulator"), 1000000.0 + time)
    return Samples(time, {"position": np.sin(50.0 * time), **pressures})


@pytest.fixture
def live() -> Iterator[tuple[Foxglove, Bus]]:
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: the extra foxglove")
    bus, stop = Bus(), threading.Event()
    foxglove = Foxglove(FoxgloveOutput(port=0), bus)
    running = threading.Thread(target=foxglove.run, args=(stop,))
    running.start()
    until(lambda: bus._subscriptions)
    yield foxglove, bus
    stop.set()
    running.join(10)
    assert not running.is_alive() and foxglove.last_error == ""


def tell(live: tuple[Foxglove, Bus], axis: str, start: float, alarm: bool = True) -> None:
    """A second of samples; then what the fleet says of it."""
    _, bus = live
    bus.publish(measured(axis, moving(start)))
    bus.publish(event("status", axis, start + 1.0, STATUS))
    if alarm:
        bus.publish(event("alarm", axis, start + 1.0, transition(axis=axis)))


class Client:
    """What Foxglove does, as far as it is wanted here."""

    def __init__(self, link: ClientConnection) -> None:
        self.link, self.channels, self.names, self.got = link, {}, {}, {}

    def until(self, wanted: set[str], of: dict[str, Any]) -> None:
        end = time.monotonic() + 20.0
        while not wanted <= set(of):
            self.take(end - time.monotonic())

    def take(self, timeout: float) -> None:
        message = self.link.recv(timeout)
        if isinstance(message, bytes):
            kind, number, stamp = struct.unpack_from("<BIQ", message)
            assert kind == 1
            self.got.setdefault(self.names[number], []).append((stamp, message[13:]))
        elif (told := json.loads(message))["op"] == "advertise":
            for channel in told["channels"]:
                self.channels[channel["topic"]] = channel
                self.names[channel["id"]] = channel["topic"]
                asked = [{"id": channel["id"], "channelId": channel["id"]}]
                self.link.send(json.dumps({"op": "subscribe", "subscriptions": asked}))

    def messages(self, topic: str) -> list[Any]:
        """Parsed by the schema that was advertised."""
        channel, got = self.channels[topic], [body for _, body in self.got[topic]]
        if channel["encoding"] == "json":
            return [json.loads(body) for body in got]
        files = FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
        pool = DescriptorPool()
        for file in files.file:
            pool.Add(file)
        type_ = GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return [type_.FromString(body) for body in got]


def test_a_client_sees_what_a_recording_would_hold(live: tuple[Foxglove, Bus], tmp_path: Path) -> None:
    topics = {f"/eha/axis_a/{kind}" for kind in ("measurement", "estimate", "diagnosis", "events")}
    tell(live, "axis_a", 100.0, alarm=False)
    with connect(f"ws://127.0.0.1:{live[0].port}", subprotocols=["foxglove.sdk.v1"]) as link:
        client = Client(link)
        client.until(topics, client.channels)
        time.sleep(0.5)  # its subscriptions arrive
        tell(live, "axis_a", 101.0)
        client.until(topics, client.got)
        while len(client.got["/eha/axis_a/measurement"]) < 40 or len(client.got["/eha/axis_a/events"]) < 2:
            client.take(10.0)
    rows = client.messages("/eha/axis_a/measurement")
    wanted = thinned(moving(101.0))
    assert [r.time for r in rows] == wanted["time"].tolist() and len(rows) == 40
    assert [r.position for r in rows] == wanted["position"].tolist()
    stamps = [stamp for stamp, _ in client.got["/eha/axis_a/measurement"]]
    assert abs(stamps[-1] * 1e-9 - time.time()) < 60.0 and np.all(np.diff(stamps) > 0)
    (estimate,) = client.messages("/eha/axis_a/estimate")
    assert (estimate.ekf.leakage, estimate.ekf.bulk_modulus_std) == (7e-12, 2e7)
    assert client.messages("/eha/axis_a/diagnosis")[0].probabilities.unknown == 0.1
    begins, detected = client.messages("/eha/axis_a/events")
    assert " begins " in begins["message"] and " detected " in detected["message"]
    answer = json.dumps({"faults": [transition(axis="axis_a")["alarm"]["body"]]})
    told = trajectories([{**STATUS, "time": 102.0}], 0.0)
    write_annotated(tmp_path / "a.mcap", moving(101.0), told, answer, axis="axis_a")
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    held = {c.topic: summary.schemas[c.schema_id] for c in summary.channels.values()}
    assert set(held) == topics
    for topic, schema in held.items():
        channel = client.channels[topic]
        data = channel["schema"].encode()
        data = base64.b64decode(data) if schema.encoding == "protobuf" else data
        assert (channel["schemaName"], channel["schemaEncoding"]) == (schema.name, schema.encoding)
        assert data == schema.data
    text = LAYOUT.read_text("utf-8")
    for path in re.findall(r'"(/eha/axis_a/[^"]+)"', text):
        topic, *fields = path.split(".")
        value = client.messages(topic)[-1]
        for field in fields:
            value = getattr(value, field)
    assert json.loads(text)["layout"]


def test_peaks_stay_and_slow_signals_go_as_they_are() -> None:
    samples = moving(7.3, 4000)
    samples.columns["position"][2345] = 9.0
    made = thinned(samples)
    assert made["position"].max() == 9.0 and made["time"].size < 200 and np.all(np.diff(made["time"]) > 0)
    slow = Samples(np.arange(10) / 20.0, {"position": np.arange(10.0)})
    assert thinned(slow)["position"].tolist() == list(range(10))


def test_a_port_that_is_taken_is_one_line(live: tuple[Foxglove, Bus]) -> None:
    with pytest.raises(InputError, match=r"outputs: foxglove: cannot listen .*; name a host and a free port"):
        Foxglove(FoxgloveOutput(port=live[0].port), Bus())


def test_without_the_package_it_names_the_extra() -> None:
    program = (
        "import sys; sys.modules['foxglove'] = None\n"
        "from fdd.service.outputs.foxglove import Foxglove\n"
        "try: Foxglove(None, None)\nexcept Exception as error: print(error)"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    wanted = "outputs: foxglove: needs the package foxglove-sdk; install fdd[foxglove]"
    assert told.stdout.strip() == wanted
