"""Where blocks come from: MQTT, lines over TCP, UDP, logs in a folder or replayed."""

from __future__ import annotations

from typing import Any

from fdd.service.config_sources import AnySource
from fdd.service.sources.listening import Datagrams, TcpLines
from fdd.service.sources.logs import Folder, Replays
from fdd.service.sources.mqtt import Mqtt
from fdd.service.sources.source import Source

__all__ = ["Source", "open_source"]
KINDS: dict[str, type[Source[Any]]] = {
    "mqtt": Mqtt, "folder": Folder, "replay": Replays, "tcp": TcpLines, "udp": Datagrams,
}  # fmt: skip


def open_source(config: AnySource) -> Source[Any]:
    """The source that a part of `serve.yaml` describes.

    Raises InputError: its map cannot be read, or has what a stream cannot use.
    """
    return KINDS[config.type](config)
