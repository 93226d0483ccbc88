"""A leaking axis as blocks, and a fleet that watches it; also run as a program that tests kill."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from fdd.diagnosis.model import Model
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.bus import Bus
from fdd.service.fleet import Fleet
from fdd.service.inbox import Inbox
from fdd.service.profiles import Profiles
from fdd.service.store import Store
from fdd.unit import Unit

ROWS = 100
RECEIVED = 1.7e9


def leaking(seconds: float = 60.0, onset: float = 30.0) -> Samples:
    """A run of the shipped axis that leaks from `onset` on."""
    faults = [{"fault": "internal_leakage", "severity": 0.8, "onset": onset}]
    scenario = Scenario(duration=seconds, load={"name": "spring"}, faults=faults, seed=5)
    return simulate(Unit.load("axis_a"), scenario).samples


def blocks_of(samples: Samples, axis: str = "A1") -> list[Block]:
    """Numbered blocks of a tenth of a second."""
    return [
        Block(axis, samples.rows(k, k + ROWS), k // ROWS, "test", RECEIVED + float(samples.time[k]))
        for k in range(0, len(samples), ROWS)
    ]


def fleet_of(store: Store, model: Model | None = None, **more: object) -> tuple[Fleet, Inbox, Bus]:
    """A fleet of shipped axes that has gone on from its store."""
    bus, inbox = Bus(), Inbox(most_seconds=1e9)
    given = {"profiles": Profiles(fallback="axis_a"), "clock": lambda: RECEIVED + 1e4, "zone": "UTC"} | more
    fleet = Fleet(model=model or Model.load(), store=store, bus=bus, inbox=inbox, **given)  # type: ignore[arg-type]
    fleet.resume()
    return fleet, inbox, bus


def send(fleet: Fleet, inbox: Inbox, blocks: list[Block]) -> None:
    """Put blocks in one after the other, and let the fleet work each."""
    for block in blocks:
        inbox.put(block)
        fleet.step(0.0)


@contextmanager
def working(fleet: Fleet) -> Iterator[None]:
    """Let it step in a thread of its own, as others ask it."""
    stop = threading.Event()

    def work() -> None:
        while not stop.is_set():
            fleet.step(0.01, stop)

    worker = threading.Thread(target=work)
    worker.start()
    try:
        yield
    finally:
        stop.set()
        worker.join()


def main(url: str, log: str) -> None:
    """Go on with a log where the store has it, and say each block that was accepted."""
    with np.load(log) as stored:
        samples = Samples(stored["time"], {n: stored[n] for n in stored.files if n != "time"})
    store = Store(url)
    fleet, inbox, _ = fleet_of(store)
    print("ready", flush=True)
    for block in blocks_of(samples):
        told = lambda number=block.sequence: print(number, flush=True)  # noqa: E731
        send(fleet, inbox, [replace(block, accepted=told)])
    fleet.keep()
    print("done", flush=True)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    main(sys.argv[1], sys.argv[2])
