"""Whose an axis is and which unit, and the baseline that it learns where the unit has no healthy logs."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MOST_AXES
from fdd.diagnosis.baseline import baseline_of
from fdd.errors import InputError
from fdd.residuals.balance_history import BalanceHistory
from fdd.residuals.balances import BALANCES
from fdd.residuals.bins import FRAME_S, BinMaker
from fdd.residuals.effects import first_effects
from fdd.samples import Samples
from fdd.unit import Unit, shipped_units

Array = NDArray[np.float64]

MOVES = 0.2
"""Share of frames whose oil tells anything, below which an axis has hardly worked yet."""


@dataclass(frozen=True)
class Share:
    """Part `number` (from 0) of `of`, by a hash of the axis's name; all axes where nothing is said.

    Examples
    --------
    >>> [sum(Share(k, 2).has(f"A{n}") for n in range(100)) for k in range(2)]
    [51, 49]
    """

    number: int = 0
    of: int = 1

    def has(self, axis: str) -> bool:
        """Whether an axis is in it."""
        digest = hashlib.blake2b(axis.encode(), digest_size=8).digest()
        return int.from_bytes(digest) % self.of == self.number


class Profiles:
    """Profiles of a folder, or of a mapping from axes.

    A name that a block brings is looked up among the folder's files and the shipped profiles: it is never a
    path.

    Parameters
    ----------
    units : folder, or axis to profile (a file or a shipped one). fallback : profile of axes that have none.

    Raises InputError: a profile that is named here cannot be used.
    """

    def __init__(self, units: Path | dict[str, str] | None = None, fallback: str | None = None) -> None:
        self._units, self._fallback = units, fallback
        named = set(units.values()) if isinstance(units, dict) else set()
        for name in named | ({fallback} if fallback is not None else set()):
            _load(name)  # a misspelt one is told at the start, not by each axis that comes

    def find(self, axis: str, said: str | None) -> Unit:
        """The profile of an axis.

        Parameters
        ----------
        said : name that its blocks bring.

        Raises InputError: there is none.
        """
        if isinstance(self._units, dict):
            if axis in self._units:
                return _load(self._units[axis])
        elif self._units is not None:
            files = {p.stem: p for p in sorted(self._units.glob("*.yaml"))[:MOST_AXES]}
            for name in (said, axis, axis.replace("/", "_")):
                if name in files:
                    return _load(str(files[name]))
        if said is not None and said in shipped_units():
            return _load(said)
        if self._fallback is not None:
            return _load(self._fallback)
        raise InputError(
            f"axis {axis}: no profile{f' {said!r}' if said else ''}",
            mend="put one named like the axis into the units folder, or name a fallback",
        )


@cache
def _load(source: str) -> Unit:
    """A profile, read once for all its axes, which share it."""
    return Unit.load(source)


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
        self.forget()

    def forget(self) -> None:
        """Something is wrong with it: what came so far is no baseline."""
        effects = {name: first_effects(name, unit=self.unit) for name in BALANCES}
        self._bins, self._history = BinMaker(self.unit), BalanceHistory(self.unit, effects)

    def push(self, samples: Samples) -> None:
        """Take samples of a unit that nothing is known to be wrong with."""
        for first, bins in self._bins.stretches(samples):
            self._history.push(first, bins)

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
        parts = {"bins": self._bins.state(), "history": self._history.state()}
        return {f"{part}:{k}": v for part, state in parts.items() for k, v in state.items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Go on from what `state` gave."""
        for prefix, part in (("bins:", self._bins), ("history:", self._history)):
            part.restore({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
