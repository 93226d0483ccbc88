"""Who sends: a leaking axis as blocks over TCP or MQTT, and the broker between."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho

from evidence.troubles.process import AXIS, free_port, until
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block, encode_json
from fdd.unit import Unit

ROWS = 100
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")


@cache
def leaking(duration: float = 60.0) -> Samples:
    """A run of a shipped axis that leaks from its middle on, 1 kHz."""
    leak = {"fault": "internal_leakage", "severity": 0.8, "onset": duration / 2}
    scenario = Scenario(duration=duration, load={"name": "spring"}, faults=[leak], seed=5)
    return simulate(Unit.load("axis_a"), scenario).samples


def blocks_of(samples: Samples) -> list[Block]:
    """Numbered blocks of a tenth of a second."""
    starts = range(0, len(samples), ROWS)
    return [Block(AXIS, samples.rows(k, k + ROWS), k // ROWS, "", 0.0) for k in starts]


def shifted(blocks: Sequence[Block], seconds: float) -> list[Block]:
    """The same by a sender's clock that was set."""
    return [replace(b, samples=Samples(b.samples.time + seconds, b.samples.columns)) for b in blocks]


class Tcp:
    """A sender of lines; it waits where the service does not take more."""

    def __init__(self) -> None:
        self.port = free_port()
        self.source: dict[str, Any] = {"type": "tcp", "port": self.port}

    def connect(self) -> None:
        self._link = socket.create_connection(("127.0.0.1", self.port), 10.0)
        self._link.settimeout(300.0)

    def send(self, blocks: Sequence[Block]) -> None:
        for block in blocks:
            self._link.sendall(encode_json(block) + b"\n")

    def close(self) -> None:
        self._link.close()


class Mqtt:
    """A broker that keeps its sessions on disk, and a sender at QoS 1."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self._config = folder / "mosquitto.conf"
        settings = (f"listener {self.port} 127.0.0.1", "allow_anonymous true", "persistence true",
                    f"persistence_location {folder}/", "max_queued_messages 100000", "user root")  # fmt: skip
        self._config.write_text("\n".join(settings) + "\n")
        self.source: dict[str, Any] = {
            "type": "mqtt", "host": "127.0.0.1", "port": self.port, "topics": ["rigs/{axis}"],
        }  # fmt: skip
        self.start()

    def start(self) -> None:
        """Start the broker, and wait until it listens."""
        assert MOSQUITTO is not None
        self.broker = subprocess.Popen([MOSQUITTO, "-c", str(self._config)], stderr=subprocess.DEVNULL)
        until(self._listens, 20.0)

    def stop(self) -> None:
        """End the broker; it writes what it keeps."""
        self.broker.send_signal(signal.SIGTERM)
        self.broker.wait()

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def connect(self) -> None:
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="sender", clean_session=False)
        self._client.reconnect_delay_set(1, 2)
        self._client.connect("127.0.0.1", self.port)
        self._client.loop_start()

    def send(self, blocks: Sequence[Block]) -> None:
        for block in blocks:
            self._client.publish(f"rigs/{block.axis}", encode_json(block), qos=1)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        self.stop()
