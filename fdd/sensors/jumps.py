"""Jumps: a step of a channel within a row, or within some tens of milliseconds, that nothing answers.

A quantity with inertia may change its rate, but its rate over one row lies between those of the rows beside
it, unless the row is the sensor's doing. So of each row's step the *excess* over the range of its
neighbours' steps is judged. A piston that breaks loose and stops again within one row goes at most
``F/m·(Δt/2)²``; late stamps and missing rows show in the pump's angle as well, and are taken off by it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GAUSS_75, GAUSS_90 = 1.1503, 1.6449
"""Quantiles of the absolute value of a standard normal variable at 75 and 90 %."""
NOISE_REACH = 16.0
"""Standard deviations of a row's noise. An excess beyond T needs ``a + 2b + c`` and ``2a + b + d`` beyond it,
a to d being the noise of four rows: at 16 that has the chance 2e-13 for a Gaussian, which six channels at
1 kHz and two strides meet once in 1e5 h."""
COUNTS = 6.0
"""Counts: rounding gives an excess of up to 2, hysteresis and unevenness of a plain scale as much each."""
EVENT_S = 0.05
"""What lies closer together is one event."""
BESIDE = 12
"""Rows on either side from which the level is taken."""
STAYS = 0.5
"""Share of a jump that has to stay: of less it is a spike."""
CELL_S = 0.02


@dataclass(frozen=True)
class Jump:
    """A jump of one channel.

    Attributes
    ----------
    time : s of the first row that has it.
    net : change of level that stays, SI; 0 for a spike.
    peak : largest excess of a row.
    before : level before. rows : how many rows are affected.
    """

    time: float
    net: float
    peak: float
    before: float
    rows: int


def excess(time: Array, values: Array, stride: int = 1) -> Array:
    """What of each row's step is beyond its neighbours' rates, like `values`, (n,) or (n, m); 0 at the ends.

    Parameters
    ----------
    stride : rows that a step spans: 2 sees a jump that two rows share.

    Examples
    --------
    >>> excess(np.arange(6.0), np.array([0.0, 1.0, 2.0, 8.0, 9.0, 10.0])).tolist()
    [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]
    """
    out = np.zeros(values.shape)
    if time.size < 4 * stride:
        return out
    steps = time[stride:] - time[:-stride]
    # A late stamp makes one step of time long and the next too short to divide by.
    steps = np.maximum(steps, 0.5 * stride * (time[-1] - time[0]) / (time.size - 1))
    steps = steps if values.ndim == 1 else steps[:, None]
    rate = (values[stride:] - values[:-stride]) / steps
    earlier, middle, later = rate[: -2 * stride], rate[stride:-stride], rate[2 * stride :]
    within = np.clip(middle, np.minimum(earlier, later), np.maximum(earlier, later))
    out[2 * stride : -stride] = (middle - within) * steps[stride:-stride]
    return out


def median(values: Array) -> float:
    """Of (n,) without NaN, the upper one of two: NumPy's own takes ten times as long for a hop."""
    half = values.size // 2
    return float(np.partition(values, half)[half])


def spread(values: Array) -> Array:
    """Standard deviation of a row's noise in each column of (n, m), (m,); 0 of fewer than 8 values.

    From second differences, robust to jumps in up to a tenth of the rows. The larger of two quantiles, so
    that it is not 0 where values are rounded and mostly stand still, and covers a hop of which only a part
    is noisy.
    """
    out = np.zeros(values.shape[1])
    whole = np.isfinite(values).all(axis=0)
    if values.shape[0] >= 8 and whole.any():
        out[whole] = _spread(values[:, whole])
    for k in np.flatnonzero(~whole):
        there = values[np.isfinite(values[:, k]), k]
        if there.size >= 8:
            out[k] = _spread(there[:, None])[0]
    return out


def _spread(values: Array) -> Array:
    second = np.abs(np.diff(values, 2, axis=0))
    k75, k90 = int(0.75 * (second.shape[0] - 1)), int(0.9 * (second.shape[0] - 1))
    parted = np.partition(np.ascontiguousarray(second.T), (k75, k90), axis=1)
    return np.asarray(np.maximum(parted[:, k75] / GAUSS_75, parted[:, k90] / GAUSS_90) / np.sqrt(6.0))


