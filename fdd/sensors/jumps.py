"""Jumps: a step of a channel within a row, or within some tens of milliseconds, that nothing answers.

A quantity with inertia may change its rate, but its rate over one row lies between those of the rows beside
it, unless the row is the sensor's doing. So of each row's step the *excess* over the range of its
neighbours' steps is judged. A piston that breaks loose and stops again within one row goes at most
``F/m·(Δt/2)²``; late stamps and missing rows show in the pump's angle as well, and are taken off by it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.sensors.finding import Memory, njit
from fdd.sensors.limits import ANGLE, DIFFERENCE, ONE, POSITION, SPEED, TWO, Array, Limits
from fdd.sensors.scan import smallest

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
BREAKS_LOOSE = 0.75
"""Of a·w², what the mean rate over w can be beyond those before and after, where a piston speeds up and slows
down at a: at the peak, (V w - a w²/4) - (V w - a w²). Less than a quarter where it all happens within w."""
NOISE_RANGE = 4.0
"""Standard deviations from the least to the largest of ten values of Gaussian noise, as a rule at most."""


@dataclass(frozen=True)
class Rows:
    """Rows under judgement."""

    time: Array  # (n,) s
    values: Array  # (12, n) in the order of `NAMES`
    noise: Array  # (12,) of a row, see `spread`
    swept: Array  # (n,) m³ that the pump displaced, from an arbitrary zero; (0,) without angle and speed

    def difference(self) -> Array | None:
        """Δp, measured or from both chambers, (n,) Pa."""
        found = self.values[DIFFERENCE]
        if np.isnan(found).all():
            found = self.values[ONE] - self.values[TWO]
        return None if np.isnan(found).all() else np.asarray(found)


def swept_volume(time: Array, values: Array, limits: Limits, memory: Memory) -> Array:
    """As `Rows.swept`, from `values` (12, n)."""
    for k in (ANGLE, SPEED):
        there = np.isfinite(values[k])
        known = np.count_nonzero(there)
        if known < 2 or not np.isnan(memory.failed_since[k]):
            continue
        column = values[k] if known == time.size else np.interp(time, time[there], values[k, there])
        if k == SPEED:
            column = np.concatenate(([0.0], np.cumsum(0.5 * (column[1:] + column[:-1]) * np.diff(time))))
        return np.asarray(limits.displacement * column)
    return np.empty(0)


@dataclass(frozen=True)
class Jump:
    """A jump of one channel, SI."""

    time: float  # s of the first row that has it
    net: float  # change of level that stays; 0 for a spike
    peak: float  # largest excess of a row
    before: float  # level before
    rows: int  # how many are affected


def jumps(time: Array, values: Array, over: Array, limit: Array, start: float, stop: float) -> list[Jump]:
    """Events whose first row lies in ``[start, stop)``: `over`, the excess of `values`, passes `limit`."""
    rows = np.flatnonzero(np.abs(over) > limit)
    if not rows.size:
        return []
    found = []
    for group in np.split(rows, np.flatnonzero(np.diff(time[rows]) > EVENT_S) + 1):
        first, last = int(group[0]), int(group[-1])
        if not start <= time[first] < stop:
            continue
        peak = over[group[np.argmax(np.abs(over[group]))]]
        net, before = _level_change(time, values, first, last)
        # A row that is off and comes back has an excess to either side, a step has one.
        one_way = bool((np.sign(over[group]) == np.sign(peak)).all())
        if one_way and abs(net - peak) > STAYS * abs(peak):
            net = float(peak)
        stays = one_way or abs(net) > max(limit[first], STAYS * abs(peak))
        found.append(Jump(float(time[first]), net if stays else 0.0, float(peak), before, group.size))
    return found


def _level_change(time: Array, values: Array, first: int, last: int) -> tuple[float, float]:
    """Change of level over rows `first` to `last`, their usual motion taken off, and the level before.

    Levels are medians of `LEVEL_ROWS` rows on either side, moved on to row `last` by these rows' own rates.
    """
    there = np.isfinite(values)
    before = np.flatnonzero(there[:first])[-LEVEL_ROWS:]
    after = np.flatnonzero(there[last + 1 :])[:LEVEL_ROWS] + last + 1
    if not before.size or not after.size:
        return 0.0, float(values[first])
    rates = []
    for part in (p for p in (before, after) if p.size > 2):
        half = part.size // 2  # over half the rows: of counts a median of single steps would be 0
        late, early = part[half:], part[:-half]
        rates.append(float(np.median((values[late] - values[early]) / (time[late] - time[early]))))
    rate = sum(rates) / len(rates) if rates else 0.0
    old = float(np.median(values[before] + rate * (time[last] - time[before])))
    new = float(np.median(values[after] + rate * (time[last] - time[after])))
    return new - old, float(np.median(values[before]))


@njit(nogil=True)
def explained(k: int, time: Array, values: Array, swept: Array, stride: int, limits: Limits) -> Array:
    """What physics and the recorder explain of an excess of channel k, (n,), in `Rows`; inf beside missing
    rows."""
    steps = np.zeros(time.size)
    steps[1:] = time[1:] - time[:-1]
    period = smallest(steps[1:].copy(), (time.size - 1) // 2)
    off = widest(np.abs(steps - period), 2 * stride)
    if k == ANGLE:
        # A row that came a whole period late shows no step and then two; one between two late ones is
        # short before and after, and seems to want three.
        usual = np.minimum(usual_step(time, values[k]), limits.pump_speed * period)
        rows = 2.0 + (off > 0.25 * period)
        out = rows * stride * usual + limits.acceleration * (stride * period) ** 2
    elif k == POSITION:
        out = np.full(time.size, BREAKS_LOOSE * limits.release * (stride * period) ** 2)
        # Late and missing rows are late and missing in the pump's angle too.
        out += 1.5 * widest(np.abs(excess(time, swept / limits.area, stride)), 2 * stride)
        # A light piston swings on its oil when the pump's teeth meet their resonance: Δp swings with it.
        swing = _pressure_swing(values, 3 * stride, limits)
        out += BREAKS_LOOSE * limits.lightness * swing * (stride * period) ** 2
        # A piston that its load moves while the pump stands: what it goes in the time that a row is late.
        out += np.minimum(off / period, 1.0) * stride * usual_step(time, values[k])
    else:
        out = limits.stiffness * stride * widest(moved_oil(values[POSITION], swept, limits), 3 * stride)
    out[widest(steps, stride) > 3.5 * period] = np.inf
    return out


@njit(nogil=True)
def _pressure_swing(values: Array, reach: int, limits: Limits) -> Array:
    """How far Δp goes within `reach` rows on either side, beyond its noise, (n,) Pa; 0 where not known."""
    difference, noise, known = values[DIFFERENCE], limits.noise[DIFFERENCE], False
    for x in difference:  # np.all and np.where would load the compiler where all is compiled already
        known = known or not np.isnan(x)
    if not known:
        difference = values[ONE] - values[TWO]
        noise = np.hypot(limits.noise[ONE], limits.noise[TWO])
    swing = widest(difference, reach) + widest(-difference, reach) - NOISE_RANGE * noise
    for k in range(swing.size):
        if not swing[k] > 0.0:
            swing[k] = 0.0
    return swing


@njit(nogil=True)
def moved_oil(position: Array, swept: Array, limits: Limits) -> Array:
    """Oil that pump and piston move from row to row at most, (n,) m³."""
    flow = np.zeros(position.size)
    for i in range(1, position.size):
        if swept.size:
            flow[i] = abs(swept[i] - swept[i - 1])
        step = position[i] - position[i - 1]
        if not np.isnan(step):
            flow[i] += limits.area * abs(step)
    return flow


@njit(nogil=True)
def usual_step(time: Array, values: Array) -> Array:
    """Median size of a row's step and two on either side, (n,): two wild rows cannot raise it.

    Between the measurements of a channel that is slower than the rows, its steps are those of a line.
    """
    line, before = values.copy(), -1
    for i in range(values.size):
        if np.isnan(values[i]):
            line[i] = line[max(before, 0)]
            continue
        for j in range(before + 1, i):
            share = (time[j] - time[before]) / (time[i] - time[before]) if before >= 0 else 1.0
            line[j] = values[i] if before < 0 else values[before] + share * (values[i] - values[before])
        before = i
    steps = np.zeros(values.size + 4)
    steps[3:-2] = np.abs(line[1:] - line[:-1])
    steps[-2:] = steps[-3]
    out = np.empty(values.size)
    for i in range(values.size):
        out[i] = smallest(steps[i : i + 5].copy(), 2)
    return out


@njit(nogil=True)
def widest(values: Array, reach: int) -> Array:
    """Largest of each of (n,) and the `reach` on either side; NaN where one of them is."""
    out = values.copy()
    for i in range(values.size):  # element by element: assigned slices compile for a second
        for k in range(max(i - reach, 0), min(i + reach + 1, values.size)):
            out[i] = np.maximum(out[i], values[k])
    return out


@njit(nogil=True)
def excess(time: Array, values: Array, stride: int = 1) -> Array:
    """What of each row's step is beyond its neighbours' rates, (n,) of (n,); 0 at the ends, NaN beside a NaN.
    A step spans `stride` rows: 2 sees a jump that two rows share.

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
