"""A real broker for tests; they skip where mosquitto is not there."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
from pathlib import Path

import pytest

from tests.service.senders import free_port, until

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto here")


class Broker:
    """A mosquitto that keeps its sessions on disk, or nothing."""

    def __init__(self, folder: Path, *settings: str, keeps: bool = True) -> None:
        self.port = free_port()
        self._config, self._keeps = folder / "mosquitto.conf", keeps
        self.start(*(settings or ("allow_anonymous true",)))

    def start(self, *settings: str) -> None:
        """Start it, with other settings where they are given, and wait until it listens."""
        assert MOSQUITTO is not None
        if settings:
            kept = ("persistence true", f"persistence_location {self._config.parent}/", "autosave_interval 1",
                    "autosave_on_changes true", "max_queued_messages 10000")  # fmt: skip
            lines = (f"listener {self.port} 127.0.0.1", "user root", *kept * self._keeps, *settings, "")
            self._config.write_text("\n".join(lines))
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(self._config)], stderr=subprocess.DEVNULL)
        until(self._listens)

    def kill(self) -> None:
        """End it at once."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0
