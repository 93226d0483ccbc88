"""Status, alarms and findings on an MQTT broker, for whatever else listens in the plant."""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import orjson
from paho.mqtt.client import Client, MQTTMessageInfo
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from fdd.errors import InputError
from fdd.service.outputs.courier import Undelivered
from fdd.service.outputs.doors import Parcel, read_secret

EVERY_S = 5.0
"""Between two messages about one axis."""
ACKNOWLEDGED_S = 5.0
"""That the broker has for a message."""
MOST_QUEUED = 1000
OVER = "NORMAL"
"""State of an alarm that is over."""


class TlsSettings(Protocol):
    """PEM files: the authority's certificate (None: the system's), this client's own and its key."""

    @property
    def ca(self) -> Path | None: ...
    @property
    def cert(self) -> Path | None: ...
    @property
    def key(self) -> Path | None: ...


class MqttSettings(Protocol):
    """Of the configuration, `outputs: mqtt`."""

    @property
    def host(self) -> str: ...
    @property
    def chosen_port(self) -> int: ...
    @property
    def version(self) -> str: ...
    @property
    def user(self) -> str | None: ...
    @property
    def password_file(self) -> Path | None: ...
    @property
    def tls(self) -> TlsSettings | None: ...
    @property
    def client_id(self) -> str | None: ...
    @property
    def keepalive(self) -> int: ...
    @property
    def prefix(self) -> str: ...


class MqttPublisher:
    """A client of one broker; paho's own thread keeps it connected.

    Topics: ``PREFIX/status``, ``PREFIX/axis/NAME/state`` and ``PREFIX/axis/NAME/alarm/ID`` are retained,
    ``PREFIX/axis/NAME/finding`` is not. All by QoS 1.

    Parameters
    ----------
    settings : broker and prefix. standing : gives the alarms that stand now, for a broker that forgot them.

    Raises
    ------
    InputError : a prefix that is no topic, or a secret that cannot be read.

    Examples
    --------
    >>> publisher = MqttPublisher(settings, standing)  # doctest: +SKIP
    >>> publisher.start()  # doctest: +SKIP
    """

    def __init__(
        self, settings: MqttSettings, standing: Callable[[], Sequence[Mapping[str, Any]]] = lambda: ()
    ) -> None:
        self._prefix, self._standing = settings.prefix, standing
        if not self._prefix or any(c in self._prefix for c in "+#\0") or self._prefix[0] in "/$":
            raise InputError(
                f"{self._prefix[:70]!r} cannot begin a topic", where="outputs: mqtt: prefix", mend="e.g. fdd"
            )
        self._states: dict[str, bytes] = {}
        self._sent: dict[str, tuple[float, bytes]] = {}
        self._refreshed = 0
        self.connections, self.last_error = 0, ""
        self._broker = settings.host, settings.chosen_port, settings.keepalive
        protocol = MQTTProtocolVersion.MQTTv5 if settings.version == "5" else MQTTProtocolVersion.MQTTv311
        self._client = client = Client(
            CallbackAPIVersion.VERSION2, settings.client_id or "", protocol=protocol
        )
        if settings.user is not None:
            password = read_secret(settings.password_file) if settings.password_file else None
            client.username_pw_set(settings.user, password)
        if settings.tls is not None:
            client.tls_set_context(_tls(settings.tls))
        client.will_set(f"{self._prefix}/status", b"offline", qos=1, retain=True)
        client.max_queued_messages_set(MOST_QUEUED)
        client.reconnect_delay_set(1, 60)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect

    def start(self) -> None:
        """Connect, now or as soon as the broker is there."""
        self._client.connect_async(*self._broker)
        self._client.loop_start()

    def stop(self) -> None:
        """Say so, and disconnect."""
        if self._client.is_connected():
            self._acknowledged(self._publish("status", b"offline"), time.monotonic() + 1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def status(self) -> dict[str, Any]:
        """connected, connections, error of the link."""
        told = {"connected": self._client.is_connected(), "connections": self.connections}
        return {**told, "link_error": self.last_error}

    def deliver(self, parcel: Parcel) -> None:
        """Send an alarm's transition or a finding, and wait until the broker has it.

        Raises
        ------
        Undelivered : no connection, or no acknowledgement.
        """
        if not self._client.is_connected():
            raise Undelivered(self.last_error or "not connected", down=True)
        if parcel.kind == "alarm":
            info = self._alarm(parcel.body["alarm"])
        else:
            topic = f"axis/{parcel.body['axis']}/{parcel.kind}"
            info = self._publish(topic, orjson.dumps(dict(parcel.body)), retain=False)
        if not self._acknowledged(info, time.monotonic() + ACKNOWLEDGED_S):
            raise Undelivered("not acknowledged by the broker", down=True)

    def note(self, axis: str, state: Mapping[str, Any]) -> None:
        """Take an axis's status; `tick` sends it."""
        self._states[axis] = orjson.dumps(dict(state))

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
        payload = b"" if alarm["state"] == OVER else orjson.dumps(dict(alarm))
        return self._publish(f"axis/{alarm['axis']}/alarm/{alarm['id']}", payload)

    def _publish(self, topic: str, payload: bytes, *, retain: bool = True) -> MQTTMessageInfo:
        return self._client.publish(f"{self._prefix}/{topic}", payload, qos=1, retain=retain)

    def _acknowledged(self, info: MQTTMessageInfo, until: float) -> bool:
        try:
            info.wait_for_publish(until - time.monotonic())
            return info.is_published()
        except (ValueError, RuntimeError):
            return False

    def _on_connect(self, client: Client, _user: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            self.last_error = f"the broker refuses the connection: {reason}"
            return
        self.connections, self.last_error = self.connections + 1, ""
        self._publish("status", b"online")

    def _on_disconnect(self, client: Client, _user: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        # After a refusal its reason says more than that the link went.
        if reason.is_failure and not self.last_error:
            self.last_error = f"disconnected: {reason}"


def _tls(files: TlsSettings) -> ssl.SSLContext:
    try:
        context = ssl.create_default_context(cafile=files.ca)
        if files.cert is not None:
            context.load_cert_chain(files.cert, files.key)
    except OSError as error:  # those of ssl too
        told = error.strerror or "not a certificate"
        raise InputError(
            f"TLS cannot be set up ({told})", where="outputs: mqtt: tls", mend="name PEM files"
        ) from None
    return context
