"""What must arrive, from the store's outbox to webhooks and an MQTT broker, each in a thread of its own."""

from __future__ import annotations

import hashlib
import hmac
import random
import re
import ssl
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from email.utils import parsedate_to_datetime
from typing import Any
from urllib.parse import urlsplit

import httpx
import orjson
from paho.mqtt.client import MQTTMessageInfo

from fdd import __version__
from fdd.service import config
from fdd.service.alarms import STANDING
from fdd.service.config_sources import read_secret
from fdd.service.queues import Bus, Kind
from fdd.service.store import OutboxMessage, Store

MOST_TAKEN = 200
"""Messages looked at in one go."""
MOST_ATTEMPTS = 20
"""Of a message that the target refuses for now, some two hours; while the target is down none is counted."""
LONGEST_WAIT_S = 600.0
LONGEST_ASKED_S = 86400.0
"""Of what a target may ask for by Retry-After."""
LOOK_S = 0.5
"""Between two looks into the outbox."""
TROUBLE_S = 5.0
"""Rest after a failure that no one foresaw, such as a store that is locked."""
KINDS: tuple[Kind, ...] = ("alarm", "finding")
"""What goes through the outbox."""
TIMEOUT_S = 5.0
"""For each answer of the network, a broker's acknowledgement too."""
MOST_ANSWER_BYTES = 1024
"""Of an answer's body, for the log; the rest is not read."""
EVERY_S = 5.0
"""Between two messages to a broker about one axis."""
MOST_QUEUED = 1000


