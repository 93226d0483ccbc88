"""What signals do, whatever they are called: who is whose integral or difference, who leads, which one turns.

The physics is the volume balance of a cylinder that a pump moves (thesis, eq. 3.2): the piston follows the
pump's angle, what leaks and compresses rises with the pressure difference, and the side that is pumped into
is the one whose pressure rises. It holds in any unit of measure, so units follow from it, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from fdd.logs.channel_map import directed, unwrap_counts
from fdd.samples import Column

WINDOW_S = 0.1
"""s, over which motion is summed up: longer than the pressures' build-up, shorter than a stroke."""
LEAST_WINDOWS = 50
LEAST_TURNS = 5
A_JUMP = 0.6
"""Share of the range by which an angle falls back where it begins again."""
AGREE = 0.02
"""Falls and the steps around them give the counts of a turn; they agree so well where it is an angle."""
SNAP = 0.005
"""An encoder's own error of linearity, within which the counts of a turn are one of the usual figures."""
_DECADES = (1.0, 1.25, 2.0, 2.5, 3.6, 5.0)
MOST_STATES = 5
"""A valve has a few states; a signal of more values is none."""
FOLLOWS, MORE = 0.8, 0.3
"""Correlation of the directed angle with some position, and how much more that is than without direction."""


@dataclass
class Signals:
    """Signals at `time`, (n,) s; `columns`: name to (n,) raw values, NaN where one is missing.

    Methods take a signal's name, or a column (n,) itself.
    """

    time: Column
    columns: dict[str, Column]

    @cached_property
    def _edges(self) -> NDArray[np.intp]:
        # Not more than rows, whatever a damaged stamp says; nor beyond the last, where a span overflows.
        count = max(2, int(min((self.time[-1] - self.time[0]) / WINDOW_S, self.time.size)))
        at = np.searchsorted(self.time, np.linspace(self.time[0], self.time[-1], count))
        return np.unique(np.minimum(at, self.time.size - 1))

    def filled(self, signal: str | Column) -> Column:
        """(n,) missing values on the line between their neighbours; zeros where there are none."""
        values = self.columns[signal] if isinstance(signal, str) else signal
        there = np.isfinite(values)
        if there.all():
            return values
        at = np.arange(values.size)
        return np.interp(at, at[there], values[there]) if there.any() else np.zeros_like(values)

    def changes(self, signal: str | Column) -> Column:
        """(k,) changes of a signal over each window."""
        return np.diff(self.filled(signal)[self._edges])

    def sums(self, signal: str | Column) -> Column:
        """(k,) integrals of a signal over each window, its unit times s."""
        values, steps = self.filled(signal), np.diff(self.time)
        # Over a hole in the log a sample says nothing about what came between.
        steps = np.minimum(steps, 10.0 * float(np.median(steps)))
        total = np.concatenate(([0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * steps)))
        return np.diff(total[self._edges])

    def means(self, signal: str | Column) -> Column:
        """(k,) means over each window."""
        total = np.concatenate(([0.0], np.cumsum(self.filled(signal))))
        return np.diff(total[self._edges]) / np.diff(self._edges)

    def follows(self, integral: str, rate: str) -> float:
        """How well one signal is the other's integral: correlation over windows; its sign tells the way."""
        return correlation(self.changes(integral), self.sums(rate))

    def alike(self, a: str, b: str) -> float:
        """Correlation of the window means of two signals."""
        return correlation(self.means(a), self.means(b))

    def gain(self, integral: str, rate: str) -> tuple[float, float]:
        """Units of `integral` per unit of `rate` and s, and its standard error."""
        return _slope(self.changes(integral), self.sums(rate), 1)

    def slope(self, wanted: str, of: str) -> tuple[float, float]:
        """Slope and standard error of one signal's window means over another's, with a constant beside it.

        Windows in which the second changes little are enough where there are some: a drive follows a fast
        demand with less than its amplitude.
        """
        y, x = self.means(wanted), self.means(of)
        if x.size:
            calm = np.abs(self.changes(of)) < 0.02 * float(np.ptp(x))
            calm &= np.concatenate(([True], calm[:-1]))
            if calm.sum() >= LEAST_WINDOWS and float(np.ptp(x[calm])) > 0.3 * float(np.ptp(x)):
                y, x = y[calm], x[calm]
        return _slope(y - y.mean(), x - x.mean(), 2)

    def difference(self, names: list[str]) -> tuple[str, str, str] | None:
        """Of pressures in one unit the one that varies as a second less a third, and these two."""
        found = []
        for d, one, two in permutations(names, 3):
            spread = float(np.std(self.means(d)))
            rest = float(np.std(self.means(d) - (self.means(one) - self.means(two))))
            if spread > 0.0 and rest < 0.2 * spread:
                found.append((rest / spread, d, one, two))
        return min(found, key=lambda row: row[0])[1:] if found else None

    def rises_with_pumping(self, drop: Column, position: str, theta: Column) -> float:
        """Student's t of a pressure difference's rise with the oil that the pump gives beyond the motion.

        The flow that does not go into motion leaks and compresses: ``theta - x / k = L * integral of drop +
        C * change of drop``, with both L and C above zero for the difference of the side that a positive pump
        motion fills. Gain, leakage and compliance are fitted together, so that no load can mislead it; out
        and back have a gain each, as the two sides of a piston may differ in area.

        `drop`: (n,) pressure difference in any unit, or one chamber's pressure (less than zero for the side
        that is emptied). `theta`: (k,) how far the pump turned in each window.
        """
        x = self.changes(position)
        if theta.size < LEAST_WINDOWS:
            return 0.0
        parts = (np.maximum(x, 0.0), np.minimum(x, 0.0), self.sums(drop), self.changes(drop))
        scaled = np.column_stack(parts)
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

    def leads(self, first: str, second: str) -> float:
        """Rows by which the first signal comes before the second, at their best correlation."""
        a, b = self.filled(first), self.filled(second)
        n = min(a.size, 60_000)
        a, b = np.diff((a - a.mean())[:n]), np.diff((b - b.mean())[:n])
        size = 1 << (2 * n - 1).bit_length()
        cross = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size)
        return float(np.argmax(np.abs(np.concatenate([cross[-50:], cross[:51]]))) - 50)

    def roughness(self, name: str) -> float:
        """Share of a signal's steps from row to row that are no motion: its noise, relative to its range."""
        values = self.filled(name)
        bends, spread = np.diff(values, 2), float(np.ptp(values))
        return float(np.median(np.abs(bends)) / spread) if spread > 0.0 and bends.size else 0.0


