"""Blocks over MQTT: a source that acknowledges what is stored, and logs published as rigs would send them."""

from __future__ import annotations

import os
import queue
import random
import socket
import threading
import zlib
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import paho.mqtt.client as paho
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from fdd.bounds import MAX_BLOCK_BYTES
from fdd.errors import InputError
from fdd.monitor import WallClock, pieces
from fdd.samples import Samples
from fdd.service.blocks import Block, Decoder, axis_name, encode_arrow
from fdd.service.config_sources import Broker, MqttSource
from fdd.service.sources import Source

_LONGEST_WAIT_S = 60
"""s between attempts to connect; they begin with some 1 s and double."""
_ON_THEIR_WAY = 400
"""Messages that the broker may send before the first is acknowledged (MQTT 5; else it decides itself): more
than the fleet stores at once, few enough for the inbox with blocks of 0.5 MB."""
_TOPIC_BYTES = 65_600
"""Of a message besides its payload."""
_NO_RETAINED = 2
ANSWER_S = 30.0
"""s that a broker has to take what is published: a connection, and each next block at the end."""


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


def sendings(
    axis: str, samples: Samples, speed: float = 1.0, jitter: float = 0.0, loss: float = 0.0, shuffle: int = 1,
    seed: int = 0,
) -> list[tuple[float, Block]]:  # fmt: skip
    """When (s from the start) each block of a log is sent, in that order, without those that are lost.

    `speed`: times real time, inf sends all at once. `jitter`: s that a block is held up at most, and those
    behind it. `loss`: share of blocks that never come. `shuffle`: so many neighbours come in any order.
    """
    # The name too: axes must not lose the same blocks.
    rng = np.random.default_rng([seed, zlib.crc32(axis.encode())])
    blocks = [Block(axis, part, number, 0.0) for number, part in enumerate(pieces(samples))]
    numbers = np.arange(len(blocks))
    order = np.lexsort((rng.random(numbers.size), numbers // shuffle))
    ends = np.array([blocks[k].samples.time[-1] - samples.time[0] for k in order])
    # A connection keeps its order: what is held up holds up the blocks behind it.
    due = np.maximum.accumulate(ends / speed + rng.uniform(0.0, jitter, numbers.size))
    comes = rng.random(numbers.size) >= loss
    return [(float(due[k]), blocks[n]) for k, n in enumerate(order) if comes[k]]


def publish(broker: Broker, topic: str, sent: Iterable[tuple[float, Block]], stop: threading.Event) -> None:
    """Send blocks at their times (s from the start), in that order, at QoS 1, until the broker has them all
    or `stop` is set. ``{axis}`` in the topic becomes the axis's name.

    Raises InputError: the broker cannot be reached, refuses the connection, or does not take the blocks.
    """
    # Made before the first is sent: it takes longer than sending.
    messages = [(when, topic.replace("{axis}", block.axis), encode_arrow(block)) for when, block in sent]
    client = broker.client(broker.client_id or f"fdd-publish-{socket.gethostname()}-{os.getpid()}")
    connected: queue.Queue[ReasonCode] = queue.Queue()
    taken: queue.Queue[ReasonCode] = queue.Queue()
    client.on_connect = lambda client, data, flags, reason, more: connected.put(reason)
    client.on_publish = lambda client, data, number, reason, more: taken.put(reason)

    def require(answers: queue.Queue[ReasonCode], problem: str, mend: str) -> None:
        """Wait for what the broker answers next; after `stop` whatever it is."""
        try:
            reason = answers.get(timeout=ANSWER_S)
            refused = reason.getName() if reason.is_failure else ""
        except queue.Empty:
            refused = "no answer"
        if refused and not stop.is_set():
            raise InputError(f"{problem} ({refused})", where=broker.shown, mend=mend)

    try:
        client.connect(broker.host, broker.chosen_port, broker.keepalive)
    except OSError as error:
        problem = f"the broker cannot be reached ({error.strerror or error})"
        raise InputError(problem, where=broker.shown, mend="check host and port") from None
    client.loop_start()
    try:
        require(connected, "the broker refuses the connection", "check the user and its password")
        clock = WallClock(stop)
        begun = clock.now()
        for when, place, payload in messages:
            clock.sleep(begun + when - clock.now())
            if stop.is_set():
                return
            client.publish(place, payload, qos=1)
        for number in range(len(messages)):
            problem = f"the broker took {number} of {len(messages)} blocks"
            require(taken, problem, "give this user the right to publish there")
            if stop.is_set():
                return
    finally:
        client.disconnect()
        client.loop_stop()
