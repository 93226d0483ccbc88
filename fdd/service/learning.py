"""An axis whose unit has no healthy logs: its first healthy hours make its baseline."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from fdd.diagnosis.baseline import baseline_of
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S, BinMaker
from fdd.residuals.effects import first_effects
from fdd.samples import Samples
from fdd.unit import Unit

Array = NDArray[np.float64]

MOVES = 0.2
"""Share of frames whose oil tells anything, below which an axis has hardly worked yet."""


class Learning:
    """Gather the balances of a unit whose own are not known yet.

    Parameters
    ----------
    unit : profile without baseline. seconds : of work after which it is learnt.

    Examples
    --------
    >>> Learning(Unit.load("axis_a"), 1200.0).learnt() is None
    True
    """

    def __init__(self, unit: Unit, seconds: float) -> None:
        self.unit, self.seconds = unit, seconds
        self._start_anew()

    def _start_anew(self) -> None:
        self._bins = BinMaker(self.unit)
        self._history = BalanceHistory(
            self.unit, {name: first_effects(name, unit=self.unit) for name in BALANCES}
        )

    def push(self, samples: Samples) -> None:
        """Take samples of a unit that nothing is known to be wrong with."""
        for first, bins in self._bins.stretches(samples):
            self._history.push(first, bins)

    def forget(self) -> None:
        """Something is wrong with it: what came so far is no baseline."""
        self._start_anew()

    def learnt(self) -> Unit | None:
        """The profile with its baseline, once it has worked for long enough."""
        worked = FRAME_S * sum(frame.rows > 0.0 for frame in self._history.equations["volume"])
        if worked < MOVES * self.seconds or FRAME_S * len(self._history.frames) < self.seconds:
            return None
        out = self.unit.model_copy(deep=True)
        out.baseline = baseline_of([self._history])
        return out

    def state(self) -> dict[str, Array]:
        """All of it as named arrays."""
        bins = {f"bins:{k}": v for k, v in self._bins.state().items()}
        return bins | {f"history:{k}": v for k, v in self._history.state().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from what `state` gave."""
        for prefix, part in (("bins:", self._bins), ("history:", self._history)):
            part.restore({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
