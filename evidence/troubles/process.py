"""`fdd serve` as a process of its own, started, asked and killed as an operator would."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

import fdd

AXIS = "A1"
# The host's clock as the process sees it, `clock` seconds off: a file, so that it can be stepped meanwhile.
PROGRAM = """
import pathlib, sys, time
off, real = pathlib.Path(sys.argv.pop(1)), time.time
if off.exists():
    time.time = lambda: real() + float(off.read_text())
from fdd.cli import main
main()
"""
STARTED_S = 120.0


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """A port that nobody listens on now."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def until(done: Callable[[], Any], seconds: float) -> Any:
    """What `done` gives once it gives something; its last word after `seconds`."""
    end = time.monotonic() + seconds
    while not (found := done()) and time.monotonic() < end:
        time.sleep(0.1)
    return found


class Process:
    """`fdd serve` with its state and log in a folder.

    Parameters
    ----------
    folder : of everything. sources : of `serve.yaml`.
    """

    def __init__(self, folder: Path, sources: list[dict[str, Any]]) -> None:
        self.folder, self.sources, self.port = folder, sources, free_port()
        self.state, self.clock, self.log = folder / "state", folder / "clock", folder / "log.txt"
        recording = {"folder": "state/recordings", "before": 5, "after": 5}
        outputs = {"jsonl": "state/told.jsonl", "recording": recording}
        config = {"schema": "fdd.serve/1", "state": "state", "fallback": "axis_a", "sources": sources,
                  "listen": {"port": self.port}, "outputs": outputs}  # fmt: skip
        (folder / "serve.yaml").write_text(yaml.safe_dump(config))
        self.clock.write_text("0")
        self.popen: subprocess.Popen[bytes]

    def spawn(self) -> None:
        """Start it, and go on at once."""
        paths = [str(Path(fdd.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
        with self.log.open("ab") as log:
            self.popen = subprocess.Popen(
                [sys.executable, "-c", PROGRAM, str(self.clock), "serve", str(self.folder / "serve.yaml")],
                stdout=log, stderr=log, stdin=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in paths if p)},
            )  # fmt: skip

    def start(self) -> float:
        """Start it and wait until it answers; the seconds that this took."""
        begun = time.monotonic()
        self.spawn()
        until(lambda: self.get("/api/health") or self.popen.poll() is not None, STARTED_S)
        return time.monotonic() - begun

    def get(self, path: str, address: str = "127.0.0.2", timeout: float = 10.0) -> Any:
        """An answer of the API, None where there is none; as another client than those that attack."""
        link = http.client.HTTPConnection("127.0.0.1", self.port, timeout, source_address=(address, 0))
        try:
            link.request("GET", path)
            answer = link.getresponse()
            body = answer.read()
            return None if answer.status != 200 else json.loads(body) if path.startswith("/api") else body
        except (OSError, http.client.HTTPException, ValueError):
            return None
        finally:
            link.close()

    def problems(self) -> list[str]:
        """What `/api/health` complains of."""
        return (self.get("/api/health") or {}).get("problems", [])

    def samples(self) -> int:
        """Samples of the axis that it has worked."""
        axes = (self.get("/api/axes") or {}).get("axes", [])
        return next((int(a["samples"]) for a in axes if a["name"] == AXIS), 0)

    def metric(self, name: str) -> float:
        """A figure without labels of `/metrics`."""
        lines = (self.get("/metrics") or b"").decode().splitlines()
        return next((float(x.split()[1]) for x in lines if x.startswith(f"{name} ")), float("nan"))

    def end(self, number: int = signal.SIGTERM, within: float = 60.0) -> int | None:
        """Send a signal; the exit status, None where it does not end in time and is killed."""
        self.popen.send_signal(number)
        try:
            return self.popen.wait(within)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
            return None

    def lines(self, words: str) -> list[str]:
        """Lines of its log that a pattern is found in."""
        return [x for x in self.log.read_text("utf-8", "replace").splitlines() if re.search(words, x)]

    def told(self) -> tuple[list[tuple[str, float]], list[str]]:
        """Of its store, while it does not run: findings (fault, onset) and what the audit says of alarms."""
        with sqlite3.connect(self.state / "fdd.db") as store:
            findings = store.execute("SELECT fault, onset FROM finding ORDER BY id").fetchall()
            audit = store.execute("SELECT action FROM audit WHERE alarm_id IS NOT NULL ORDER BY id")
            return findings, [action for (action,) in audit]
