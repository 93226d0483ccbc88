"""A tracker of an installed package beside ours: any filter with filterpy's interface (docs/extending.md).

It runs over the balances' bins of 10 ms, so that it sees the same numbers however a log was cut, and never
touches what fdd itself estimates.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimators.ekf import jacobian
from fdd.errors import InputError
from fdd.packages import TRACKERS, Addition, additions
from fdd.residuals.bins import BIN_S, COLUMNS, FAST, FRAME_BINS
from fdd.residuals.compiled import Array
from fdd.residuals.tracking import METHODS, OBSERVABLE
from fdd.unit import Unit

TAKEN = {name: COLUMNS[name] for name in FAST} | {"oil_temperature": COLUMNS["temperature"]}
"""Channel that a tracker may ask for, to its column of the bins."""


@dataclass
class Tracker:
    """What a package's factory gives: a filter, what goes into it, and what comes out.

    Attributes
    ----------
    filter : has filterpy's `predict`, called with ``u=`` where there are inputs, and `update`, which takes
        None where a measurement is missing. State and covariance are read as `x` (n,) or (n, 1) and `P`
        (n, n) after each period.
    measurements : channels of `update`'s argument, (m,) SI.
    quantities : of leakage, bulk_modulus, coulomb_friction and viscous_friction those that it estimates, each
        as a function of the state (n,) in SI. Standard deviations follow from `P`.
    inputs : channels of `predict`'s ``u``, (k,) SI; without any it is called with nothing.
    start : called with the first inputs and measurements before anything else: for states that a filter would
        be lost without.
    """

    filter: Any
    measurements: tuple[str, ...]
    quantities: Mapping[str, Callable[[Array], float]]
    inputs: tuple[str, ...] = ()
    start: Callable[[Array, Array], None] | None = None


def tracker_named(name: str) -> Addition:
    """The entry point of a tracker.

    Raises InputError: no installed package has one of this name, or several have.
    """
    found = additions(TRACKERS)
    mine = [a for a in found if a.name == name]
    if not mine:
        known = ", ".join(sorted({a.name for a in found}))
        raise InputError(
            f"no installed package has a tracker {name!r}",
            mend=f"there are: {known}" if known else "install one that has (docs/extending.md)",
        )
    if len(mine) > 1:
        raise mine[0].wrong(f"package {mine[1].package} has a tracker of this name too")
    if name in METHODS or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise mine[0].wrong("the name is fdd's own, or not of small letters, digits and underscores")
    return mine[0]


class AddedTracker:
    """Runs a package's tracker, by the name of its entry point, over bins, and keeps what it says.

    Raises InputError: no such tracker.
    """

    def __init__(self, name: str, unit: Unit) -> None:
        self._addition = tracker_named(name)
        self._make = self._addition.load()
        self.name, self.package, self.unit = name, self._addition.package, unit
        self.problem: str | None = None
        """Why it ended before the log did."""
        self._tracker: Tracker | None = None
        self._next = -1
        self._started = False
        self._last_input: Array = np.empty(0)
        self._rows = array("d")  # time, and of each of `OBSERVABLE` value and standard deviation

    def push(self, first: int, bins: Array) -> None:
        """Take bins of whole frames, and the first one's index, as `fdd.residuals.bins.BinMaker` gives them.

        Raises InputError: the package gave no usable tracker.
        """
        if not len(bins) or self.problem is not None:
            return
        if first != self._next or self._tracker is None:  # after a pause a tracker begins anew
            self._tracker, self._started = self._made(bins), False
        self._next = first + len(bins) // FRAME_BINS
        if self._tracker is None:
            return
        for k, values in enumerate(bins):
            time = (first * FRAME_BINS + k + 0.5) * BIN_S
            try:
                self._step(self._tracker, time, values)
            except Exception as error:  # a filter that fails ends itself, not the diagnosis
                brief = f"{type(error).__name__}: {error}"[:120]
                self.problem = f"tracker {self.name} ({self.package}) stopped at {time:.2f} s ({brief})"
                return

    def _made(self, bins: Array) -> Tracker | None:
        """The factory's tracker for the channels of these bins; None before the position has values."""
        channels = tuple(n for n, c in TAKEN.items() if np.isfinite(bins[:, c]).any())
        if "position" not in channels:
            return None
        try:
            made = self._make(self.unit, channels, BIN_S)
        except InputError as error:
            raise error.at(f"tracker {self.name}") from None
        except Exception as error:
            raise self._addition.wrong(f"cannot be made ({type(error).__name__}: {error})") from None
        if not isinstance(made, Tracker):
            raise self._addition.wrong(f"made a {type(made).__name__}, not a Tracker")
        if other := [n for n in (*made.measurements, *made.inputs) if n not in channels]:
            raise InputError(
                f"needs {', '.join(other)}, which this log does not have",
                where=f"tracker {self.name}",
                mend=f"leave it out; the log has: {', '.join(channels)}",
            )
        if not made.quantities or not set(made.quantities) <= set(OBSERVABLE):
            raise self._addition.wrong(f"tells {', '.join(made.quantities)}, not of {', '.join(OBSERVABLE)}")
        return made

    def _step(self, tracker: Tracker, time: float, values: Array) -> None:
        u, z = (values[[TAKEN[n] for n in names]] for names in (tracker.inputs, tracker.measurements))
        measured = np.isfinite(z).all()
        if np.isfinite(u).all():
            self._last_input = u
        if not self._started:
            if not (np.isfinite(u).all() and measured):
                return
            if tracker.start is not None:
                tracker.start(u, z)
            self._started = True
        tracker.filter.predict(**({"u": self._last_input} if tracker.inputs else {}))
        tracker.filter.update(z if measured else None)
        x = np.array(tracker.filter.x, dtype=np.float64).reshape(-1)
        covariance = np.asarray(tracker.filter.P, dtype=np.float64)
        if not (np.isfinite(x).all() and np.isfinite(covariance).all()):
            raise ArithmeticError("its state is no longer finite")
        row = [time]
        for name in OBSERVABLE:
            value = std = np.nan
            if quantity := tracker.quantities.get(name):
                (gradient,) = jacobian(quantity, x, covariance)
                value = float(quantity(x))
                std = math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))
            row += value, std
        self._rows.extend(row)

    def _table(self) -> tuple[Array, dict[str, Array]]:
        """Times (n,), and value and standard deviation (2, n) of each of `OBSERVABLE`."""
        table = np.array(self._rows).reshape(-1, 1 + 2 * len(OBSERVABLE)).T
        return table[0], dict(zip(OBSERVABLE, table[1:].reshape(len(OBSERVABLE), 2, -1), strict=True))

    def last(self) -> dict[str, tuple[float, float]]:
        """What it estimates, to value and standard deviation (SI) at the end; empty where it ended early."""
        time, found = self._table()
        if self.problem is not None or not time.size:
            return {}
        last = {name: pair[:, -1] for name, pair in found.items()}
        return {name: (pair[0], pair[1]) for name, pair in last.items() if np.isfinite(pair).all()}

    def over(self, time: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        """What it estimates, and standard deviations (SI), at times (n,); NaN before and after."""
        at, found = self._table()
        known = {name: pair for name, pair in found.items() if np.isfinite(pair).any()}
        values, stds = (
            {name: np.interp(time, at, pair[k], left=np.nan, right=np.nan) for name, pair in known.items()}
            for k in (0, 1)
        )
        return values, stds