class Undelivered(Exception):
    """A message did not arrive, and (`final`) never will, or the target takes nothing now (`down`) or for
    `wait_s` seconds."""

    def __init__(self, problem: str, *, wait_s: float = 0.0, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.wait_s, self.final, self.down = min(wait_s, LONGEST_ASKED_S), final, down


class Target(ABC):
    """One receiver of messages, in their order and each at least once: one that fails holds back the next.

    `kinds` of messages are sent to it; one that `is_live` takes statuses (`note`), and hears what a
    chattering alarm does. `counts`: messages delivered, attempts failed, messages given up, those that wait
    (at most `MOST_TAKEN`) and live events lost, so far. `last_error`: "" while all is well.
    """

    kinds: Sequence[Kind] = KINDS
    is_live = False

    def __init__(self, name: str, store: Store) -> None:
        self.name, self._store = name, store
        self._failures, self._rests_until = 0, 0.0
        self.counts = dict.fromkeys(("delivered", "failed", "given_up", "pending", "lost"), 0)
        self.last_error = ""

    @abstractmethod
    def deliver(self, message: OutboxMessage) -> None:
        """Send one message. Raises Undelivered: it did not arrive."""

    def note(self, axis: str, state: Mapping[str, Any]) -> None:  # noqa: B027 (most take none)
        """Take an axis's live status."""

    def tick(self) -> None:  # noqa: B027 (most need none)
        """Called now and then."""

    def status(self) -> dict[str, Any]:
        """Counts and the last error."""
        return {**self.counts, "last_error": self.last_error}

    def once(self, stopped: Callable[[], bool] = lambda: False) -> None:
        """Deliver what waits, up to the first message that fails."""
        if time.monotonic() < self._rests_until:
            return
        messages = self._store.outbox(MOST_TAKEN, self.name)
        self.counts["pending"] = len(messages)
        for message in messages:
            if stopped():
                return
            try:
                self.deliver(message)
            except Exception as error:  # one that no target can take must not stop all others for ever
                if not self._is_given_up(message, error):
                    return
            else:
                self._store.settle(message.id, done=True)
                self.counts["delivered"] += 1
                self._failures = 0
            self.counts["pending"] -= 1
        self.last_error = ""

    def _is_given_up(self, message: OutboxMessage, error: Exception) -> bool:
        """Give up, or rest before the next attempt; which of them."""
        if not isinstance(error, Undelivered):
            error = Undelivered(f"{type(error).__name__}: {error}")
        self.counts["failed"] += 1
        self.last_error = str(error)
        attempts = message.attempts + 1
        if error.final or (attempts >= MOST_ATTEMPTS and not error.down):
            never = f"{message.kind} {message.id} never arrived at {self.name}"
            self._store.settle(message.id, done=True, why=f"{never} ({attempts} attempts: {error})")
            self.counts["given_up"] += 1
            return True
        if not error.down:
            self._store.settle(message.id, done=False)
        self._failures += 1
        wait = min(LONGEST_WAIT_S, 2.0 ** min(self._failures, 30)) * random.uniform(0.5, 1.0)
        self._rests_until = time.monotonic() + max(wait, error.wait_s)
        return False

    def run(self, bus: Bus, stop: threading.Event) -> None:
        """Deliver what comes, and note live states, until `stop` is set."""
        live: list[Kind] = ["status"] if self.is_live else []
        events = bus.subscribe([*self.kinds, *live])
        looked = -LOOK_S
        while not stop.is_set():
            try:
                event = events.get(LOOK_S)
                if event is not None and event.kind == "status":
                    self.note(event.axis, event.data)
                self.counts["lost"] = events.lost
                told = event is not None and event.kind in self.kinds
                if told or time.monotonic() - looked >= LOOK_S:
                    self.tick()
                    self.once(stop.is_set)
                    looked = time.monotonic()
            except Exception as error:  # the thread must outlive a store in trouble
                self.last_error = f"{type(error).__name__}: {error}"
                stop.wait(TROUBLE_S)
        events.close()


class Webhook(Target):
    """POSTs to an http or https address; what is signed goes nowhere else, as redirects are not followed.

    Its name is the host and the first characters of the URL's SHA-256, as a URL may hold secrets.
    """

    def __init__(self, hook: config.Webhook, store: Store) -> None:
        self._url, self.kinds = hook.url, hook.kinds
        self._secret = None if hook.secret_file is None else read_secret(hook.secret_file).encode()
        self._tls = ssl.create_default_context()  # with the system's authorities
        sha256 = hashlib.sha256(hook.url.encode()).hexdigest()
        super().__init__(f"webhook:{urlsplit(hook.url).hostname}-{sha256[:8]}", store)

    def deliver(self, message: OutboxMessage) -> None:
        """POST a message, the same bytes at every attempt; Undelivered without an answer of 2xx in time."""
        told = {"schema": "fdd.event/1", "id": message.id, "kind": message.kind, "data": message.body}
        body = orjson.dumps(told)
        headers = {
            "Content-Type": "application/json", "User-Agent": f"fdd/{__version__}",
            "Idempotency-Key": hashlib.sha256(body).hexdigest()[:32],
        }  # fmt: skip
        if self._secret is not None:
            stamp = str(int(time.time()))
            headers |= {"X-Fdd-Timestamp": stamp, "X-Fdd-Signature": signature(self._secret, stamp, body)}
        try:
            with httpx.stream(
                "POST", self._url, content=body, headers=headers, timeout=TIMEOUT_S, verify=self._tls,
                follow_redirects=False, trust_env=False,
            ) as answer:  # fmt: skip
                said = next(answer.iter_raw(MOST_ANSWER_BYTES), b"")
        except httpx.HTTPError as error:  # an answer that is cut is none
            raise Undelivered(f"{type(error).__name__}: {error}", down=True) from None
        status = answer.status_code
        if not answer.is_success:
            down = status in (429, 503)
            final = not (down or status in (408, 425) or status >= 500)
            reason = f"{status} {answer.reason_phrase} {said.decode('utf-8', 'replace')}"
            wait_s = _asked(answer.headers.get("Retry-After", ""))
            raise Undelivered(reason, wait_s=wait_s, final=final, down=down)


def signature(secret: bytes, stamp: str, body: bytes) -> str:
    """HMAC-SHA256 over ``stamp.body``, as X-Fdd-Signature carries it.

    Examples
    --------
    >>> signature(b"key", "1700000000", b"{}")[:20]
    'sha256=9d713ed406bb7'
    """
    return "sha256=" + hmac.new(secret, stamp.encode() + b"." + body, hashlib.sha256).hexdigest()


def _asked(text: str) -> float:
    """s that Retry-After asks for, given in seconds or as a date; 0 where it is neither."""
    if re.fullmatch(r"[0-9]{1,9}", text.strip()):
        return float(text)
    try:
        return max(0.0, parsedate_to_datetime(text).timestamp() - time.time())
    except (TypeError, ValueError, OverflowError):
        return 0.0


class MqttPublisher(Target):
    """A client of one broker; paho's own thread keeps it connected.

    Topics: ``PREFIX/status``, ``PREFIX/axis/NAME/state`` and ``PREFIX/axis/NAME/alarm/ID`` are retained,
    ``PREFIX/axis/NAME/finding`` is not. All by QoS 1. A broker that forgot is told all that stands.
    """

    is_live = True

    def __init__(self, settings: config.MqttOutput, store: Store) -> None:
        super().__init__("mqtt", store)
        self._config = settings
        self._states: dict[str, bytes] = {}
        self._sent: dict[str, tuple[float, bytes]] = {}
        self._refreshed = self.connections = 0
        self.link_error = ""
        self._client = client = settings.client(settings.client_id or "")
        client.will_set(f"{settings.prefix}/status", b"offline", qos=1, retain=True)
        client.max_queued_messages_set(MOST_QUEUED)
        client.reconnect_delay_set(1, 60)
        client.on_connect, client.on_disconnect = self._connected, self._disconnected
        client.connect_async(settings.host, settings.chosen_port, settings.keepalive)

    def run(self, bus: Bus, stop: threading.Event) -> None:
        """Connect, and deliver what comes until `stop` is set."""
        self.start()
        super().run(bus, stop)
        self.stop()

    def start(self) -> None:
        """Connect, now or as soon as the broker is there."""
        self._client.loop_start()

    def stop(self) -> None:
        """Say so, and disconnect."""
        if self._client.is_connected():
            _is_acknowledged(self._publish("status", b"offline"), 1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def status(self) -> dict[str, Any]:
        """Counts, and how the connection stands."""
        link = {"connected": self._client.is_connected(), "connections": self.connections}
        return {**super().status(), **link, "link_error": self.link_error}

    def deliver(self, message: OutboxMessage) -> None:
        """Send an alarm's transition or a finding, and wait until the broker has it; Undelivered if not."""
        if not self._client.is_connected():
            raise Undelivered(self.link_error or "not connected", down=True)
        if message.kind == "alarm":
            info = self._alarm(message.body["alarm"])
        else:
            topic = f"axis/{message.body['axis']}/{message.kind}"
            info = self._publish(topic, orjson.dumps(message.body), retain=False)
        if not _is_acknowledged(info, TIMEOUT_S):
            raise Undelivered("not acknowledged by the broker", down=True)

    def note(self, axis: str, state: Mapping[str, Any]) -> None:
        """Take an axis's status; `tick` sends it. An empty one is of an axis that was removed."""
        self._states[axis] = orjson.dumps(dict(state)) if state else b""

    def tick(self) -> None:
        """Send the states that changed, each at most every `EVERY_S`; all of them to a broker that is new."""
        if not self._client.is_connected():
            return
        if (connection := self.connections) != self._refreshed:
            for alarm in self._store.alarms(STANDING):
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
            self.link_error = f"the broker refuses the connection: {reason}"
        else:
            self.connections, self.link_error = self.connections + 1, ""
            self._publish("status", b"online")

    def _disconnected(self, client: Any, data: Any, flags: Any, reason: Any, more: Any) -> None:
        # After a refusal its reason says more than that the link went.
        if reason.is_failure and not self.link_error:
            self.link_error = f"disconnected: {reason}"


def _is_acknowledged(info: MQTTMessageInfo, seconds: float) -> bool:
    with suppress(ValueError, RuntimeError):
        info.wait_for_publish(seconds)
        return info.is_published()
    return False