def widest(values: Array, reach: int) -> Array:
    """Largest of each row and the `reach` rows on either side, (n,)."""
    out = values.copy()
    for k in range(1, reach + 1):
        np.maximum(out[k:], values[:-k], out=out[k:])
        np.maximum(out[:-k], values[k:], out=out[:-k])
    return out


def jumps(time: Array, values: Array, over: Array, limit: Array, start: float, stop: float) -> list[Jump]:
    """Events whose first row lies in ``[start, stop)``.

    Parameters
    ----------
    time : (n,) s. values : (n,). over : (n,) their excess. limit : (n,) what an excess may be.
    """
    rows = np.flatnonzero(np.abs(over) > limit)
    if not rows.size:
        return []
    found = []
    for group in np.split(rows, np.flatnonzero(np.diff(time[rows]) > EVENT_S) + 1):
        first, last = int(group[0]), int(group[-1])
        if not start <= time[first] < stop:
            continue
        peak = over[group[np.argmax(np.abs(over[group]))]]
        net, before = level_change(time, values, first, last)
        # A row that is off and comes back has an excess to either side, a step has one.
        one_way = bool((np.sign(over[group]) == np.sign(peak)).all())
        if one_way and abs(net - peak) > STAYS * abs(peak):
            net = float(peak)
        stays = one_way or abs(net) > max(limit[first], STAYS * abs(peak))
        found.append(Jump(float(time[first]), net if stays else 0.0, float(peak), before, group.size))
    return found


def level_change(time: Array, values: Array, first: int, last: int) -> tuple[float, float]:
    """Change of level over rows `first` to `last`, their usual motion taken off, and the level before.

    Levels are medians of `BESIDE` rows on either side, moved on to row `last` by these rows' own rates.
    """
    there = np.isfinite(values)
    before = np.flatnonzero(there[:first])[-BESIDE:]
    after = np.flatnonzero(there[last + 1 :])[:BESIDE] + last + 1
    if not before.size or not after.size:
        return 0.0, float(values[first])
    # Over half the rows: of counts a median of single steps would be 0.
    rates = [_rate(time[part], values[part]) for part in (before, after) if part.size > 2]
    rate = sum(rates) / len(rates) if rates else 0.0
    old = float(np.median(values[before] + rate * (time[last] - time[before])))
    new = float(np.median(values[after] + rate * (time[last] - time[after])))
    return new - old, float(np.median(values[before]))


def _rate(time: Array, values: Array) -> float:
    half = time.size // 2
    return float(np.median((values[half:] - values[:-half]) / (time[half:] - time[:-half])))


def cell_means(time: Array, values: Array, origin: float, cells: int) -> Array:
    """Mean of each cell of `CELL_S` from `origin` on, (cells, m) of (n, m); NaN where rows or values lack."""
    edges = np.searchsorted(time, origin + CELL_S * np.arange(cells + 1) - 1e-6 * CELL_S)
    count = np.diff(edges)
    out = np.full((cells, values.shape[1]), np.nan)
    filled = np.flatnonzero(count)
    if filled.size:
        # Summed about the first row: the angle of a long log is large, a slip small.
        base = values[edges[filled[0]]]
        part = values[edges[filled[0]] : edges[filled[-1] + 1]] - base
        sums = np.add.reduceat(part, edges[filled] - edges[filled[0]], axis=0)
        out[filled] = sums / count[filled, None] + base
    return out


def cell_excess(means: Array) -> Array:
    """Step over two cells around each cell, beyond what the two steps before and after show, like `means`."""
    out = np.zeros(means.shape)
    if means.shape[0] >= 7:
        step = means[2:] - means[:-2]
        middle, earlier, later = step[2:-2], step[:-4], step[4:]
        out[3:-3] = middle - np.clip(middle, np.minimum(earlier, later), np.maximum(earlier, later))
    return np.asarray(np.nan_to_num(out))


def cell_range(means: Array) -> Array:
    """Highest less lowest of each cell and three on either side, (cells,)."""
    return np.asarray(widest(means, 3) + widest(-means, 3))
