"""Where blocks come from: MQTT, lines over TCP, UDP and standard input, logs in a folder or replayed."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any, Protocol

from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.service.blocks import Decoder
from fdd.service.config_sources import (
    AnySource,
    FolderSource,
    MqttSource,
    ReplaySource,
    TcpSource,
    UdpSource,
    source_name,
)
from fdd.service.sources.intake import Intake, Put


class Source(Protocol):
    """One source; it runs in threads of its own."""

    def start(self, put: Put, stop: threading.Event) -> None:
        """Begin to put blocks, until `stop` is set; returns at once.

        Raises
        ------
        InputError : it cannot even begin: a port that is taken, a password file that is missing.
        """
        ...

    def status(self) -> dict[str, Any]:
        """How it stands: `connected`, `received` and `refused` messages, `last_error`, `reconnects`, more."""
        ...


def open_source(config: AnySource, has: Callable[[str], bool] = lambda axis: True) -> Source:
    """The source that a part of `serve.yaml` describes; its map is read.

    Parameters
    ----------
    has : whether an axis is taken; MQTT alone can leave one out.

    Raises
    ------
    InputError : its map cannot be read, or has what a stream cannot use; MQTT without its package.

    Examples
    --------
    >>> source = open_source(UdpSource(type="udp", port=0))
    >>> source.status()["received"]
    0
    """
    # Here: a service without MQTT needs no paho, and one without logs no readers of them.
    channel_map = None if config.map is None else ChannelMap.load(config.map)
    name = source_name(config)
    if isinstance(config, FolderSource):
        from fdd.service.sources.folder import Folder

        return Folder(config, Intake(name, unit=config.unit), channel_map)
    if isinstance(config, ReplaySource):
        from fdd.service.sources.replay import Replays

        return Replays(config, Intake(name, unit=config.unit), channel_map)
    intake = Intake(name, Decoder(channel_map), unit=config.unit)
    if isinstance(config, MqttSource):
        try:
            from fdd.service.sources.mqtt import Mqtt
        except ModuleNotFoundError as error:
            raise InputError(
                f"source {name}: MQTT needs the package {error.name}", mend="install fdd[serve]"
            ) from None
        return Mqtt(config, intake, has)
    from fdd.service.sources.listening import Datagrams, StandardInput, TcpLines

    if isinstance(config, TcpSource):
        return TcpLines(config, intake)
    if isinstance(config, UdpSource):
        return Datagrams(config, intake)
    return StandardInput(config, intake, sys.stdin.fileno)


__all__ = ["Source", "open_source"]
