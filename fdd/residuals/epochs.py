"""The balances over an axis's life: normal equations of the frames that left the window, summed by epoch.

The reference of a log follows healthy changes of a unit, and slow wear with them. So the time between two
stops, or an hour, is kept as an epoch: one draw of the log-to-log variation (`Effects.between`), however many
frames it has. Over many epochs a slow change shows that no single one would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S
from fdd.residuals.compiled import Array
from fdd.residuals.effects import Effects, usual_conditions
from fdd.residuals.normal_equations import marginalised
from fdd.restorable import Restorable

BalanceSums = Mapping[str, tuple[Array, Array]]

EPOCH_FRAMES, LEAST_EPOCH_FRAMES = 7200, 240
"""Frames of an epoch: an hour's at most, and at a stop two minutes' at least, as a log from which a unit is
identified."""
EPOCHS_EACH = 16
"""Epochs of one length; beyond them the two oldest become one of twice the length. So a memory of years
takes ten times as many, and an onset is known to a fifteenth of its age or better."""


class Epochs(Restorable):
    """Normal equations of each epoch and balance; the last epoch may be incomplete."""

    STATE = ("_first", "_levels", "_open", "_sums", "completed")

    def __init__(self) -> None:
        self._first: list[int] = []
        self._levels: list[int] = []
        self._open = 0
        """Frames of the last epoch, while it is not complete."""
        self._sums: list[dict[str, tuple[Array, Array]]] = []
        self.completed = 0
        """Epochs that were ever completed."""

    def add(self, frames: Sequence[int], sums: BalanceSums) -> None:
        """Take indices of frames, and sums over them of each balance's information (n, n), vectors (n,)."""
        if not self._open:
            self._first.append(frames[0])
            self._levels.append(0)
            self._sums.append({})
        self._open += len(frames)
        self._sums[-1] = _added(self._sums[-1], sums)
        if self._open >= EPOCH_FRAMES:
            self._complete()

    def stop(self) -> None:
        """The axis has stopped: the next frame begins another epoch."""
        if self._open >= LEAST_EPOCH_FRAMES:
            self._complete()

    def _complete(self) -> None:
        """End the last epoch; of those of one length beyond `EPOCHS_EACH`, the two oldest become one."""
        self._open = 0
        self.completed += 1
        for level in range(max(self._levels) + 1):
            mine = [k for k, have in enumerate(self._levels) if have == level]
            if len(mine) > EPOCHS_EACH:
                k = mine[0]
                self._sums[k] = _added(self._sums[k], self._sums.pop(k + 1))
                self._levels[k] += 1
                del self._first[k + 1], self._levels[k + 1]

    def forget(self, start: float, end: float) -> None:
        """Leave out the epochs that began in a stretch of time, s."""
        for k in range(len(self) - 1, -1, -1):
            if start <= self._first[k] * FRAME_S < end:
                del self._first[k], self._levels[k], self._sums[k]

    def __len__(self) -> int:
        """Complete epochs at hand."""
        return len(self._first) - (self._open > 0)

    def starts(self) -> Array:
        """s, when each complete epoch began."""
        return FRAME_S * np.array(self._first[: len(self)], dtype=np.float64)

    @staticmethod
    def effects(effects: Mapping[str, Effects]) -> dict[str, Effects]:
        """A unit's effects for epochs: each is a draw of what differs between logs and changes in minutes."""
        return {
            name: replace(
                e,
                information=np.eye(e.mean.size),
                scatter=np.eye(e.mean.size),
                log_variance=np.zeros(e.mean.size),  # marginalised in each epoch
                within=np.zeros(e.mean.size),
                warming=0.0,
            )
            for name, e in effects.items()
        }

    def marginalised(self, effects: Mapping[str, Effects]) -> dict[str, tuple[Array, Array]]:
        """Information (e, n, n) and vectors (e, n) of the complete epochs of each informative balance,
        what differs between logs marginalised."""
        out = {}
        for name in BALANCES:
            if any(name in sums for sums in self._sums[: len(self)]):
                n = len(BALANCES[name].columns)
                none = np.zeros((n, n)), np.zeros(n)
                m, v = zip(*(t.get(name, none) for t in self._sums[: len(self)]), strict=True)
                e = effects[name]
                std = np.sqrt(e.between_logs(usual_conditions(e.noise)))
                out[name] = marginalised(np.array(m), np.array(v), std)
        return out


def _added(one: BalanceSums, other: BalanceSums) -> dict[str, tuple[Array, Array]]:
    out = dict(one)
    for name, (m, v) in other.items():
        have = out.get(name)
        out[name] = (m, v) if have is None else (have[0] + m, have[1] + v)
    return out
