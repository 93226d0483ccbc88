"""``fdd publish``: logs sent to an MQTT broker as live blocks, to try a service out."""

from __future__ import annotations

import heapq
import math
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from urllib.parse import urlsplit

import typer

from fdd.cli.failures import stopped_by_signals
from fdd.cli.monitor import replay_speed
from fdd.cli.options import AxisOption, MapOption, argument, option
from fdd.errors import InputError

if TYPE_CHECKING:
    from fdd.service.config_sources import Broker


def publish(
    logs: Annotated[list[Path], argument("Each becomes an axis of its name.", "LOG...")],
    mqtt: Annotated[
        str, option("Broker: mqtt://[USER@]HOST[:PORT], or mqtts:// with TLS.", metavar="URL")
    ],
    topic: Annotated[str, typer.Option(help="{axis} becomes the axis's name.")] = "fdd/{axis}/blocks",
    map_: MapOption = None,
    axis: AxisOption = None,
    speed: Annotated[str, typer.Option(help="Times real time, or max.")] = "1",
    jitter: Annotated[float, typer.Option(min=0.0, help="s that a block is held up at most.")] = 0.0,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of blocks that are never sent.")] = 0.0,
    shuffle: Annotated[
        int, typer.Option(min=1, help="So many neighbours come in any order (fdd serve: up to 5).")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of what comes by chance.")] = 0,
    password_file: Annotated[Path | None, option("Its first line is USER's password.")] = None,
    ca: Annotated[Path | None, option("PEM file of the broker's authority, for mqtts.")] = None,
) -> None:  # fmt: skip
    """Send logs to an MQTT broker as live axes, in blocks of 100 ms: to try fdd serve out, bad lines too."""
    try:
        from fdd.service.publishing import Link, publish, sendings
    except ModuleNotFoundError as error:
        raise InputError(f"needs the package {error.name}", mend="install fdd[serve]") from None
    import numpy as np

    from fdd.logs import ChannelMap, read_log
    from fdd.monitor.sources import pieces
    from fdd.service.blocks import axis_name

    broker = broker_of(mqtt, password_file, ca)
    if any(c in topic for c in "+#\0") or not topic:
        raise InputError(f"--topic {topic!r} is no topic to publish on", mend="leave + and # out")
    link = Link(replay_speed(speed) or math.inf, jitter, loss, shuffle, seed)
    names = [axis_name(log.stem) for log in logs]
    if len(set(names)) < len(names):
        raise InputError("two logs of one name would be one axis", mend="rename one, or publish them apart")
    channel_map = None if map_ is None else ChannelMap.load(map_)
    sent = []
    for name, path in zip(names, logs, strict=True):
        samples = read_log(path, channel_map, axis).samples
        mine = sendings(name, samples, link)
        numbers = np.array([block.sequence for _, block in mine], dtype=np.int64)
        overtaken = int((numbers < np.maximum.accumulate(numbers)).sum())
        whole = sum(1 for _ in pieces(samples))
        print(f"{name}: {len(mine)} of {whole} blocks are sent, {overtaken} of them overtaken", flush=True)
        sent.append(mine)
    stop = threading.Event()
    with stopped_by_signals(stop):
        publish(broker, topic, heapq.merge(*sent, key=lambda one: one[0]), stop)


def broker_of(url: str, password_file: Path | None, ca: Path | None) -> Broker:
    """The broker that a URL names.

    Raises
    ------
    InputError : it is no URL of a broker.

    Examples
    --------
    >>> broker = broker_of("mqtts://ann@broker.example.org", None, None)
    >>> broker.user, broker.host, broker.chosen_port
    ('ann', 'broker.example.org', 8883)
    """
    from pydantic import ValidationError

    from fdd.service.config_sources import Broker, ClientTls

    try:
        parts = urlsplit(url)
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.path or parts.password:
            raise ValueError
        return Broker(
            host=parts.hostname, port=parts.port, user=parts.username, password_file=password_file,
            tls=ClientTls(ca=ca) if parts.scheme == "mqtts" else None,
        )  # fmt: skip
    except (ValueError, ValidationError):
        raise InputError(
            "--mqtt is no URL of a broker", mend="write mqtt://[USER@]HOST[:PORT], or mqtts:// with TLS"
        ) from None
