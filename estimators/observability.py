"""Observability as an answer: what the last seconds told, which estimate may be used, and the last good one.

**Information.** Between two records a walk takes information away and data bring some. From
the variances alone, what the data brought is::

    gained_k = max(0, 1/P_k - 1/P_k|k-1),     P_k|k-1 = P_k-1 + what the walk added
    I_k      = sum of gained over the last seconds

``gained`` is what an information filter adds (Bar-Shalom, Li and Kirubarajan 2001, section 7.2, doi
10.1002/0471221279): of a single state ``h² / R`` for each measurement. Of a state among others it is what
they tell about *it*, to someone who knows the others as well as the filter does: little, while only a sum
shows. A variance that grows by more than the walk (a filter that was set free after a jump) gained nothing.

**Validity and holding.** An estimate becomes valid where its standard deviation falls below a share of its
value, and stays so until it exceeds a larger share. Then its last valid value is held, with a standard
deviation that grows with the walk and is never below the filter's own. Where the filter set itself free at
once, it had been misled for some time: then the value from before the last tenth of the window is held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimators.compiled import njit
from estimators.linalg import Array

Flags = NDArray[np.bool_]

# What is carried from record to record, for each quantity; then the window's information, in parts of it.
C_VARIANCE, C_SCALE, C_VALID, C_HELD, C_HELD_VARIANCE, C_SINCE = range(6)
C_EARLIER = 6  # what was held when this tenth of the window began: value, variance, since; not valid: NaN
C_EARLIEST = 9  # and when the tenth before began
C_PARTS = 12
PARTS = 10
SET_FREE = 1.5
"""A variance that grows by more than this factor beyond the walk: the filter no longer believes itself."""
CARRIED = C_PARTS + PARTS

# What is given for each record and quantity beside the flag, in the order of `Observed`.
_INFORMATION_STD, _HELD, _HELD_STD, _AGE = range(4)


@dataclass(frozen=True)
class Drift:
    """How a quantity may change by itself: ``dP/dt = rate (1 - P/ceiling)``; each field a number or (n,).

    Attributes
    ----------
    rate : variance added per second, unit²/s.
    ceiling : variance that the walk does not exceed, unit².
    scale : unit of the quantity per unit of the filter's state. Where it changes from record to record
        (leakage with the oil's viscosity), a standard deviation changes that no data changed.
    """

    rate: ArrayLike = 0.0
    ceiling: ArrayLike = math.inf
    scale: ArrayLike = 1.0


STEADY = Drift()
"""Of a constant."""


@dataclass(frozen=True)
class Observed:
    """What :class:`Observability` says of one quantity, (n,) each, one per record.

    Attributes
    ----------
    valid : the estimate is good for use.
    information_std : standard deviation that the last seconds alone would give; inf without any information.
    held : the estimate while valid, and its last valid value after; NaN before the first.
    held_std, age : standard deviation of `held`; s since the estimate was valid, NaN before the first.
    """

    valid: Flags
    information_std: Array = field(repr=False)
    held: Array = field(repr=False)
    held_std: Array = field(repr=False)
    age: Array = field(repr=False)


class Observability:
    """Follow what a filter knows of its parameters, from its estimates and standard deviations.

    Records may come one by one or in blocks of any size; the results are the same to the bit.

    Parameters
    ----------
    limits : ``{name: (valid_below, invalid_above)}``, standard deviation over value, 0 < first <= second.
    window : s, > 0, over which information is counted. It moves on by tenths of itself, so the last nine
        tenths of it count, and of the tenth before what there is since its begin.

    Raises ValueError: limits in the wrong order, or a window that is not positive.

    Examples
    --------
    A constant measured ten times a second with a standard deviation of 2, for 20 s; then no data, while
    it may drift by 0.1 per root second. Five seconds alone gave 2/√50 = 0.28:

    >>> time = 0.1 * np.arange(1, 401)
    >>> variance = 4.0 / np.minimum(np.arange(1, 401), 200) + 0.01 * np.maximum(time - 20.0, 0.0)
    >>> watch = Observability({"gain": (0.05, 0.06)})
    >>> gain = watch.push(time, {"gain": np.full(400, 5.0)}, {"gain": np.sqrt(variance)},
    ...                   {"gain": Drift(rate=0.01 * (time > 20.05))})["gain"]
    >>> gain.information_std[[198, 399]].round(2).tolist()
    [0.28, inf]
    >>> time[gain.valid][[0, -1]].round(1).tolist(), float(gain.age[-1].round(1))
    ([6.5, 26.9], 13.1)
    """

    def __init__(self, limits: Mapping[str, tuple[float, float]], *, window: float = 5.0) -> None:
        for name, (low, high) in limits.items():
            if not 0.0 < low <= high:
                raise ValueError(f"limits of {name} are ({low:g}, {high:g}); give 0 < first <= second")
        if not window > 0.0:
            raise ValueError(f"window is {window:g} s; give a positive time")
        self.limits = dict(limits)
        self.window = float(window)
        self._bounds = np.array([*self.limits.values()], dtype=np.float64).reshape(-1, 2)
        self._time = np.full(1, np.nan)
        self._carried = np.full((len(self.limits), CARRIED), np.nan)
        self._carried[:, C_PARTS:] = self._carried[:, [C_VALID]] = 0.0

    def push(
        self, time: ArrayLike, values: Mapping[str, ArrayLike], stds: Mapping[str, ArrayLike],
        drifts: Mapping[str, Drift] | None = None,
    ) -> dict[str, Observed]:  # fmt: skip
        """Take the next records; what each quantity shows at them.

        Parameters
        ----------
        time : (n,) s, not decreasing.
        values, stds : (n,) estimates and their standard deviations of each quantity in `limits`, after the
            data. What is not finite is not valid and brings nothing.
        drifts : how each may change; without an entry it is :data:`STEADY`. That of a record holds since
            the record before.

        Raises ValueError: a quantity missing, shapes that differ, a negative standard deviation or rate, or
            time running backwards. Nothing is taken then.
        """
        t = np.atleast_1d(np.asarray(time, dtype=np.float64))
        if t.ndim != 1 or not np.isfinite(t).all():
            raise ValueError(f"time of shape {t.shape} is not a row of finite numbers; give (n,)")
        if np.any(np.diff(t) < 0.0) or (t.size and t[0] < self._time[0]):
            raise ValueError("time runs backwards; give records in order, each once")
        n = t.size
        value, std = self._table(values, n, "values"), self._table(stds, n, "stds")
        if np.any(std < 0.0):
            raise ValueError("a standard deviation is negative; give square roots of variances")
        walks = [(drifts or {}).get(name, STEADY) for name in self.limits]
        rate, ceiling, scale = (
            _columns([getattr(walk, part) for walk in walks], n) for part in ("rate", "ceiling", "scale")
        )
        if not (np.all(rate >= 0.0) and np.all(ceiling > 0.0) and np.all((scale > 0.0) & (scale < np.inf))):
            raise ValueError("a drift has a negative rate, or a ceiling or scale that is not positive")
        valid = np.empty((len(self.limits), n), dtype=np.bool_)
        out = np.empty((4, len(self.limits), n))
        _observe(
            t, value, std, rate, ceiling, scale, self._bounds, self.window, self._time, self._carried,
            valid, out,
        )  # fmt: skip
        return {name: Observed(valid[i], *out[:, i]) for i, name in enumerate(self.limits)}

    def _table(self, given: Mapping[str, ArrayLike], n: int, what: str) -> Array:
        missing = [name for name in self.limits if name not in given]
        if missing:
            raise ValueError(f"{what} lack {', '.join(missing)}; give one for each of the limits")
        return _columns([given[name] for name in self.limits], n)

    def latest(self) -> dict[str, Observed]:
        """What the last record showed, (1,) each, also after `restore`; nothing is valid before the first."""
        c = self._carried
        with np.errstate(divide="ignore"):
            std = np.array([1.0 / np.sqrt(_total(row)) for row in c])
        out = np.array([std, c[:, C_HELD], np.sqrt(c[:, C_HELD_VARIANCE]), self._time - c[:, C_SINCE]])
        valid = c[:, C_VALID, None] > 0.0
        return {name: Observed(valid[i], *out[:, i : i + 1]) for i, name in enumerate(self.limits)}

    def state(self) -> dict[str, Array]:
        """Everything that changes, as arrays (copies)."""
        return {"time": self._time.copy(), "carried": self._carried.copy()}

    def restore(self, state: Mapping[str, ArrayLike]) -> None:
        """Take a state back that `state` gave; a ValueError, and nothing is taken, where it is of other
        quantities."""
        time = np.asarray(state["time"], dtype=np.float64)
        carried = np.asarray(state["carried"], dtype=np.float64)
        if time.shape != self._time.shape or carried.shape != self._carried.shape:
            raise ValueError(f"carried: shape {carried.shape} where {self._carried.shape} is wanted")
        self._time[:], self._carried[:] = time, carried


def _columns(parts: list[ArrayLike], n: int) -> Array:
    """(q, n) from a number or (n,) for each quantity."""
    return np.array([np.broadcast_to(np.asarray(p, float), n) for p in parts]).reshape(len(parts), n)


@njit(error_model="numpy")
def _grown(variance: float, rate: float, ceiling: float, seconds: float) -> float:
    """Variance after `seconds` of ``dP/dt = rate (1 - P/ceiling)``; what is above the ceiling stays."""
    if not (rate > 0.0 and variance < ceiling):
        return variance
    if math.isinf(ceiling):
        return variance + rate * seconds
    return variance - (ceiling - variance) * math.expm1(-rate * seconds / ceiling)


@njit(error_model="numpy")
def _total(carried: Array) -> float:
    """Information within the window."""
    total = 0.0
    for i in range(C_PARTS, CARRIED):
        total += carried[i]
    return total


@njit(error_model="numpy")
def _observe(
    time: Array, value: Array, std: Array, rate: Array, ceiling: Array, scale: Array, bounds: Array,
    window: float, last: Array, carried: Array, valid: Flags, out: Array,
) -> None:  # fmt: skip
    """Fill `valid` (q, n) and `out` (4, q, n), and bring `last` and `carried` up to date."""
    for k in range(time.size):
        seconds = 0.0 if math.isnan(last[0]) else time[k] - last[0]
        part = math.floor(time[k] * PARTS / window)
        passed = 0 if math.isnan(last[0]) else min(part - math.floor(last[0] * PARTS / window), PARTS)
        last[0] = time[k]
        for j in range(value.shape[0]):
            c = carried[j]
            ratio = 1.0 if math.isnan(c[C_SCALE]) else (scale[j, k] / c[C_SCALE]) ** 2
            c[C_SCALE] = scale[j, k]
            prior = _grown(c[C_VARIANCE] * ratio, rate[j, k], ceiling[j, k], seconds)
            for i in range(passed):
                c[C_PARTS + (part - i) % PARTS] = 0.0
            if ratio != 1.0:
                for i in range(C_PARTS, CARRIED):
                    c[i] /= ratio
            variance = std[j, k] * std[j, k]
            known = math.isfinite(variance) and math.isfinite(value[j, k])
            c[C_VARIANCE] = variance if known else prior
            # False for the first record, whose prior is NaN; a squared root's last bits tell nothing.
            if known and 0.0 < variance < prior * (1.0 - 1e-12):
                c[C_PARTS + part % PARTS] += 1.0 / variance - 1.0 / prior
            share = std[j, k] / max(abs(value[j, k]), 1e-300)
            limit = bounds[j, 1] if c[C_VALID] > 0.0 else bounds[j, 0]
            if passed > 0:
                for i in range(3):
                    c[C_EARLIEST + i] = c[C_EARLIER + i] if passed == 1 else math.nan
                    c[C_EARLIER + i] = c[C_HELD + i] if c[C_VALID] > 0.0 else math.nan
            good = known and (share <= limit if c[C_VALID] > 0.0 else share < limit)
            if c[C_VALID] > 0.0 and not good and known and variance > SET_FREE * prior:
                kept = C_EARLIEST if c[C_EARLIEST] == c[C_EARLIEST] else C_EARLIER
                if c[kept] == c[kept]:
                    for i in range(3):
                        c[C_HELD + i] = c[kept + i]
            c[C_VALID] = 1.0 if good else 0.0
            if good:
                c[C_HELD], c[C_HELD_VARIANCE], c[C_SINCE] = value[j, k], variance, time[k]
            else:
                c[C_HELD_VARIANCE] = _grown(c[C_HELD_VARIANCE], rate[j, k], ceiling[j, k], seconds)
                if known and variance > c[C_HELD_VARIANCE]:
                    c[C_HELD_VARIANCE] = variance
            valid[j, k] = good
            out[_INFORMATION_STD, j, k] = 1.0 / math.sqrt(_total(c))
            out[_HELD, j, k] = c[C_HELD]
            out[_HELD_STD, j, k] = math.sqrt(c[C_HELD_VARIANCE])
            out[_AGE, j, k] = time[k] - c[C_SINCE]
