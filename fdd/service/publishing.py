"""Logs published to an MQTT broker as blocks, as rigs would send them: late, overtaken or lost."""

from __future__ import annotations

import os
import queue
import socket
import threading
import zlib
from collections.abc import Iterable

import numpy as np
from paho.mqtt.reasoncodes import ReasonCode

from fdd.errors import InputError
from fdd.monitor import WallClock, pieces
from fdd.samples import Samples
from fdd.service.blocks import Block, encode_arrow
from fdd.service.config_sources import Broker

ANSWER_S = 30.0
"""s that a broker has to take a connection, and each next block at the end."""


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
