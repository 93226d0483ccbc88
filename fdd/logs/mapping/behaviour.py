"""What signals do, whatever they are called: who is whose integral or difference, and who leads.

The physics is the volume balance of a cylinder that a pump moves (thesis, eq. 3.2): the piston follows the
pump's angle, what leaks and compresses rises with the pressure difference, and the side that is pumped into
is the one whose pressure rises. It holds in any unit of measure, so units follow from it, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from fdd.samples import Column

WINDOW_S = 0.1
"""s, over which motion is summed up: longer than the pressures' build-up, shorter than a stroke."""
LEAST_WINDOWS = 50


@dataclass(frozen=True)
class Signals:
    """Signals on one time base.

    Attributes
    ----------
    time : (n,) s. columns : name to (n,) raw values; NaN where one is missing.
    """

    time: Column
    columns: dict[str, Column]

    def changes(self, name: str) -> Column:
        """(k,) changes of a signal over each window."""
        return np.diff(_filled(self.columns[name])[self._edges()])

    def sums(self, name: str) -> Column:
        """(k,) integrals of a signal over each window, its unit times s."""
        values = _filled(self.columns[name])
        steps = np.diff(self.time)
        # Over a hole in the log a sample says nothing about what came between.
        steps = np.minimum(steps, 10.0 * float(np.median(steps)))
        total = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * steps)))
        return np.diff(total[self._edges()])

    def means(self, name: str) -> Column:
        """(k,) means over each window."""
        at = self._edges()
        total = np.concatenate(([0.0], np.cumsum(_filled(self.columns[name]))))
        return np.diff(total[at]) / np.diff(at)

    def _edges(self) -> NDArray[np.intp]:
        # Not more than rows, whatever a damaged stamp says; nor beyond the last, where a span overflows.
        count = max(2, int(min((self.time[-1] - self.time[0]) / WINDOW_S, self.time.size)))
        at = np.searchsorted(self.time, np.linspace(self.time[0], self.time[-1], count))
        return np.unique(np.minimum(at, self.time.size - 1))


def _filled(values: Column) -> Column:
    """Missing values on the line between their neighbours; zeros where there are none."""
    there = np.isfinite(values)
    if there.all():
        return values
    if not there.any():
        return np.zeros_like(values)
    at = np.arange(values.size)
    return np.interp(at, at[there], values[there])


def correlation(a: Column, b: Column) -> float:
    """Pearson's, or 0 where one of them stands still."""
    if a.size < 3 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def follows(signals: Signals, integral: str, rate: str) -> float:
    """How well one signal is the other's integral: their correlation over windows; its sign tells the way."""
    return correlation(signals.changes(integral), signals.sums(rate))


def gain(signals: Signals, integral: str, rate: str) -> tuple[float, float]:
    """Units of `integral` per unit of `rate` and s, and its standard error."""
    return _slope(signals.changes(integral), signals.sums(rate), 1)


def _slope(y: Column, x: Column, fitted: int) -> tuple[float, float]:
    """Slope through the origin and its standard error, where so many parameters were fitted."""
    square = max(float(x @ x), 1e-300)
    slope = float(x @ y / square)
    rest = y - slope * x
    return slope, float(np.sqrt(rest @ rest / max(x.size - fitted, 1) / square))


def slope_of(signals: Signals, wanted: str, of: str) -> tuple[float, float]:
    """Slope and standard error of one signal's window means over another's, with a constant beside it.

    Windows in which the second changes little are enough where there are some: a drive follows a fast
    demand with less than its amplitude.
    """
    y, x = signals.means(wanted), signals.means(of)
    moved = np.abs(signals.changes(of))
    calm = moved < 0.02 * float(np.ptp(x)) if x.size else np.zeros(0, dtype=bool)
    calm &= np.concatenate(([True], moved[:-1] < 0.02 * float(np.ptp(x)))) if x.size else calm
    if calm.sum() >= LEAST_WINDOWS and float(np.ptp(x[calm])) > 0.3 * float(np.ptp(x)):
        y, x = y[calm], x[calm]
    return _slope(y - y.mean(), x - x.mean(), 2)


def difference(signals: Signals, names: list[str]) -> tuple[str, str, str] | None:
    """The signal that varies as a second one less a third, and these two; None where none does.

    Parameters
    ----------
    names : signals that may be pressures in one unit.
    """
    found = []
    for d, one, two in permutations(names, 3):
        spread = float(np.std(signals.means(d)))
        rest = float(np.std(signals.means(d) - (signals.means(one) - signals.means(two))))
        if spread > 0.0 and rest < 0.2 * spread:
            found.append((rest / spread, d, one, two))
    return min(found, key=lambda row: row[0])[1:] if found else None


def rises_with_pumping(signals: Signals, drop: Column, position: str, pump: str, *, rate: bool) -> float:
    """Student's t of the rise of a pressure difference with the oil that the pump gives beyond the motion.

    The flow that does not go into motion leaks and compresses: ``theta - x / k = L * integral of drop +
    C * change of drop``, with both L and C above zero for the difference of the side that a positive pump
    motion fills. Gain, leakage and compliance are fitted together, so that no load can mislead it; out and
    back have a gain each, as the two sides of a piston may differ in area.

    Parameters
    ----------
    drop : (n,) pressure difference in any unit, or one chamber's pressure (less than zero for the side that
        is emptied). rate : whether `pump` is a speed, not an angle.
    """
    theta = signals.sums(pump) if rate else signals.changes(pump)
    both = Signals(signals.time, {**signals.columns, "drop": drop})
    x = signals.changes(position)
    leak, rise = both.sums("drop"), both.changes("drop")
    if theta.size < LEAST_WINDOWS:
        return 0.0
    scaled = np.column_stack([np.maximum(x, 0.0), np.minimum(x, 0.0), leak, rise])
    scaled /= np.maximum(np.abs(scaled).max(axis=0), 1e-300)
    gram = scaled.T @ scaled
    if np.linalg.cond(gram) > 1e12:
        return 0.0
    solved = np.linalg.solve(gram, scaled.T @ theta)
    rest = theta - scaled @ solved
    sigma = float(rest @ rest) / max(theta.size - 4, 1)
    spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(gram)), 0.0) * sigma)
    t = solved / np.maximum(spread, 1e-300)
    return float(np.sign(t[2] + t[3]) * max(abs(t[2]), abs(t[3])))


def leads(signals: Signals, first: str, second: str) -> float:
    """Rows by which the first signal comes before the second, at their best correlation."""
    a, b = (_filled(signals.columns[n]) for n in (first, second))
    a, b = a - a.mean(), b - b.mean()
    n = min(a.size, 60_000)
    a, b = np.diff(a[:n]), np.diff(b[:n])
    size = 1 << (2 * n - 1).bit_length()
    cross = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size)
    near = np.concatenate([cross[-50:], cross[:51]])
    return float(np.argmax(np.abs(near)) - 50)


def roughness(signals: Signals, name: str) -> float:
    """Share of a signal's steps from row to row that are no motion: its noise, relative to its range."""
    values = _filled(signals.columns[name])
    second = np.diff(values, 2)
    spread = float(np.ptp(values))
    return float(np.median(np.abs(second)) / spread) if spread > 0.0 and second.size else 0.0
