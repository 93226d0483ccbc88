"""Which unit an axis is, and the baseline that it learns where the unit has no healthy logs."""

from __future__ import annotations

from functools import cache

from fdd.bounds import MOST_AXES
from fdd.diagnosis.baseline import baseline_of
from fdd.errors import InputError
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S, BinMaker
from fdd.residuals.effects import first_effects
from fdd.samples import Samples
from fdd.service.config import Serve
from fdd.unit import Unit, shipped_units

MOVES = 0.2
"""Share of frames whose oil tells anything, below which an axis has hardly worked yet."""


def profile_of(config: Serve, axis: str, said: str | None) -> Unit:
    """The profile of an axis, of the folder or the mapping of `serve.yaml`, a shipped one, or the fallback.

    What its blocks say is looked up among the folder's files and the shipped profiles: it is never a path.
    Raises InputError: there is none, or it cannot be used.
    """
    units = config.units
    if isinstance(units, dict):
        if axis in units:
            return _load(units[axis])
    elif units is not None:
        files = {p.stem: p for p in sorted(units.glob("*.yaml"))[:MOST_AXES]}
        for name in (said, axis, axis.replace("/", "_")):
            if name in files:
                return _load(str(files[name]))
    if said is not None and said in shipped_units():
        return _load(said)
    if config.fallback is not None:
        return _load(config.fallback)
    problem = f"axis {axis}: no profile{f' {said!r}' if said else ''}"
    raise InputError(problem, mend="put one named like the axis into the units folder, or name a fallback")


@cache
def _load(source: str) -> Unit:
    """A profile, read once for all its axes, which share it."""
    return Unit.load(source)


class Learning:
    """Gather the balances of a unit without baseline, until it has worked for so many seconds; its state is
    in `bins` and `history`.

    Examples
    --------
    >>> Learning(Unit.load("axis_a"), 1200.0).learnt() is None
    True
    """

    def __init__(self, unit: Unit, seconds: float) -> None:
        self.unit, self.seconds = unit, seconds
        self.forget()

    def forget(self) -> None:
        """Something is wrong with it: what came so far is no baseline."""
        effects = {name: first_effects(name, unit=self.unit) for name in BALANCES}
        self.bins, self.history = BinMaker(self.unit), BalanceHistory(self.unit, effects)

    def push(self, samples: Samples) -> None:
        """Take samples of a unit that nothing is known to be wrong with."""
        for first, bins in self.bins.stretches(samples):
            self.history.push(first, bins)

    def learnt(self) -> Unit | None:
        """The profile with its baseline, once it has worked for long enough."""
        worked = FRAME_S * sum(frame.rows > 0.0 for frame in self.history.equations["volume"])
        if worked < MOVES * self.seconds or FRAME_S * len(self.history.frames) < self.seconds:
            return None
        out = self.unit.model_copy(deep=True)
        out.baseline = baseline_of([self.history])
        return out
