"""A real broker and a real PostgreSQL server, which tests may kill; they skip where there is none."""

import atexit
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from functools import cache
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho
import pytest
from sqlalchemy import create_engine, text

from reports.service import MOSQUITTO, free_port
from tests.service.senders import until

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
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


class Client:
    """Publishes at QoS 1, and notes what comes of the topics that it listens to."""

    def __init__(self, broker: Broker, listens: str = "", **session: Any) -> None:
        self.came: list[paho.MQTTMessage] = []
        self._client = client = paho.Client(paho.CallbackAPIVersion.VERSION2, **session)
        client.reconnect_delay_set(0.1, 0.2)
        client.max_inflight_messages_set(10)
        subscribed = threading.Event()
        client.on_subscribe = lambda *told: subscribed.set()
        client.on_message = lambda c, data, message: self.came.append(message)
        client.on_connect = lambda c, *told: c.subscribe(listens, qos=1) if listens else None
        client.connect("127.0.0.1", broker.port)
        client.loop_start()
        assert not listens or subscribed.wait(60.0), "else what is not retained may come before it listens"

    def publish(self, topic: str, payload: bytes, **more: Any) -> paho.MQTTMessageInfo:
        return self._client.publish(topic, payload, **{"qos": 1, **more})

    def of(self, topic: str) -> list[tuple[bytes, bool]]:
        """Payloads of a topic, and whether each was retained."""
        return [(m.payload, m.retain) for m in self.came if m.topic == topic]

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


PATH = os.pathsep.join([os.environ.get("PATH", ""), *map(str, Path("/usr/lib/postgresql").glob("*/bin"))])
"""Debian has the server's programs beside the path."""
USER = "postgres" if os.geteuid() == 0 else None
"""Whom it runs as: it refuses root."""


class PostgresServer:
    """Made and started; `url` names an empty database on it."""

    def __init__(self) -> None:
        # Not below pytest's folders: the server's user could not enter them.
        self._folder = Path(tempfile.mkdtemp(prefix="fdd-postgres-", dir="/tmp"))
        atexit.register(self._remove)
        if USER is not None:
            shutil.chown(self._folder, USER)
        self._port = free_port()
        self._run("initdb", "--auth=trust", "--username=postgres", "--no-sync")
        self.start()
        self.url = f"postgresql://postgres@127.0.0.1:{self._port}/postgres"

    def start(self) -> None:
        settings = f"-p {self._port} -c listen_addresses=127.0.0.1 -c unix_socket_directories='' -F"
        self._run("pg_ctl", "start", "--wait", f"--options={settings}", f"--log={self._folder / 'log'}")

    def kill(self) -> None:
        """End at once: no connection is told, nothing is written out; it must recover when it starts."""
        self._run("pg_ctl", "stop", "--mode=immediate")

    def _run(self, program: str, *arguments: str) -> None:
        subprocess.run(
            [shutil.which(program, path=PATH) or "", f"--pgdata={self._folder / 'data'}", *arguments],
            user=USER, cwd="/", check=True, stdout=subprocess.DEVNULL, timeout=60,
        )  # fmt: skip

    def _remove(self) -> None:
        self.kill()
        shutil.rmtree(self._folder)


@cache
def postgres_server() -> PostgresServer:
    """The one of this process; without its programs, or the driver, the test is skipped."""
    pytest.importorskip("psycopg", reason="no driver of PostgreSQL here: the extra postgres")
    if shutil.which("initdb", path=PATH) is None:
        pytest.skip("no server of PostgreSQL here: Debian's package postgresql")
    return PostgresServer()


def postgres_url() -> str:
    """An emptied database on a server of our own, or the test is skipped."""
    url = postgres_server().url
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return url
