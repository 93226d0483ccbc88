"""Status, alarms and findings on an MQTT broker, for whatever else listens in the plant."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import orjson
from paho.mqtt.client import MQTTMessageInfo

from fdd.service.config import MqttOutput
from fdd.service.outputs.targets import Undelivered
from fdd.service.store import OutboxMessage

EVERY_S = 5.0
"""Between two messages about one axis."""
ACKNOWLEDGED_S = 5.0
"""That the broker has for a message."""
MOST_QUEUED = 1000


class MqttPublisher:
    """A client of one broker; paho's own thread keeps it connected.

    Topics: ``PREFIX/status``, ``PREFIX/axis/NAME/state`` and ``PREFIX/axis/NAME/alarm/ID`` are retained,
    ``PREFIX/axis/NAME/finding`` is not. All by QoS 1.

    Parameters
    ----------
    config : broker and prefix. standing : gives the alarms that stand now, for a broker that forgot them.

    Raises
    ------
    InputError : a secret or certificate that cannot be read.
    """

    def __init__(self, config: MqttOutput, standing: Callable[[], Sequence[Mapping[str, Any]]]) -> None:
        self._config, self._standing = config, standing
        self._states: dict[str, bytes] = {}
        self._sent: dict[str, tuple[float, bytes]] = {}
        self._refreshed = self.connections = 0
        self.last_error = ""
        self._client = client = config.client(config.client_id or "")
        client.will_set(f"{config.prefix}/status", b"offline", qos=1, retain=True)
        client.max_queued_messages_set(MOST_QUEUED)
        client.reconnect_delay_set(1, 60)
        client.on_connect, client.on_disconnect = self._connected, self._disconnected

    def start(self) -> None:
        """Connect, now or as soon as the broker is there."""
        self._client.connect_async(self._config.host, self._config.chosen_port, self._config.keepalive)
        self._client.loop_start()

    def stop(self) -> None:
        """Say so, and disconnect."""
        if self._client.is_connected():
            _is_acknowledged(self._publish("status", b"offline"), 1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def status(self) -> dict[str, Any]:
        """How the connection stands."""
        told = {"connected": self._client.is_connected(), "connections": self.connections}
        return {**told, "link_error": self.last_error}

    def deliver(self, message: OutboxMessage) -> None:
        """Send an alarm's transition or a finding, and wait until the broker has it.

        Raises Undelivered: no connection, or no acknowledgement.
        """
        if not self._client.is_connected():
            raise Undelivered(self.last_error or "not connected", down=True)
        if message.kind == "alarm":
            info = self._alarm(message.body["alarm"])
        else:
            topic = f"axis/{message.body['axis']}/{message.kind}"
            info = self._publish(topic, orjson.dumps(message.body), retain=False)
        if not _is_acknowledged(info, ACKNOWLEDGED_S):
            raise Undelivered("not acknowledged by the broker", down=True)

    def note(self, axis: str, state: Mapping[str, Any]) -> None:
        """Take an axis's status; `tick` sends it. An empty one is of an axis that was removed."""
        self._states[axis] = orjson.dumps(dict(state)) if state else b""

    def tick(self) -> None:
        """Send the states that changed, each at most every `EVERY_S`; all of them to a broker that is new."""
        if not self._client.is_connected():
            return
        connection = self.connections
        if self._refreshed != connection:
            for alarm in self._standing():
                self._alarm(alarm)
            self._sent.clear()
            self._refreshed = connection
        now = time.monotonic()
        for axis, state in self._states.items():
            at, last = self._sent.get(axis, (-EVERY_S, b""))
            if state != last and now - at >= EVERY_S:
                self._publish(f"axis/{axis}/state", state)
                self._sent[axis] = now, state

    def _alarm(self, alarm: Mapping[str, Any]) -> MQTTMessageInfo:
        # An empty message makes the broker forget the retained one.
        payload = b"" if alarm["state"] == "NORMAL" else orjson.dumps(dict(alarm))
        return self._publish(f"axis/{alarm['axis']}/alarm/{alarm['id']}", payload)

    def _publish(self, topic: str, payload: bytes, *, retain: bool = True) -> MQTTMessageInfo:
        return self._client.publish(f"{self._config.prefix}/{topic}", payload, qos=1, retain=retain)

    def _connected(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        if reason.is_failure:
            self.last_error = f"the broker refuses the connection: {reason}"
        else:
            self.connections, self.last_error = self.connections + 1, ""
            self._publish("status", b"online")

    def _disconnected(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        # After a refusal its reason says more than that the link went.
        if reason.is_failure and not self.last_error:
            self.last_error = f"disconnected: {reason}"


def _is_acknowledged(info: MQTTMessageInfo, seconds: float) -> bool:
    with suppress(ValueError, RuntimeError):
        info.wait_for_publish(seconds)
        return info.is_published()
    return False
