"""The file `serve.yaml`: what `fdd serve` watches, where it keeps its state and whom it tells."""

from __future__ import annotations

import ipaddress
import re
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit
from zoneinfo import ZoneInfo

from pydantic import Field, ValidationError, field_validator, model_validator

from fdd.bounds import MAX_SERVE_BYTES, MOST_AXES
from fdd.errors import InputError, input_error
from fdd.service.config_sources import AnySource, AxisName, Broker, ConfigPath, ListenedPort, Part, Seconds
from fdd.unit import Unit, shipped_units
from fdd.yaml_reading import yaml_mapping, yaml_text


class Tls(Part):
    """A server's certificate and key, PEM files."""

    cert: ConfigPath
    key: ConfigPath


class Listen(Part):
    """Where the page and the API are served, and by which `names` of this machine beside its address."""

    host: str = "127.0.0.1"
    port: ListenedPort = 8080
    tls: Tls | None = None
    names: tuple[str, ...] = ()

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


class MqttOutput(Broker):
    """States, alarms and findings published to a broker, on topics below `prefix`."""

    prefix: Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^+#\x00/$][^+#\x00]*$")] = "fdd"


class Webhook(Part):
    """An address that is told; the first line of `secret_file` signs what is sent."""

    url: str
    secret_file: ConfigPath | None = None
    kinds: tuple[Literal["finding", "alarm"], ...] = ("finding", "alarm")

    @field_validator("url")
    @classmethod
    def _http(cls, url: str) -> str:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
        if not usable or parts.username or parts.fragment or re.search(r"[^\x21-\x7e]", url):
            raise ValueError("no address of http or https without user, fragment and blanks")
        return url


class Recording(Part):
    """Annotated MCAP files from `before` s before an alarm to `after` s after it, the oldest of which go."""

    folder: ConfigPath
    before: Annotated[float, Field(ge=0, le=600)] = 60.0
    after: Annotated[float, Field(ge=0, le=600)] = 60.0
    most_bytes: Annotated[int, Field(ge=1 << 20)] = 10 << 30


class Outputs(Part):
    """Whom the service tells."""

    metrics: bool = True
    mqtt: MqttOutput | None = None
    webhooks: tuple[Webhook, ...] = ()
    recording: Recording | None = None


class Retention(Part):
    """Days that rollups are kept, and findings where it is given; those by the day and the audit stay."""

    minutes: Annotated[int, Field(ge=1)] = 30
    hours: Annotated[int, Field(ge=1)] = 730
    findings: Annotated[int, Field(ge=1)] | None = None


class Limits(Part):
    """What may wait: `inbox_seconds` of one axis, `inbox_bytes` of all; `backlog_bytes` of blocks whose axes
    are put off, beyond which all senders wait; `hold` s of data for a block before them."""

    inbox_seconds: Seconds = 10.0
    inbox_bytes: Annotated[int, Field(ge=1 << 20)] = 256 << 20
    backlog_bytes: Annotated[int, Field(ge=0)] = 4 << 30
    hold: Annotated[float, Field(ge=0, le=1)] = 0.5


class Serve(Part):
    """The whole file.

    Attributes
    ----------
    state : folder of what the service keeps.
    store : URL of a database; a file in `state` where none is given.
    units : folder of profiles, or profile by axis. fallback : profile of axes that have none.
    zone : IANA name of the time zone of all axes' clock times, or one for each axis; that of this machine
        where none is given.
    learn_minutes : of work by which the baseline of a profile without one is learnt.
    model : of the decision; the shipped one where none is given.
    tokens : file of lines ``NAME ROLE SHA256(TOKEN)``. Without it only this machine may be listened on.

    Examples
    --------
    >>> text = "schema: fdd.serve/1\\nsources: [{type: udp, port: 9000}]"
    >>> Serve.from_yaml(text).sources[0].host
    '127.0.0.1'
    """

    schema_: Literal["fdd.serve/1"] = Field(alias="schema")
    state: Annotated[ConfigPath, Field(validate_default=True)] = Path("fdd-state")
    store: str | None = None
    units: ConfigPath | dict[AxisName, str] | None = None
    fallback: str | None = None
    zone: str | dict[AxisName, str] | None = None
    learn_minutes: Annotated[float, Field(ge=5, le=10080)] = 60.0
    model: ConfigPath | None = None
    listen: Listen = Listen()
    tokens: ConfigPath | None = None
    sources: Annotated[list[AnySource], Field(min_length=1)]
    outputs: Outputs = Outputs()
    retention: Retention = Retention()
    limits: Limits = Limits()

    @field_validator("zone")
    @classmethod
    def _known_zones(cls, zone: str | dict[str, str] | None) -> str | dict[str, str] | None:
        for name in zone.values() if isinstance(zone, dict) else [zone] if zone else []:
            try:
                ZoneInfo(name)
            except (ValueError, OSError, KeyError):
                raise ValueError(f"{name!r} is no time zone; write e.g. Europe/Paris or UTC") from None
        return zone

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        host, names = self.listen.host, [s.name or s.type for s in self.sources]
        if self.tokens is None and not self.listen.is_local:
            raise ValueError(f"listen: {host} is open to others and needs tokens: give a tokens file")
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice is not None:
            raise ValueError(f"sources: {twice!r} twice; give each a name of its own")
        return self

    @property
    def store_url(self) -> str:
        """The database's URL."""
        return self.store or f"sqlite:///{self.state / 'fdd.db'}"

    @classmethod
    def load(cls, path: str | Path) -> Serve:
        """Read the file; its relative paths become those from here.

        Raises InputError: names the file, the key and what is allowed.
        """
        path = Path(path)
        text = yaml_text(path, "configuration of fdd serve", MAX_SERVE_BYTES, "see fdd schema serve")
        return cls.from_yaml(text, where=path, folder=path.parent)

    @classmethod
    def from_yaml(cls, text: str, where: str | Path = "serve.yaml", folder: Path = Path()) -> Serve:
        """Parse YAML text; relative paths are below `folder`, `where` is named in errors.

        Raises InputError: names the key and what is allowed.
        """
        data = yaml_mapping(text, where, "configuration of fdd serve", schema="fdd.serve/1")
        try:
            return cls.model_validate(data, context=folder)
        except ValidationError as error:
            # The tag of the union stands in the place, as in sources.0.mqtt.port.
            raise input_error(error, where, "see fdd schema serve") from None


def profile_of(config: Serve, axis: str, said: str | None) -> Unit:
    """The profile of an axis, of the folder or the mapping of `serve.yaml`, a shipped one, or the fallback.

    What its blocks say is looked up among the folder's files and the shipped profiles: it is never a path.
    Raises InputError: there is none, or it cannot be used.
    """
    units = config.units
    if isinstance(units, dict):
        if axis in units:
            return _load(units[axis])
    elif units is not None:
        files = {p.stem: p for p in sorted(units.glob("*.yaml"))[:MOST_AXES]}
        for name in (said, axis, axis.replace("/", "_")):
            if name in files:
                return _load(str(files[name]))
    if said is not None and said in shipped_units():
        return _load(said)
    if config.fallback is not None:
        return _load(config.fallback)
    problem = f"axis {axis}: no profile{f' {said!r}' if said else ''}"
    raise InputError(problem, mend="put one named like the axis into the units folder, or name a fallback")


@cache
def _load(source: str) -> Unit:
    """A profile, read once for all its axes, which share it."""
    return Unit.load(source)
