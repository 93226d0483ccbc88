"""The parts of `serve.yaml` that say where samples come from."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from fdd.bounds import MOST_CONNECTIONS
from fdd.errors import InputError
from fdd.service.blocks import axis_name

if TYPE_CHECKING:
    import paho.mqtt.client as paho

Port = Annotated[int, Field(ge=1, le=65535)]
ListenedPort = Annotated[int, Field(ge=0, le=65535, description="0 takes a free one")]
Seconds = Annotated[float, Field(gt=0, le=86400, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=64)]
ConfigPath = Annotated[
    Path,
    Field(description="relative to the folder that serve.yaml stands in"),
    AfterValidator(lambda path, info: (info.context or Path()) / path),  # the validation's context names it
]
AxisName = Annotated[str, AfterValidator(axis_name)]
MOST_SECRET_BYTES = 4096


class Part(BaseModel):
    """A part of the file; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ClientTls(Part):
    """PEM files: `ca` of the broker's authority (else the system's), `cert` and `key` of this client."""

    ca: ConfigPath | None = None
    cert: ConfigPath | None = None
    key: ConfigPath | None = None

    @model_validator(mode="after")
    def _both(self) -> Self:
        if (self.cert is None) != (self.key is None):
            raise ValueError("cert and key go together")
        return self


class Broker(Part):
    """How an MQTT broker is reached, on port 1883, or 8883 with TLS, where none is given.

    The first line of `password_file` is the password. `client_id` names the session, one for each process.
    """

    host: str
    port: Port | None = None
    version: Literal["3.1.1", "5"] = "5"
    user: str | None = None
    password_file: ConfigPath | None = None
    tls: ClientTls | None = None
    client_id: Annotated[str, Field(min_length=1, max_length=128)] | None = None
    keepalive: Annotated[int, Field(ge=5, le=3600)] = 30

    @model_validator(mode="after")
    def _password_of_a_user(self) -> Self:
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file needs a user")
        return self

    @property
    def chosen_port(self) -> int:
        """The port, or the protocol's own."""
        return self.port or (1883 if self.tls is None else 8883)

    @property
    def shown(self) -> str:
        """How error lines call it."""
        return f"mqtt {self.host}:{self.chosen_port}"

    def client(self, client_id: str, **more: Any) -> paho.Client:
        """A client that is not connected yet. Raises InputError: password file, certificate or key cannot be
        read."""
        import paho.mqtt.client as paho

        version = paho.MQTTv5 if self.version == "5" else paho.MQTTv311
        client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id, protocol=version, **more)
        if self.user is not None:
            password = None if self.password_file is None else read_secret(self.password_file)
            client.username_pw_set(self.user, password)
        if (tls := self.tls) is not None:
            ca, cert, key = (None if path is None else str(path) for path in (tls.ca, tls.cert, tls.key))
            try:
                client.tls_set(ca, cert, key)
            except (OSError, ValueError) as error:  # ssl's own errors are OSErrors
                where = ", ".join(filter(None, (ca, cert, key))) or self.shown
                problem = f"TLS cannot be set up ({error})"
                raise InputError(problem, where=where, mend="check ca, cert and key") from None
        return client


class _Source(Part):
    name: Name | None = None
    """In status and logs; the type where none is given."""
    map: ConfigPath | None = None
    """Channel map: names and units of measure of the columns."""
    unit: str | None = None
    """Profile of this source's axes, where a block names none."""


class MqttSource(Broker, _Source):
    """Blocks published to a broker, on `topics` with wildcards; a level ``{axis}`` stands for an axis's name,
    which the message may then leave out. The broker keeps what was not acknowledged for `session_hours` while
    fdd is away (MQTT 5)."""

    type: Literal["mqtt"]
    topics: Annotated[list[Annotated[str, Field(min_length=1, max_length=1000)]], Field(min_length=1)]
    session_hours: Annotated[float, Field(gt=0, le=8760)] = 24.0

    @model_validator(mode="after")
    def _topics_are_filters(self) -> Self:
        for topic in self.topics:
            levels = topic.split("/")
            if any(("+" in x and x != "+") or ("#" in x and x != "#") for x in levels) or "#" in levels[:-1]:
                raise ValueError(f"topic {topic!r}: + and # stand for whole levels, # for the last ones")
            if levels.count("{axis}") > 1 or any("{" in x and x != "{axis}" for x in levels):
                raise ValueError(f"topic {topic!r}: {{axis}} stands for one whole level")
        return self


class _Listening(_Source):
    host: str = "127.0.0.1"
    port: ListenedPort
    axis: AxisName | None = None
    """Of samples that name none."""


class TcpSource(_Listening):
    """JSON lines, each a block or a sample, on `connections` at once, closed after `idle` s of silence."""

    type: Literal["tcp"]
    connections: Annotated[int, Field(ge=1, le=MOST_CONNECTIONS)] = 64
    idle: Seconds = 300.0


class UdpSource(_Listening):
    """A block or a sample in each UDP datagram."""

    type: Literal["udp"]


class FolderSource(_Source):
    """Logs that drop into a folder, looked at `every` s; without `axis` they or their subfolders name it."""

    type: Literal["folder"]
    folder: ConfigPath
    axis: AxisName | None = None
    every: Seconds = 1.0


class ReplaySource(_Source):
    """Logs, by axis, replayed at `speed` times real time; ``max`` is as fast as taken."""

    type: Literal["replay"]
    logs: Annotated[dict[AxisName, ConfigPath], Field(min_length=1)]
    speed: Annotated[float, Field(gt=0, allow_inf_nan=False)] | Literal["max"] = 1.0


_Sources = MqttSource | TcpSource | UdpSource | FolderSource | ReplaySource
AnySource = Annotated[_Sources, Field(discriminator="type")]


def read_secret(path: Path) -> str:
    """A password or key: the file's first line, without the blanks around it.

    Raises InputError: missing, empty, no text, or longer than 4096 bytes.
    """
    try:
        with path.open(encoding="utf-8") as file:
            text = file.readline(MOST_SECRET_BYTES + 1).strip()
    except (OSError, UnicodeDecodeError) as error:
        told = getattr(error, "strerror", None) or "not text"
        problem = f"the password or key cannot be read ({told})"
        raise InputError(problem, where=path, mend="write it there") from None
    if not text or len(text) > MOST_SECRET_BYTES:
        problem = f"empty, or longer than {MOST_SECRET_BYTES} bytes"
        raise InputError(problem, where=path, mend="write one line with the secret into it")
    return text


def bound_socket(
    host: str, port: int, where: str, mend: str, kind: socket.SocketKind = socket.SOCK_STREAM
) -> socket.socket:
    """A socket on a port of this machine. Raises InputError: the port is taken, or no address of it."""
    try:
        # With its protocol: asyncio sends small answers at once on sockets that say that they are TCP.
        family, _, protocol, _, address = socket.getaddrinfo(host, port, type=kind)[0]
        made = socket.socket(family, kind, protocol)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1 if kind is socket.SOCK_STREAM else 0)
        made.bind(address)
    except OSError as error:
        why = f"cannot be listened on ({error.strerror or error})"
        raise InputError(why, where=where, mend=f"{mend} and an address of this machine") from None
    return made
