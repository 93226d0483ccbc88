"""A real broker for tests, and a client of it; they skip where mosquitto is not there."""

from __future__ import annotations

import signal
import socket
import subprocess
import threading
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest

from reports.service import MOSQUITTO, free_port
from tests.service.senders import until

needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto here")


class Broker:
    """A mosquitto that keeps its sessions on disk, or nothing."""

    def __init__(self, folder: Path, *settings: str, keeps: bool = True) -> None:
        self.port = free_port()
        self._config, self._keeps = folder / "mosquitto.conf", keeps
        self.start(*(settings or ("allow_anonymous true",)))

    def start(self, *settings: str) -> None:
        """Start it, with other settings where they are given, and wait until it listens."""
        assert MOSQUITTO is not None
        if settings:
            kept = ("persistence true", f"persistence_location {self._config.parent}/", "autosave_interval 1",
                    "autosave_on_changes true", "max_queued_messages 10000")  # fmt: skip
            lines = (f"listener {self.port} 127.0.0.1", "user root", *kept * self._keeps, *settings, "")
            self._config.write_text("\n".join(lines))
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(self._config)], stderr=subprocess.DEVNULL)
        until(self._listens)

    def kill(self) -> None:
        """End it at once."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


class Client:
    """Publishes at QoS 1, and notes what comes of the topics that it listens to."""

    def __init__(self, broker: Broker, listens: str = "", **session: Any) -> None:
        self.came: list[paho.MQTTMessage] = []
        self._client = client = paho.Client(paho.CallbackAPIVersion.VERSION2, **session)
        client.reconnect_delay_set(0.1, 0.2)  # type: ignore[arg-type]
        client.max_inflight_messages_set(10)
        subscribed = threading.Event()
        client.on_subscribe = lambda *told: subscribed.set()
        client.on_message = lambda c, data, message: self.came.append(message)
        client.on_connect = lambda c, *told: c.subscribe(listens, qos=1) if listens else None
        client.connect("127.0.0.1", broker.port)
        client.loop_start()
        assert not listens or subscribed.wait(60.0), "else what is not retained may come before it listens"

    def publish(self, topic: str, payload: bytes, **more: Any) -> paho.MQTTMessageInfo:
        return self._client.publish(topic, payload, **{"qos": 1, **more})

    def of(self, topic: str) -> list[tuple[bytes, bool]]:
        """Payloads of a topic, and whether each was retained."""
        return [(m.payload, m.retain) for m in self.came if m.topic == topic]

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
