"""Where blocks come from: MQTT, lines over TCP, UDP and standard input, logs in a folder or replayed."""

from __future__ import annotations

from collections.abc import Callable

from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap
from fdd.service.config_sources import AnySource, FolderSource, MqttSource, ReplaySource, TcpSource, UdpSource
from fdd.service.sources.source import Source

__all__ = ["Source", "open_source"]


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
    >>> open_source(UdpSource(type="udp", port=0)).status()["received"]
    0
    """
    # Here: a service without MQTT needs no paho, and one without logs no readers of them.
    channel_map = None if config.map is None else ChannelMap.load(config.map)
    if isinstance(config, FolderSource | ReplaySource):
        from fdd.service.sources.logs import Folder, Replays

        if isinstance(config, FolderSource):
            return Folder(config, channel_map)
        return Replays(config, channel_map)
    if isinstance(config, MqttSource):
        try:
            from fdd.service.sources.mqtt import Mqtt
        except ModuleNotFoundError as error:
            raise InputError(f"MQTT needs the package {error.name}", mend="install fdd[serve]") from None
        return Mqtt(config, channel_map, has)
    from fdd.service.sources.listening import Datagrams, StandardInput, TcpLines

    if isinstance(config, TcpSource):
        return TcpLines(config, channel_map)
    if isinstance(config, UdpSource):
        return Datagrams(config, channel_map)
    return StandardInput(config, channel_map)