def correlation(a: Column, b: Column) -> float:
    """Pearson's, or 0 where one of them stands still."""
    if a.size < 3 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _slope(y: Column, x: Column, fitted: int) -> tuple[float, float]:
    """Slope through the origin and its standard error, where so many parameters were fitted."""
    square = max(float(x @ x), 1e-300)
    slope = float(x @ y / square)
    rest = y - slope * x
    return slope, float(np.sqrt(rest @ rest / max(x.size - fitted, 1) / square))


@dataclass(frozen=True)
class Shaft:
    """An angle that begins again each turn: its name, and counts a turn.

    `direction`: the signal whose sign it has, or None. `turned`: (n,) counts, unwrapped and with that sign.
    """

    signal: str
    wrap: float
    direction: str | None
    turned: Column


def counts_a_turn(values: Column) -> float | None:
    """Counts after which a saw-tooth begins again; None where a signal is none.

    Between two falls an angle goes on as before, so each fall and the steps beside it give the counts of a
    turn. They agree with each other and with the range of the (n,) raw values, which those of a spike or a
    switch do not.
    """
    there = values[np.isfinite(values)]
    spread = float(np.ptp(there)) if there.size else 0.0
    steps = np.diff(there)
    falls = np.flatnonzero(np.abs(steps) > A_JUMP * spread)
    falls = falls[(falls > 0) & (falls < steps.size - 1)]
    if spread == 0.0 or falls.size < LEAST_TURNS or falls.size > 0.2 * steps.size:
        return None
    turns = np.abs(steps[falls] - 0.5 * (steps[falls - 1] + steps[falls + 1]))
    turn = float(np.median(turns))
    moving = float(np.median(np.abs(steps[falls - 1])))
    if float(np.median(np.abs(turns - turn))) > AGREE * turn or abs(turn / spread - 1.0) > 0.1 or not moving:
        return None
    usual = [1.0, 2.0 * np.pi, 360.0]
    if np.all(there == np.round(there)):
        usual = [2.0 ** round(np.log2(turn)), *(m * 10.0 ** np.floor(np.log10(turn)) for m in _DECADES)]
    nearest = min(usual, key=lambda u: abs(np.log(u / turn)))
    return float(nearest) if abs(nearest / turn - 1.0) < SNAP else float(f"{turn:.4g}")


def find_shaft(data: Signals, angles: list[str], positions: list[str], valves: list[str]) -> Shaft | None:
    """The saw-tooth among signals that may be angles, with the direction without which nothing follows it."""
    wraps = ((name, counts_a_turn(data.columns[name])) for name in angles)
    name, wrap = next((pair for pair in wraps if pair[1] is not None), ("", None))
    if wrap is None:
        return None
    plain = unwrap_counts(data.columns[name], wrap)
    places = [data.changes(n) for n in positions if n != name]

    def followed(turned: Column) -> float:
        """The largest correlation of a motion with the angle's."""
        return max((abs(correlation(place, data.changes(turned))) for place in places), default=0.0)

    best: tuple[float, str | None, Column] = (max(followed(plain) + MORE, FOLLOWS), None, plain)
    for valve in valves:
        states = np.unique(data.columns[valve][np.isfinite(data.columns[valve])])
        if states.size <= MOST_STATES and states.min() < 0.0 < states.max():
            way = directed(plain, data.columns[valve], accumulate=True)
            best = max(best, (followed(way), valve, way), key=lambda row: row[0])
    return Shaft(name, wrap, best[1], best[2])
