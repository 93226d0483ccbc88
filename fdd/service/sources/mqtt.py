"""Blocks from an MQTT broker, acknowledged when they are stored: a restart of either side loses none."""

from __future__ import annotations

import random
import socket
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import paho.mqtt.client as paho
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from fdd.bounds import MAX_BLOCK_BYTES
from fdd.errors import InputError
from fdd.service.blocks import Decoder, axis_name
from fdd.service.config_sources import MqttSource
from fdd.service.sources.source import Source

_LONGEST_WAIT_S = 60
"""s between attempts to connect; they begin with some 1 s and double."""
_ON_THEIR_WAY = 400
"""Messages that the broker may send before the first is acknowledged (MQTT 5; else it decides itself): more
than the fleet stores at once, few enough for the inbox with blocks of 0.5 MB."""
_TOPIC_BYTES = 65_600
"""Of a message besides its payload."""
_NO_RETAINED = 2


@dataclass
class _Coming:
    """A message that is not acknowledged yet."""

    message: paho.MQTTMessage
    done: bool = False


class Mqtt(Source[MqttSource]):
    """Blocks of the topics that are subscribed to, at QoS 1 in a session that the broker keeps.

    A message is done when the fleet calls `Block.accepted`, or at once where it is no block, and acknowledged
    when those that came before it are too. What was not acknowledged comes again after a reconnection, and
    the axis's `Order` knows it. A retained message is a copy of the past and is passed over.
    """

    def __init__(self, config: MqttSource) -> None:
        super().__init__(config)
        self._decoder = Decoder(self._map)
        # As they are subscribed to, and which level names the axis.
        self._filters = [
            (topic.replace("{axis}", "+"), topic.split("/").index("{axis}") if "{axis}" in topic else None)
            for topic in config.topics
        ]
        # Of one connection: numbers mean nothing on the next one. Acknowledged in the order they came, as
        # MQTT demands (4.6): mosquitto before 2.0.13 else lets new messages overtake those that it holds.
        self._waiting = deque[_Coming]()
        self._acknowledging = threading.Lock()
        self._was_connected = self._was_refused = False

    def check(self) -> None:
        """Refuse a password file, certificate or key that cannot be used."""
        self._config.client("check")

    def _begin(self, stop: threading.Event) -> None:
        config, is_5 = self._config, self._config.version == "5"
        session: Properties | None = None
        if is_5:
            session = Properties(PacketTypes.CONNECT)
            session.SessionExpiryInterval = round(3600 * config.session_hours)
            session.ReceiveMaximum = _ON_THEIR_WAY
            session.MaximumPacketSize = MAX_BLOCK_BYTES + _TOPIC_BYTES
        name = config.client_id or f"fdd-{socket.gethostname()}-{self.name}"
        client = config.client(name, clean_session=None if is_5 else False, manual_ack=True)
        self._client = client
        client.on_connect, client.on_subscribe = self._connected, self._subscribed
        client.on_connect_fail, client.on_disconnect = self._not_connected, self._disconnected
        client.on_message = self._message
        # Many clients that lost one broker must not come back in the same instant.
        client.reconnect_delay_set(random.uniform(0.5, 1.5), _LONGEST_WAIT_S)  # type: ignore[arg-type]
        client.connect_async(
            config.host, config.chosen_port, config.keepalive, properties=session,
            clean_start=False if is_5 else paho.MQTT_CLEAN_START_FIRST_ONLY,
        )  # fmt: skip
        client.loop_start()
        self._spawn(self._until, stop)

    def _until(self, stop: threading.Event) -> None:
        stop.wait()
        self._client.disconnect()
        self._client.loop_stop()
        self._set(connected=False)

    def _trouble(self, problem: str, mend: str) -> None:
        self._told(InputError(problem, where=self._config.shown, mend=mend))

    def _connected(self, client: Any, data: Any, flags: Any, reason: ReasonCode, more: Any) -> None:
        self._was_refused = reason.is_failure
        if reason.is_failure:
            problem = f"the broker refuses the connection ({reason.getName()})"
            self._trouble(problem, "check user, password_file and client_id")
            return
        self._forget()
        if self._was_connected:
            self._count("reconnects")
        self._was_connected = True
        is_5 = self._config.version == "5"
        wanted: Any = SubscribeOptions(qos=1, retainHandling=_NO_RETAINED) if is_5 else 1
        client.subscribe([(topic, wanted) for topic, _ in self._filters])

    def _subscribed(self, client: Any, data: Any, number: int, reasons: list[ReasonCode], more: Any) -> None:
        for topic, reason in zip(self._config.topics, reasons, strict=False):
            if reason.is_failure:
                problem = f"the broker refuses the topic {topic[:100]} ({reason.getName()})"
                self._trouble(problem, "give this user the right to read it")
        self._set(connected=not all(reason.is_failure for reason in reasons))

    def _not_connected(self, client: Any, data: Any) -> None:
        self._trouble("the broker cannot be reached", "check host, port and tls")
        self._set(connected=False)

    def _disconnected(self, client: Any, data: Any, flags: Any, reason: ReasonCode, more: Any) -> None:
        self._forget()
        self._set(connected=False)
        if reason.is_failure and not self._was_refused:
            mend = "it is tried again; if it never holds, check port, tls and client_id"
            self._trouble(f"the connection was lost ({reason.getName()})", mend)

    def _message(self, client: Any, data: Any, message: paho.MQTTMessage) -> None:
        with self._acknowledging:
            waiting, mine = self._waiting, _Coming(message)
            waiting.append(mine)

        def done() -> None:
            with self._acknowledging:
                mine.done = True
                while waiting is self._waiting and waiting and waiting[0].done:
                    first = waiting.popleft().message
                    self._client.ack(first.mid, first.qos)

        if message.retain:
            self._count("retained")
            done()
            return
        try:
            topic = message.topic
        except UnicodeDecodeError:
            topic = ""
        named = (k for kind, k in self._filters if k is not None and paho.topic_matches_sub(kind, topic))
        level = next(named, None)
        try:
            axis = None if level is None else axis_name(topic.split("/")[level])
            payload = bytes(message.payload)
            self.take(self._decoder.decode(payload, axis=axis, patient=True, accepted=done))
        except InputError as error:
            self.refuse(error.at(f"topic {topic[:100]}"))
            done()
        except Exception as error:  # a fault of fdd; paho's thread and the messages after it must go on
            self.refuse(InputError(f"internal error: {type(error).__name__}: {error}"))
            done()

    def _forget(self) -> None:
        with self._acknowledging:
            self._waiting = deque()
