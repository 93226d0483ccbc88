"""A leaking axis as blocks, and a fleet that watches it; also run as a program that tests kill."""

import random
import sys
from dataclasses import replace
from typing import Any

import numpy as np

from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.service.blocks import Block
from fdd.service.config import Serve
from fdd.service.fleet import Fleet
from fdd.service.queues import Bus
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
        Block(axis, samples.rows(k, k + ROWS), k // ROWS, RECEIVED + float(samples.time[k]))
        for k in range(0, len(samples), ROWS)
    ]


def made(store: Store, clock: Any = lambda: RECEIVED + 1e4, targets: Any = None, **more: Any) -> Fleet:
    """A fleet of shipped axes, with keys of serve.yaml."""
    plain = "schema: fdd.serve/1\nfallback: axis_a\nzone: UTC\nsources: [{type: udp, port: 0}]"
    config = Serve.from_yaml(f"{plain}\nlimits: {{inbox_seconds: 86400}}").model_copy(update=more)
    return Fleet(config, store, Bus(), targets, clock=clock)


def fleet_of(store: Store, **more: Any) -> Fleet:
    """The same, once it has gone on from its store."""
    fleet = made(store, **more)
    fleet.resume()
    return fleet


def send(fleet: Fleet, blocks: list[Block]) -> None:
    """Put blocks in one after the other, and let the fleet work each."""
    for block in blocks:
        fleet.inbox.put(block)
        fleet.step(0.0)


def settle(fleet: Fleet) -> None:
    """Let it work what it put off, as a busy machine makes it do, and keep what there is."""
    while fleet.catch_up():
        pass
    fleet.keep()


def passing(fleet: Fleet, ticking: list[float], *seconds: float) -> None:
    for each in seconds:
        ticking[0] += each
        fleet.step(0.0)


def disordered(samples: Samples, seed: int = 3) -> list[Block]:
    """Blocks of two axes in turn; some come before the one that they follow, some come twice."""
    rng = random.Random(seed)
    axes = [blocks_of(samples, axis) for axis in ("A1", "A2")]
    for blocks in axes:
        for k in range(0, len(blocks) - 3, 5):
            n = k + rng.randrange(3)
            blocks[n], blocks[n + 1] = blocks[n + 1], blocks[n]
    pairs = [block for pair in zip(*axes, strict=True) for block in pair]
    return [b for block in pairs for b in [block] * (1 + (rng.random() < 0.05))]


def main(url: str, log: str, seed: int) -> None:
    """Go on with a log near where the store has it, say which blocks are accepted; A2 is put off at times."""
    with np.load(log) as stored:
        samples = Samples(stored["time"], {n: stored[n] for n in stored.files if n != "time"})
    fleet = fleet_of(Store(url))
    rng = random.Random(seed)
    fleet.backlog.is_due = lambda now: True
    fleet.backlog.turn = lambda now, spare_s, waiting_s, followed: [
        name for name in followed if name == "A2" and rng.random() < 0.02
    ]
    begin = {status.name: status.samples // ROWS - 20 for status in fleet.axes()}
    print("ready", flush=True)
    for block in disordered(samples):
        if (block.sequence or 0) < begin.get(block.axis, 0):
            continue
        said = lambda of=block: print(of.axis, of.sequence, flush=True)  # noqa: E731
        send(fleet, [replace(block, accepted=said)])
        if rng.random() < 0.02:
            fleet.catch_up()
    settle(fleet)
    print("done", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]))
