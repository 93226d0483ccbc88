"""Axes' states for the store: whose turn it is, and what is written."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import replace

from fdd.service.axis import AxisWatch
from fdd.service.life import profile_key
from fdd.service.store import Transaction
from fdd.service.storing import Batch, Writer

CHECKPOINT_S, CHECKPOINT_AXIS_S = 1.0, 0.4
"""Least time between two checkpoints of an axis, and for each axis that there is: one takes some 20 ms, which
is 5 % of the processor's time. No block is lost for it: the journal holds what came since."""


class Checkpoints:
    """States of axes, with profiles and rollups.

    Parameters
    ----------
    model_sha256 : of the model that all are watched with. clock : Unix seconds.
    """

    def __init__(self, writer: Writer, model_sha256: str, clock: Callable[[], float]) -> None:
        self._writer, self._model_sha256, self._clock = writer, model_sha256, clock
        self._profiles = set[str]()

    def about(self, watch: AxisWatch) -> dict[str, str]:
        """What the store keeps of an axis."""
        shas = {"profile_sha256": watch.profile_sha256, "model_sha256": self._model_sha256}
        return {"unit": watch.unit.name, **shas}

    def due(self, axes: Iterable[AxisWatch], put_off: Container[str], now: float) -> list[AxisWatch]:
        """Those whose turn it is at a monotonic time (s), as many as their share of the time allows."""
        axes = list(axes)
        every = max(CHECKPOINT_S, CHECKPOINT_AXIS_S * len(axes))
        due = [w for w in axes if now - w.kept >= every and self.may(w) and not w.waits]
        turns = sorted((w for w in due if w.name not in put_off), key=lambda w: w.kept)
        return turns[: 1 + len(axes) // 50]

    def may(self, watch: AxisWatch) -> bool:
        """Whether an axis has a state that says more than the journal does."""
        return watch.name in self._writer.last_row and not watch.is_new

    def keep(self, watch: AxisWatch, batch: Batch) -> None:
        """Write an axis's state with a batch."""
        wall, parts = self._clock(), watch.rollups
        watch.rollups = []
        held = watch.checkpoint(wall)
        profile = None if watch.profile_sha256 in self._profiles else watch.unit.to_yaml()
        self._profiles.add(watch.profile_sha256)

        def write(t: Transaction) -> None:
            # The row's number is known only now that the blocks are in the journal.
            t.checkpoint(replace(held, sequence=self._writer.last_row[watch.name]))
            t.rollup(*parts)
            if profile is not None:
                t.meta(profile_key(watch.profile_sha256), profile)
            t.axis(watch.name, watch.last_wall or wall, last_time=held.time, **self.about(watch))

        batch.writes.append(write)
