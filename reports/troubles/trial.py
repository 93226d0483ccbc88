"""One trouble tried: a third of a leaking run before it, a third while it lasts, the rest after it."""

from __future__ import annotations

import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import paho.mqtt.client as paho

from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block, encode_json
from fdd.unit import Unit
from reports.service import AXIS, Broker, Process, free_port, until

ARRIVED_S = 120.0
ROWS = 100


@cache
def leaking(duration: float = 60.0) -> Samples:
    """A run of a shipped axis that leaks from its middle on, 1 kHz."""
    leak = {"fault": "internal_leakage", "severity": 0.8, "onset": duration / 2}
    scenario = Scenario(duration=duration, load={"name": "spring"}, faults=[leak], seed=5)
    return simulate(Unit.load("axis_a"), scenario).samples


def blocks_of(samples: Samples) -> list[Block]:
    """Numbered blocks of a tenth of a second."""
    starts = range(0, len(samples), ROWS)
    return [Block(AXIS, samples.rows(k, k + ROWS), k // ROWS, "", 0.0) for k in starts]


def shifted(blocks: Sequence[Block], seconds: float) -> list[Block]:
    """The same by a sender's clock that was set."""
    return [replace(b, samples=Samples(b.samples.time + seconds, b.samples.columns)) for b in blocks]


class Tcp:
    """A sender of lines; it waits where the service does not take more."""

    def __init__(self) -> None:
        self.port = free_port()
        self.source: dict[str, Any] = {"type": "tcp", "port": self.port}

    def connect(self) -> None:
        self._link = socket.create_connection(("127.0.0.1", self.port), 10.0)
        self._link.settimeout(300.0)

    def send(self, blocks: Sequence[Block]) -> None:
        for block in blocks:
            self._link.sendall(encode_json(block) + b"\n")

    def close(self) -> None:
        self._link.close()


class Mqtt:
    """A broker that keeps its sessions on disk, and a sender at QoS 1."""

    def __init__(self, folder: Path) -> None:
        self.broker = Broker(folder, lasting=True)
        self.source: dict[str, Any] = {
            "type": "mqtt", "host": "127.0.0.1", "port": self.broker.port, "topics": ["rigs/{axis}"],
        }  # fmt: skip

    def connect(self) -> None:
        self._client = paho.Client(paho.CallbackAPIVersion.VERSION2, client_id="sender", clean_session=False)
        self._client.reconnect_delay_set(1, 2)
        self._client.connect("127.0.0.1", self.broker.port)
        self._client.loop_start()

    def send(self, blocks: Sequence[Block]) -> None:
        for block in blocks:
            self._client.publish(f"rigs/{block.axis}", encode_json(block), qos=1)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()
        self.broker.stop()


Sender = Tcp | Mqtt


def process_in(folder: Path, sources: list[dict[str, Any]]) -> Process:
    """`fdd serve` with a clock of its own."""
    process = Process(folder, sources)
    process.clock.write_text("0")
    return process


@dataclass(frozen=True)
class Outcome:
    """What became of one trouble.

    `said`: by the service while it lasted. `sent`, `accepted`, `lost`: samples. `wrong`: what is not as it
    should be; empty where all is.
    """

    tried: str
    how: str
    said: str
    sent: int
    accepted: int
    lost: int
    wrong: Sequence[str] = ()


@dataclass(frozen=True)
class Trouble:
    """What is tried.

    `words`: of the line that `/api/health` must say meanwhile, None where all goes on as before. `change`: of
    the blocks, where the sender is at fault. `disk`: MiB of a disk of its own (root alone).
    """

    tried: str
    during: Callable[[Process, Any], AbstractContextManager[None]]
    words: str | None = None
    mqtt: bool = False
    disk: int | None = None
    change: Callable[[list[Block]], list[Block]] = lambda blocks: blocks

    def attempt(self) -> Outcome:
        """Try it in a folder of its own."""
        with ExitStack() as kept:
            folder = Path(kept.enter_context(tempfile.TemporaryDirectory(prefix="fdd-troubles-")))
            if self.disk is not None:
                (folder / "state").mkdir()
                size = f"size={self.disk}m"
                subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", folder / "state"], check=True)
                kept.callback(lambda: subprocess.run(["umount", "-l", folder / "state"], check=True))
            sender = Mqtt(folder) if self.mqtt else Tcp()
            process = process_in(folder, [sender.source])
            return self._attempt(process, sender)

    def _attempt(self, process: Process, sender: Sender) -> Outcome:
        blocks = self.change(blocks_of(leaking()))
        third, wrong = len(blocks) // 3, list[str]()
        ends = (third, 2 * third, len(blocks))
        first, second, sent = (sum(len(b.samples) for b in blocks[:k]) for k in ends)
        try:
            process.start()
            sender.connect()
            sender.send(blocks[:third])
            until(lambda: process.samples() >= first, ARRIVED_S)
            with self.during(process, sender):
                part = (blocks[third : 2 * third],)
                meanwhile = threading.Thread(target=sender.send, args=part, daemon=True)
                meanwhile.start()
                if self.words is None:
                    until(lambda: process.samples() >= second, ARRIVED_S)
                else:
                    until(process.problems, 20.0)
                said, slowest = "; ".join(process.problems()) or "ok", 0.0
                for path in ("/api/axes", "/api/alarms", "/metrics", "/"):
                    begun = time.monotonic()
                    if process.get(path) is None:
                        wrong.append(f"{path} is not answered meanwhile")
                    slowest = max(slowest, time.monotonic() - begun)
                if (self.words or "ok") not in said:
                    wrong.append(f"health should say {self.words or 'ok'!r}")
                errors = process.metric("fdd_store_errors_total")
                if process.popen.poll() is not None:
                    wrong.append(f"it ended with status {process.popen.poll()}")
            meanwhile.join(ARRIVED_S)
            sender.send(blocks[2 * third :])
            until(lambda: process.samples() >= sent, ARRIVED_S)
            after = until(lambda: not process.problems(), 30.0)
            if not after:
                wrong.append(f"afterwards health says {'; '.join(process.problems())!r}")
            time.sleep(2.0)
            accepted = process.samples()
        finally:
            sender.close() if isinstance(sender, Tcp) else None
            process.kill()
        how = " ".join((self.during.__doc__ or "").split())
        said = f"{said}; {errors:.0f} store errors; slowest answer {slowest:.1f} s".replace(
            str(process.folder), "…"
        )
        return self._after(process, sender, Outcome(self.tried, how, said, sent, accepted, 0, wrong))

    def _after(self, process: Process, sender: Sender, so_far: Outcome) -> Outcome:
        """What is there after a kill and another start."""
        wrong = list(so_far.wrong)
        process.start()
        # What the journal has of an unfinished frame is counted once the axis is silent.
        until(lambda: process.samples() >= so_far.accepted, 20.0)
        found = process.samples()
        status = process.end()
        if isinstance(sender, Mqtt):
            sender.close()
        if status != 0:
            wrong.append(f"SIGTERM ends it with status {status}")
        findings, actions = process.told()
        if [fault for fault, _ in findings] != ["internal_leakage"] or actions.count("RAISED") != 1:
            wrong.append(f"findings {findings}, alarms {actions}")
        if so_far.accepted != so_far.sent:
            wrong.append(f"{so_far.sent - so_far.accepted} samples were never taken")
        wrong += [f"its log: {line[:200]}" for line in process.lines("Traceback|internal error")]
        return replace(so_far, lost=so_far.accepted - found, wrong=wrong)
