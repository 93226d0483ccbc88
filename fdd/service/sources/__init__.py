"""Where blocks come from: MQTT, lines over TCP, UDP and standard input, logs in a folder or replayed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fdd.logs.channel_map import ChannelMap
from fdd.service.config_sources import AnySource, FolderSource, MqttSource, ReplaySource, TcpSource, UdpSource
from fdd.service.sources.listening import Datagrams, StandardInput, TcpLines
from fdd.service.sources.logs import Folder, Replays
from fdd.service.sources.mqtt import Mqtt
from fdd.service.sources.source import Source

__all__ = ["Source", "open_source"]


def open_source(config: AnySource, has: Callable[[str], bool] = lambda axis: True) -> Source[Any]:
    """The source that a part of `serve.yaml` describes; its map is read.

    Parameters
    ----------
    has : whether an axis is taken; MQTT alone can leave one out.

    Raises
    ------
    InputError : its map cannot be read, or has what a stream cannot use.

    Examples
    --------
    >>> open_source(UdpSource(type="udp", port=0)).status()["received"]
    0
    """
    channel_map = None if config.map is None else ChannelMap.load(config.map)
    match config:
        case MqttSource():
            return Mqtt(config, channel_map, has)
        case FolderSource():
            return Folder(config, channel_map)
        case ReplaySource():
            return Replays(config, channel_map)
        case TcpSource():
            return TcpLines(config, channel_map)
        case UdpSource():
            return Datagrams(config, channel_map)
    return StandardInput(config, channel_map)
