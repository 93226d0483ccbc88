"""Rows that cannot be true, found as they come: nothing is held back, and only earlier rows are asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.sensors.limits import INDEX, SIGMA, Limits
from fdd.sensors.memory import Memory

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

BACK_S = 0.05
"""A value that does not come back within this time has jumped for good."""
SPEED = INDEX["pump_speed"]
RATED = ("position", "pump_angle")


class RowMasks:
    """Bounds of single rows.

    Parameters
    ----------
    limits : of the unit. memory : where the last good values are kept.
    """

    def __init__(self, limits: Limits, memory: Memory) -> None:
        self.memory = memory
        reach = SIGMA * limits.noise + limits.resolution
        self._low, self._high = limits.low - reach, limits.high + reach
        # A speed that is a difference of counts over the nominal period doubles where a row comes a period
        # late.
        self._low[SPEED], self._high[SPEED] = 2.0 * self._low[SPEED], 2.0 * self._high[SPEED]
        self._dead = limits.dead
        rates = {"position": limits.piston_speed, "pump_angle": 1.3 * limits.pump_speed}
        self._rated = [(INDEX[n], rates[n], 4.0 * reach[INDEX[n]]) for n in RATED]

    def rows(self, time: Array, values: Array) -> Mask:
        """Impossible rows of `values` (n, 12), taken at `time` (n,) s; rows have to come in their order."""
        stamps = np.concatenate((self.memory.stamps, time))
        steps = np.nan_to_num(np.diff(stamps))
        # A late stamp takes time from the next step: allow for the two steps together.
        slack = steps[1:] + steps[:-1]
        with np.errstate(invalid="ignore"):
            out = (values < self._low) | (values > self._high)
            for k in np.flatnonzero(self.memory.held_until > time[0]).tolist():
                previous = np.concatenate(([self.memory.previous[k]], values[:-1, k]))
                out[:, k] |= (values[:, k] == previous) | (values[:, k] == self._dead[k])
        for k, rate, floor in self._rated:
            self._jumps(time, slack, values[:, k], out[:, k], k, rate, floor)
        self.memory.previous[:] = values[-1]
        self.memory.stamps[:] = stamps[-2:]
        return out

    def _jumps(
        self, time: Array, slack: Array, values: Array, out: Mask, k: int, rate: float, floor: float
    ) -> None:
        """Mark rows farther from the last good one than the rate allows, until they come back or stay."""
        memory = self.memory
        there = np.flatnonzero(np.isfinite(values) & ~out)
        if not there.size:
            return
        t, v, late = time[there], values[there], slack[there]
        last = memory.good_value[k], memory.good_time[k]
        i = 0
        if np.isnan(last[0]):
            last, i = (float(v[0]), float(t[0])), 1
        while i < v.size:
            if np.isnan(memory.doubtful_since[k]):
                values_before = np.concatenate(([last[0]], v[i:-1]))
                times_before = np.concatenate(([last[1]], t[i:-1]))
                wild = np.abs(v[i:] - values_before) > rate * (t[i:] - times_before + late[i:]) + floor
                first = int(np.argmax(wild)) if wild.any() else -1
                if first < 0:
                    last = float(v[-1]), float(t[-1])
                    break
                if first > 0:
                    last = float(v[i + first - 1]), float(t[i + first - 1])
                i += first
                memory.doubtful_since[k] = t[i]
            far = abs(v[i] - last[0]) > rate * (t[i] - last[1] + late[i]) + floor
            if far and t[i] - memory.doubtful_since[k] < BACK_S:
                out[there[i]] = True
            else:
                memory.doubtful_since[k] = np.nan
                last = float(v[i]), float(t[i])
            i += 1
        memory.good_value[k], memory.good_time[k] = last
