"""Where messages go: webhooks and an MQTT broker; and all outputs together."""

from __future__ import annotations

import hashlib
import hmac
import ssl
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import httpx
import orjson
from paho.mqtt.client import MQTTMessageInfo

from fdd import __version__
from fdd.service import config
from fdd.service.alarms import STANDING
from fdd.service.config_sources import read_secret
from fdd.service.outputs import KINDS, Target, Undelivered
from fdd.service.outputs.recorder import Recorder
from fdd.service.queues import Bus
from fdd.service.store import OutboxMessage, Store
from fdd.service.storing import Targets

TIMEOUT_S = 5.0
"""For each answer of the network, a broker's acknowledgement too."""
MOST_ANSWER_BYTES = 1024
"""Of an answer's body, for the log; the rest is not read."""
EVERY_S = 5.0
"""Between two messages to a broker about one axis."""
MOST_QUEUED = 1000


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
            raise Undelivered(reason, final=final, down=down)


def signature(secret: bytes, stamp: str, body: bytes) -> str:
    """HMAC-SHA256 over ``stamp.body``, as X-Fdd-Signature carries it."""
    return "sha256=" + hmac.new(secret, stamp.encode() + b"." + body, hashlib.sha256).hexdigest()


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


class Outputs:
    """Everything that tells the outside what the fleet found: what must arrive is in the store's outbox, what
    may be lost comes by the bus. Raises InputError: a secret file or a folder that cannot be used."""

    def __init__(self, settings: config.Outputs, store: Store, bus: Bus) -> None:
        made: list[Target] = [] if settings.mqtt is None else [MqttPublisher(settings.mqtt, store)]
        made += [Webhook(hook, store) for hook in reversed(settings.webhooks)]
        self._bus, self._threads = bus, list[threading.Thread]()
        self._targets = {target.name: target for target in made}
        kept = settings.recording
        self._recorder = None if kept is None else Recorder(kept, bus)

    @property
    def targets(self) -> Targets:
        """Whom an event is sent to; webhooks hear nothing of what a chattering alarm does."""
        known = self._targets.values()
        return {
            (kind, notify): [t.name for t in known if kind in t.kinds and (notify or t.is_live)]
            for kind in KINDS
            for notify in (True, False)
        }

    def start(self, stop: threading.Event) -> None:
        """Begin, in threads of their own that end soon after `stop`."""
        work = [partial(target.run, self._bus, stop) for target in self._targets.values()]
        if self._recorder is not None:
            work.append(partial(self._recorder.run, stop))
        self._threads = [threading.Thread(target=run, daemon=True) for run in work]
        for thread in self._threads:
            thread.start()

    def join(self, timeout: float = 20.0) -> None:
        """Wait until all have ended, at most so many seconds; what was not delivered stays in the outbox."""
        until = time.monotonic() + timeout
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def status(self) -> dict[str, dict[str, Any]]:
        """Of each target delivered, failed, given_up, pending, lost, last_error; of the recorder its own."""
        told = {name: target.status() for name, target in self._targets.items()}
        return told if self._recorder is None else told | {"recording": self._recorder.status()}
