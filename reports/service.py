"""`fdd serve` and an MQTT broker as processes of their own, started, asked and killed as by an operator."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.client import HTTPException
from pathlib import Path
from typing import Any
from urllib.request import ProxyHandler, build_opener

import yaml

import fdd
from fdd.errors import InputError

AXIS = "A1"
STARTED_S = 120.0
opened = build_opener(ProxyHandler({})).open
"""An address of this machine, past any proxy."""
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")


def free_port() -> int:
    """A port that nobody listens on now."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def until(done: Callable[[], Any], seconds: float) -> Any:
    """What `done` gives once it gives something; its last word after `seconds`."""
    end = time.monotonic() + seconds
    while not (found := done()) and time.monotonic() < end:
        time.sleep(0.1)
    return found


@contextmanager
def broker(folder: Path) -> Iterator[int]:
    """A mosquitto that listens on a port.

    Raises `InputError`: it does not.
    """
    assert MOSQUITTO is not None
    port, config = free_port(), folder / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 1000000\n")
    process = subprocess.Popen([MOSQUITTO, "-c", str(config)], stderr=subprocess.DEVNULL)

    def listens() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    try:
        if not until(listens, 20.0):
            raise InputError("mosquitto does not listen", mend="start it by hand and see what it says")
        yield port
    finally:
        process.terminate()
        process.wait()


class Process:
    """`fdd serve` with its state and log in a folder, on a core; `more`: what else stands in `serve.yaml`."""

    def __init__(
        self, folder: Path, sources: list[dict[str, Any]], core: int | None = None, **more: Any
    ) -> None:
        self.folder, self.sources, self.port, self._core = folder, sources, free_port(), core
        self.state, self.log = folder / "state", folder / "log.txt"
        config = {"schema": "fdd.serve/1", "state": "state", "fallback": "axis_a", "sources": sources,
                  "listen": {"port": self.port}, **more}  # fmt: skip
        (folder / "serve.yaml").write_text(yaml.safe_dump(config))
        paths = [str(Path(fdd.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
        self.environ = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
        self.popen: subprocess.Popen[bytes]

    def spawn(self) -> None:
        """Start it, and go on at once."""
        pinned = None if self._core is None else partial(os.sched_setaffinity, 0, {self._core})
        program = [sys.executable, "-c", "from fdd.cli import main; main()", "serve"]
        with self.log.open("ab") as log:
            self.popen = subprocess.Popen(
                [*program, str(self.folder / "serve.yaml")], stdout=log, stderr=log, stdin=subprocess.DEVNULL,
                preexec_fn=pinned, env=self.environ,
            )  # fmt: skip

    def start(self) -> None:
        """Start it and wait until it answers."""
        self.spawn()
        until(lambda: self.get("/api/health") or self.popen.poll() is not None, STARTED_S)

    def get(self, path: str) -> Any:
        """An answer of the API, None where there is none."""
        try:
            with opened(f"http://127.0.0.1:{self.port}{path}", timeout=10.0) as answer:
                body = answer.read()
            return json.loads(body) if path.startswith("/api") else body
        except (OSError, HTTPException, ValueError):
            return None

    def problems(self) -> list[str]:
        """What `/api/health` complains of."""
        return (self.get("/api/health") or {}).get("problems", [])

    def axes(self) -> list[dict[str, Any]]:
        """What `/api/axes` tells of each axis."""
        return (self.get("/api/axes") or {}).get("axes", [])

    def samples(self) -> int:
        """Samples of the axis that it has worked."""
        return next((int(a["samples"]) for a in self.axes() if a["name"] == AXIS), 0)

    def metric(self, name: str) -> float:
        """A figure without labels of `/metrics`."""
        lines = (self.get("/metrics") or b"").decode().splitlines()
        return next((float(x.split()[1]) for x in lines if x.startswith(f"{name} ")), float("nan"))

    @property
    def cpu_s(self) -> float:
        """s of processor time so far, of all its threads."""
        fields = Path(f"/proc/{self.popen.pid}/stat").read_text("ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def resident(self) -> int:
        """Bytes in memory."""
        return resident(self.popen.pid)

    def end(self) -> int | None:
        """Send SIGTERM; the exit status, None where it does not end in time and is killed."""
        self.popen.terminate()
        try:
            return self.popen.wait(60.0)
        except subprocess.TimeoutExpired:
            self.kill()
            return None

    def kill(self) -> None:
        """Send SIGKILL, and wait."""
        self.popen.kill()
        self.popen.wait()

    def lines(self, words: str) -> list[str]:
        """Lines of its log that a pattern is found in."""
        return [x for x in self.log.read_text("utf-8", "replace").splitlines() if re.search(words, x)]

    def told(self) -> tuple[list[tuple[str, float]], list[str]]:
        """Of its store, while it does not run: findings (fault, onset) and what the audit says of alarms."""
        with sqlite3.connect(self.state / "fdd.db") as store:
            findings = store.execute("SELECT fault, onset FROM finding ORDER BY id").fetchall()
            audit = store.execute("SELECT action FROM audit WHERE alarm_id IS NOT NULL ORDER BY id")
            return findings, [action for (action,) in audit]


def resident(pid: int | str = "self") -> int:
    """Bytes in memory of a process."""
    pages = Path(f"/proc/{pid}/statm").read_text("ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
