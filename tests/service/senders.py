"""What tests of sources and outputs share: a fleet that stores what it takes, waiting, made-up alarms."""

import resource
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fdd.diagnosis.findings import FaultFinding
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.config import Serve
from fdd.service.order import Order
from fdd.service.queues import Event
from fdd.service.service import Service
from fdd.service.store import OutboxMessage, Store

LEAK = FaultFinding(
    fault="pump_wear", family="leakage", ambiguity=["pump_wear", "internal_leakage"], confidence=0.9,
    onset_s=3.0, detected_s=15.0, severity=0.6, severity_interval=(0.5, 0.7), evidence=["leakage rose"],
)  # fmt: skip


def until(done: Callable[[], Any], seconds: float = 120.0) -> Any:
    """Wait for what other threads do; what it gives then."""
    end = time.monotonic() + seconds
    while not (found := done()):
        assert time.monotonic() < end, "it did not come about in time"
        time.sleep(0.02)
    return found


def a_block(number: int, axis: str = "A1", *, rows: int = 10, seed: int = 0) -> Block:
    """Rows at 100 Hz that go on from block to block."""
    value = np.random.default_rng([seed, number]).standard_normal(rows)
    time = 0.01 * (number * rows + np.arange(rows))
    return Block(axis, Samples(time, {"position": value}), number, 0.0)


def ordered(blocks: Iterable[Block]) -> tuple[Samples, Order]:
    """What an order passes on of blocks that come in this order, and what it counted."""
    order = Order()
    return Samples.concatenate([*(order.take([b]) for b in blocks), order.flush()]), order


class Taker:
    """Keeps what sources put, and accepts it unless it is told not to."""

    def __init__(self) -> None:
        self.blocks: list[Block] = []
        self.accepting = True
        self._accepted = 0
        self._lock = threading.Lock()

    def put(self, block: Block) -> None:
        with self._lock:
            self.blocks.append(block)
        if self.accepting:
            self.accept()

    def accept(self) -> None:
        with self._lock:
            new, self._accepted = self.blocks[self._accepted :], len(self.blocks)
        for block in new:
            block.accepted()

    def numbers(self, axis: str = "A1") -> list[int | None]:
        return [b.sequence for b in self.blocks if b.axis == axis]

    def joined(self, axis: str = "A1") -> Samples:
        return Samples.concatenate([b.samples for b in self.blocks if b.axis == axis])


def message(kind: str, body: dict[str, Any], id: int = 7) -> OutboxMessage:
    return OutboxMessage(id, kind, body, 0)


def sent(store: Store, kind: str, body: Mapping[str, Any], target: str) -> int:
    with store.transaction() as t:
        return t.send(kind, body, target, 1.7e9)


def measured(axis: str, samples: Samples) -> Event:
    unit = SimpleNamespace(to_yaml=lambda: "name: x\n")
    return Event("samples", axis, float(samples.time[-1]), {"samples": samples, "unit": unit})


def finding(onset: float = 3.0, detected: float = 15.0) -> dict[str, Any]:
    return LEAK.model_copy(update={"onset_s": onset, "detected_s": detected}).model_dump(mode="json")


def transition(action="RAISED", state="UNACK", id=1, axis="A1", **of_finding: float) -> dict[str, Any]:
    alarm = {
        "id": id, "axis": axis, "state": state, "family": "leakage", "fault": "pump_wear", "priority": "high",
        "body": finding(**of_finding),
    }  # fmt: skip
    return {"action": action, "alarm": alarm, "before": "NORMAL", "wall": 1.7e9, "who": "fdd", "note": ""}


def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """Of this machine, signed by itself, and its key; without openssl the test is skipped."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl here, which makes a certificate")
    made = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2"
    cert, key = folder / f"{name}.pem", folder / f"{name}.key"
    given = ["-subj", f"/CN={name}", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", cert]
    subprocess.run(["openssl", *made.split(), *given], check=True, capture_output=True)
    return cert, key


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """The system cuts writes off at a size, as a disk does that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def serving(config: Serve) -> Iterator[Service]:
    stop, service = threading.Event(), Service(config)
    running = threading.Thread(target=service.run, args=(stop,))
    running.start()
    try:
        yield service
    finally:
        stop.set()
        running.join(60.0)
    assert not running.is_alive()
