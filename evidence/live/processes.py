"""A broker and ``fdd serve`` as processes of their own, the service on one core."""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from functools import partial
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

from evidence.live.messages import profile_text
from fdd.errors import InputError

START_S = 120.0
"""Longest start of the service."""
MAIN = "from fdd.cli import main; main()"


def mosquitto() -> str | None:
    """The broker's program; None where it is not installed."""
    return shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")


def why_not() -> str | None:
    """Why the service cannot be measured here; None where it can."""
    if mosquitto() is None:
        return "no mosquitto here, the broker of the measurement: install it (Debian: mosquitto)"
    if not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2:
        return "the service needs a core of its own: no two cores, or no Linux"
    return None


class Broker:
    """A mosquitto on a free port, away from the service's core; `stop` ends it."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = int(free.getsockname()[1])
        config = folder / "mosquitto.conf"
        lines = (f"listener {self.port} 127.0.0.1", "allow_anonymous true", "max_queued_messages 1000000", "")
        config.write_text("\n".join(lines), "utf-8")
        self._process = subprocess.Popen([str(mosquitto()), "-c", str(config)], stderr=subprocess.DEVNULL)
        end = time.monotonic() + 10.0
        while time.monotonic() < end:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", self.port)) == 0:
                    return
            time.sleep(0.05)
        raise InputError("mosquitto does not listen", mend="start it by hand and see what it says")

    def stop(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait()


class Served:
    """``fdd serve`` with an MQTT source, pinned to one core; `stop` ends it.

    Attributes
    ----------
    port : of its page and API.
    """

    def __init__(self, folder: Path, broker: int, core: int) -> None:
        (folder / "unit.yaml").write_text(profile_text(), "utf-8")
        config = folder / "serve.yaml"
        config.write_text(
            "schema: fdd.serve/1\nfallback: unit.yaml\nsources:\n- type: mqtt\n  host: 127.0.0.1\n"
            f"  port: {broker}\n  topics: ['rig/{{axis}}/blocks']\n",
            "utf-8",
        )
        self._process = subprocess.Popen(
            [sys.executable, "-c", MAIN, "serve", str(config), "--port", "0"],
            cwd=folder, stdout=subprocess.PIPE, stderr=(folder / "serve.log").open("w"), text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            preexec_fn=partial(os.sched_setaffinity, 0, {core}),
        )  # fmt: skip
        assert self._process.stdout is not None
        found = re.search(r":(\d+)", self._process.stdout.readline())
        if found is None:
            self._process.wait()
            told = (folder / "serve.log").read_text("utf-8").strip()
            raise InputError(f"fdd serve did not start: {told[-300:]}")
        self.port = int(found[1])
        end = time.monotonic() + START_S
        while self.get("/api/health")["status"] != "ok" and time.monotonic() < end:
            time.sleep(0.2)

    def get(self, address: str) -> Any:
        """What the API answers."""
        link = HTTPConnection("127.0.0.1", self.port, timeout=30.0)
        link.request("GET", address)
        answer = json.loads(link.getresponse().read())
        link.close()
        return answer

    @property
    def cpu_s(self) -> float:
        """s of processor time so far, of all its threads."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text("ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @property
    def rss(self) -> int:
        """Bytes in memory."""
        pages = Path(f"/proc/{self._process.pid}/statm").read_text("ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")

    def stop(self) -> None:
        """End it, without its state being kept."""
        self._process.kill()
        self._process.wait()
