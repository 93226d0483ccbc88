"""What tests of the sources share: a fleet that stores what it takes, and waiting."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from fdd.samples import Samples
from fdd.service.blocks import Block


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
    return Block(
        axis, Samples(0.01 * (number * rows + np.arange(rows)), {"position": value}), number, "", 0.0
    )


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
        """Accept what was put and not accepted yet."""
        with self._lock:
            new, self._accepted = self.blocks[self._accepted :], len(self.blocks)
        for block in new:
            block.accepted()

    def numbers(self, axis: str = "A1") -> list[int | None]:
        """Sequence numbers of an axis as they came."""
        return [b.sequence for b in self.blocks if b.axis == axis]

    def joined(self, axis: str = "A1") -> Samples:
        """All samples of an axis."""
        return Samples.concatenate([b.samples for b in self.blocks if b.axis == axis])
