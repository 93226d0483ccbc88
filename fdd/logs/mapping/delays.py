"""Constant delays between channels: what a recorder filters, or takes late from another bus."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fdd.samples import Column

FARTHEST_S = 0.1
"""s; what is later comes from no recorder of one rig."""
COARSE_S = 0.004
STEP_S = 0.02
"""s over which motion and flow are summed up; delays are looked for in steps of `COARSE_S` first."""
LEAST_STEPS = 200
MOST_HOLES = 10
"""Periods a row that a log may span: one with more holes than that tells no delay."""
BETTER = 0.8
"""A delay explains at least a fifth of what the balance leaves open without it, and with the farthest one."""
SETTLED_ROWS = 2


def delays(time: Column, turned: Column, position: Column, drop: Column) -> tuple[float, float]:
    """By how much position and pressure come later than the pump's angle, s; 0 where nothing speaks for it.

    The volume balance holds at every instant (thesis, eq. 3.2): ``theta = x / k + L * integral of drop + C *
    drop``. Shifted against each other its terms leave more open. Both are shifted together, as one delay
    looks a little like the other, with gain, leakage and compliance fitted anew each time.

    Parameters
    ----------
    time : (n,) s. turned : (n,) rad, accumulated. position, drop : (n,) in any unit.

    Examples
    --------
    >>> t = np.arange(0.0, 20.0, 0.001)
    >>> flow, p = np.sin(3.0 * t) + np.sin(20.0 * t), np.sin(7.0 * t)
    >>> theta = np.cumsum(flow) * 1e-3 + 0.05 * p
    >>> moved = np.cumsum(flow) * 1e-3
    >>> late = np.interp(t - 0.012, t, moved)
    >>> [round(d, 3) for d in delays(t, theta, late, p)]
    [0.012, 0.0]
    """
    period = float(np.median(np.diff(time)))
    span = float(time[-1] - time[0])
    if not (period > 0.0 and 0.0 < span < MOST_HOLES * period * time.size):  # or a clock that was reset
        return 0.0, 0.0
    grid = np.arange(time[0], time[-1], period)
    theta, x, p = (_even(grid, time, values) for values in (turned, position, drop))
    balance = _Balance(theta, x, p, period)
    if balance.starts.size < LEAST_STEPS:
        return 0.0, 0.0
    coarse = max(round(COARSE_S / period), 1)
    around = range(-balance.reach, balance.reach + 1, coarse)
    best = min(((a, b) for a in around for b in around), key=balance.open)
    for _ in range(10):  # downhill, row by row
        near = [(best[0] + i, best[1] + j) for i in range(-2, 3) for j in range(-2, 3)]
        lower = min((n for n in near if max(map(abs, n)) <= balance.reach), key=balance.open)
        if lower == best:
            break
        best = lower
    out = []
    for k in range(2):
        # A piston that follows late, as a soft circuit or a dead band lets it, fits ever better farther out;
        # a delay of the recorder fits worse again beyond it.
        farthest = balance.reach if best[k] > 0 else -balance.reach
        less = [(s, best[1]) if k == 0 else (best[0], s) for s in (0, farthest)]
        clear = abs(best[k]) > SETTLED_ROWS and balance.open(best) < BETTER * min(map(balance.open, less))
        out.append(best[k] * period if clear else 0.0)
    return out[0], out[1]


class _Balance:
    """What the volume balance leaves open with position and pressure shifted by whole rows."""

    def __init__(self, theta: Column, x: Column, p: Column, period: float) -> None:
        self.step = max(round(STEP_S / period), 1)
        self.reach = max(round(FARTHEST_S / period), 1)
        self.starts = np.arange(self.reach, theta.size - self.reach - self.step, self.step)
        self._y = theta[self.starts + self.step] - theta[self.starts]
        self._x, self._p, self._total = x, p, np.concatenate(([0.0], np.cumsum(p)))
        self.open = lru_cache(maxsize=None)(self._open)

    def _open(self, shift: tuple[int, int]) -> float:
        a, b, n = self.starts + shift[0], self.starts + shift[1], self.step
        moved, leaked = self._x[a + n] - self._x[a], self._total[b + n] - self._total[b]
        out, back = np.maximum(moved, 0.0), np.minimum(moved, 0.0)  # a side of the piston each
        columns = np.column_stack([out, back, leaked, self._p[b + n] - self._p[b]])
        columns /= np.maximum(np.abs(columns).max(axis=0), 1e-300)
        gram = columns.T @ columns + 1e-9 * np.eye(4)
        pull = columns.T @ self._y
        return float(self._y @ self._y - pull @ np.linalg.solve(gram, pull))


def _even(grid: Column, time: Column, values: Column) -> Column:
    there = np.isfinite(values)
    return np.interp(grid, time[there], values[there]) if there.any() else np.zeros(grid.size)
