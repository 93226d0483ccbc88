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

from fdd.sensors.compiled import njit

Array = NDArray[np.float64]

NOISE_REACH = 16.0
"""Standard deviations of a row's noise. An excess beyond T needs ``a + 2b + c`` and ``2a + b + d`` beyond it,
a to d being the noise of four rows: at 16 that has the chance 2e-13 for a Gaussian, which six channels at
1 kHz and two strides meet once in 1e5 h."""
EVENT_S = 0.05
"""What lies closer together is one event."""
LEVEL_ROWS = 12
"""Rows on either side from which the level is taken."""
STAYS = 0.5
"""Share of a jump that has to stay: of less it is a spike."""


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


@njit(nogil=True)
def excess(time: Array, values: Array, stride: int = 1) -> Array:
    """What of each row's step is beyond its neighbours' rates, (n,) of (n,); 0 at the ends, NaN beside a NaN.

    Parameters
    ----------
    stride : rows that a step spans: 2 sees a jump that two rows share.

    Examples
    --------
    >>> excess(np.arange(6.0), np.array([0.0, 1.0, 2.0, 8.0, 9.0, 10.0])).tolist()
    [0.0, 0.0, 0.0, 5.0, 0.0, 0.0]
    """
    out = np.zeros(values.size)
    if time.size < 4 * stride:
        return out
    # A late stamp makes one step of time long and the next too short to divide by.
    least = 0.5 * stride * (time[-1] - time[0]) / (time.size - 1)
    steps = np.maximum(time[stride:] - time[:-stride], least)
    rate = (values[stride:] - values[:-stride]) / steps
    for i in range(time.size - 3 * stride):
        earlier, middle, later = rate[i], rate[i + stride], rate[i + 2 * stride]
        within = min(max(middle, min(earlier, later)), max(earlier, later))
        known = not np.isnan(earlier + middle + later)
        out[i + 2 * stride] = (middle - within) * steps[i + stride] if known else np.nan
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

    Levels are medians of `LEVEL_ROWS` rows on either side, moved on to row `last` by these rows' own rates.
    """
    there = np.isfinite(values)
    before = np.flatnonzero(there[:first])[-LEVEL_ROWS:]
    after = np.flatnonzero(there[last + 1 :])[:LEVEL_ROWS] + last + 1
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
