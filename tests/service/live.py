"""Logs published to a broker and watched by a whole service: what came, and what it says of that."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho

from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.model import Model
from fdd.samples import Samples
from fdd.service.axis import AxisWatch
from fdd.service.blocks import Block, Decoder
from fdd.service.config import Serve
from fdd.service.service import Service
from fdd.service.status import AxisStatus
from fdd.service.store import Store
from fdd.unit import Unit
from tests.service.senders import until


@dataclass(frozen=True)
class Live:
    """One axis.

    Attributes
    ----------
    came : its blocks as another subscriber of the broker heard them. findings : bodies, in the order they
        were stored. answer : that the stored state of its pipeline gives.
    """

    came: list[Block]
    findings: list[dict[str, Any]]
    answer: Diagnosis
    status: AxisStatus

    @property
    def samples(self) -> Samples:
        """All that came, in the sender's order."""
        return Samples.concatenate([b.samples for b in sorted(self.came, key=lambda b: b.sequence or 0)])


def watched(
    folder: Path, port: int, profile: str, publish: Callable[[], None], patience: float
) -> dict[str, Live]:
    """What a service with its state in `folder` says of the blocks that `publish` sends below ``fdd/``.

    Parameters
    ----------
    port : of the broker. profile : of all axes. patience : s that the service has after the last block.
    """
    config = Serve.from_yaml(
        f"schema: fdd.serve/1\nfallback: {profile}\nlisten: {{port: 0}}\nsources:\n"
        f"- {{type: mqtt, host: 127.0.0.1, port: {port}, topics: ['fdd/{{axis}}/blocks']}}\n",
        folder=folder,
    )  # fmt: skip
    service, stop, heard = Service(config), threading.Event(), Heard(port)
    running = threading.Thread(target=service.run, args=(stop,))
    running.start()
    try:
        until(lambda: service.health()["status"] == "ok")
        publish()
        came = heard.blocks()
        rows = {axis: sum(len(b.samples) for b in blocks) for axis, blocks in came.items()}
        until(lambda: {s.name: s.samples + s.quality["late"] for s in service.fleet.axes()} == rows, patience)
        status = {s.name: s for s in service.fleet.axes()}
    finally:
        stop.set()
        running.join(60.0)
        heard.close()
    store = Store(config.store_url)
    try:
        return {
            axis: Live(
                blocks,
                [f["body"] for f in store.findings() if f["axis"] == axis][::-1],
                answer_of(store, axis, profile),
                status[axis],
            )
            for axis, blocks in came.items()
        }
    finally:
        store.close()


def answer_of(store: Store, axis: str, profile: str) -> Diagnosis:
    """The answer at the end of the stream, by the axis's checkpoint."""
    checkpoint = store.checkpoint(axis)
    assert checkpoint is not None
    watch = AxisWatch(axis, Unit.load(profile), Model.load())
    watch.restore(checkpoint)
    return watch.pipeline.finish()


class Heard:
    """A second subscriber."""

    def __init__(self, port: int) -> None:
        self._payloads: list[bytes] = []
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="heard")
        self._client.on_message = lambda client, data, message: self._payloads.append(message.payload)
        subscribed = threading.Event()
        self._client.on_subscribe = lambda *told: subscribed.set()
        self._client.connect("127.0.0.1", port)
        self._client.subscribe("fdd/#", qos=1)
        self._client.loop_start()
        assert subscribed.wait(20.0)

    def blocks(self) -> dict[str, list[Block]]:
        """By axis, in the order they came, once nothing has come for a second."""
        count = -1
        while count < len(self._payloads):
            count = len(self._payloads)
            threading.Event().wait(1.0)
        found: dict[str, list[Block]] = {}
        for block in map(Decoder().decode, self._payloads):
            found.setdefault(block.axis, []).append(block)
        return found

    def close(self) -> None:
        """Go."""
        self._client.disconnect()
        self._client.loop_stop()
