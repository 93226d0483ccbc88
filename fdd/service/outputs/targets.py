"""Where messages go: webhooks, an MQTT broker, JSON lines in a file; each delivers one, or says why not."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import ssl
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import orjson
from paho.mqtt.client import MQTTMessageInfo

from fdd import __version__
from fdd.files import require_writable
from fdd.service.config import MqttOutput
from fdd.service.store import OutboxMessage

TIMEOUT_S = 5.0
"""For each answer of the network, a broker's acknowledgement too."""
MOST_ANSWER_BYTES = 1024
"""Of an answer's body, for the log; the rest is not read."""
LONGEST_ASKED_S = 86400.0
"""Of what a target may ask for by Retry-After."""
MOST_BYTES = 64 << 20
"""Of a file of lines; a full one becomes FILE.1, in place of the one before."""
STATUS_EVERY_S = 60.0
EVERY_S = 5.0
"""Between two messages to a broker about one axis."""
MOST_QUEUED = 1000


class Undelivered(Exception):
    """A message did not arrive.

    Parameters
    ----------
    problem : one line. wait_s : s that the target asks for, before which nothing is tried again.
    final : it never will arrive. down : the target takes nothing now.
    """

    def __init__(self, problem: str, *, wait_s: float = 0.0, final: bool = False, down: bool = False) -> None:
        super().__init__(" ".join(problem.split())[:300])
        self.wait_s, self.final, self.down = min(wait_s, LONGEST_ASKED_S), final, down


class Webhook:
    """One receiver of POSTs.

    Parameters
    ----------
    url : http or https; redirects are not followed, so that what is signed goes nowhere else.
    secret : key of the signature; None leaves it out.

    Attributes
    ----------
    name : target in the outbox: host and first characters of the URL's SHA-256, as a URL may hold secrets.
    """

    def __init__(self, url: str, secret: bytes | None = None) -> None:
        self._url, self._secret = url, secret
        self._tls = ssl.create_default_context()  # with the system's authorities
        self.name = f"webhook:{urlsplit(url).hostname}-{hashlib.sha256(url.encode()).hexdigest()[:8]}"

    def deliver(self, message: OutboxMessage) -> None:
        """POST a message, the same bytes at every attempt.

        Raises Undelivered: no connection, no answer in time, or an answer other than 2xx.
        """
        told = {"schema": "fdd.event/1", "id": message.id, "kind": message.kind, "data": message.body}
        body = orjson.dumps(told)
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"fdd/{__version__}",
            "Idempotency-Key": hashlib.sha256(body).hexdigest()[:32],
        }
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


class JsonLines:
    """A file that lines are appended to; it is opened for each, so that log rotators may move it.

    Raises
    ------
    InputError : no such folder, no permission, or no file.

    Examples
    --------
    >>> JsonLines(Path("events.jsonl")).append({"kind": "status", "axis": "A1"})
    >>> Path("events.jsonl").read_text()
    '{"kind":"status","axis":"A1"}\\n'
    """

    def __init__(self, path: Path, most_bytes: int = MOST_BYTES) -> None:
        self._path, self._most_bytes = path, most_bytes
        require_writable(path)
        self._noted: dict[str, float] = {}

    def append(self, event: Mapping[str, Any]) -> None:
        """Append one line, whole or not at all; on the disk when this returns. Raises Undelivered."""
        line = orjson.dumps(event, option=orjson.OPT_APPEND_NEWLINE)
        try:
            with suppress(FileNotFoundError):
                if self._path.stat().st_size + len(line) > self._most_bytes:
                    self._path.replace(f"{self._path}.1")
            with self._path.open("ab", buffering=0) as file:
                size = file.tell()
                try:
                    if file.write(line) < len(line):
                        raise OSError("no space left for a whole line")
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(size)
                    raise
        except OSError as error:
            raise Undelivered(f"{self._path}: {error.strerror or error}", down=True) from None

    def deliver(self, message: OutboxMessage) -> None:
        """Append an alarm's transition or a finding; raises as `append`."""
        self.append({"id": message.id, "kind": message.kind, "data": message.body})

    def note(self, axis: str, state: Mapping[str, Any]) -> None:
        """Append an axis's status, once a minute at most; where that fails it is lost."""
        now = time.monotonic()
        if state and now - self._noted.get(axis, -STATUS_EVERY_S) >= STATUS_EVERY_S:
            self._noted[axis] = now
            self.append({"kind": "status", "axis": axis, "data": dict(state)})


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
        if not _is_acknowledged(info, TIMEOUT_S):
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
