"""One channel, block by block: lag, errors, noise, tones, vibration, then range and rounding."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from fdd.plant.compiled import njit
from fdd.sensor import Sensor

Array = NDArray[np.float64]

RATE = 1000.0
"""Hz, rows per second, usually."""
HIGHEST_LIMIT = 0.45 * RATE
"""Hz; a limit from here on is none."""
_ORDER = 4
_LEFT = 1e-9
"""Share of a transient that is left once the noise counts as settled."""
_LONGEST = 1_000_000
_NOTHING = np.empty(0)
_STARTED, _LAG = 0, 1
"""What a channel remembers: whether rows have come, and the lagged signal."""


class Range(NamedTuple):
    """Where a sensor ends and its grid: value = `origin` plus whole steps; `step` 0 does not round."""

    low: float
    high: float
    step: float
    origin: float

    def digitise(self, values: Array) -> Array:
        """Clip to the range and round to the grid, (n,)."""
        values = np.clip(values, self.low, self.high)
        if self.step > 0.0:
            values = self.origin + self.step * np.rint((values - self.origin) / self.step)
        return values


def range_of(sensor: Sensor) -> Range:
    """A sensor's range and grid: those of its current loop, or `low`, `high` and `resolution`."""
    low = -math.inf if sensor.low is None else sensor.low
    high = math.inf if sensor.high is None else sensor.high
    loop = sensor.loop
    if loop is None:
        return Range(low, high, sensor.resolution, 0.0)
    # 0 V is a code of the converter, 4 mA is none: the grid does not pass through zero pressure.
    return Range(max(low, loop.smallest), min(high, loop.largest), loop.resolution, -loop.offset)


@lru_cache(maxsize=64)
def band_limit(limit_hz: float, rate: float = RATE) -> tuple[Array, int]:
    """Sections that let white noise of deviation 1 through up to a limit and leave it at deviation 1.

    Butterworth of fourth order: half the power at the limit, a thousandth from twice the limit on. Its gain
    is one over the root of the impulse response's sum of squares, which is what it does to white noise.
    Gives (2, 6) second-order sections, and the rows after which their start is forgotten.
    """
    sections = np.array(butter(_ORDER, limit_hz, fs=rate, output="sos"))
    poles = np.abs(np.concatenate([np.roots(section[3:]) for section in sections]))
    settled = min(int(np.log(_LEFT) / np.log(poles.max())) + 1, _LONGEST)
    impulse = np.zeros(settled + 1)
    impulse[0] = 1.0
    sections[0, :3] /= np.sqrt(np.sum(sosfilt(sections, impulse) ** 2))
    return sections, settled


@njit(error_model="numpy")
def _waves(out: Array, against: Array, waves: Array) -> None:
    """Add ``amplitude·sin(2π(rate·against + phase))`` of each row of `waves` (k, 3)."""
    for k in range(waves.shape[0]):
        rate, amplitude, phase = waves[k, 0], waves[k, 1], waves[k, 2]
        for i in range(out.size):
            turns = rate * against[i] + phase
            out[i] += amplitude * math.sin(2.0 * math.pi * (turns - math.floor(turns)))


@njit(error_model="numpy")
def _observe(
    truth: Array, noise: Array, gain: float, zero: float, deviation: float, share: float, state: Array
) -> Array:
    """Lag, gain, zero and noise of a block; `noise` is (n,) or empty, `share` the way to the signal that the
    lag goes in a row (1 follows at once)."""
    n = truth.size
    out = np.empty(n)
    lagged = state[_LAG]
    if state[_STARTED] == 0.0 and n > 0:
        lagged = truth[0]
        state[_STARTED] = 1.0
    follows, silent = share >= 1.0, noise.size == 0
    for i in range(n):
        value = truth[i]
        if not follows:
            lagged += share * (value - lagged)
            value = lagged
        value = gain * value + zero
        if not silent:
            value += deviation * noise[i]
        out[i] = value
    state[_LAG] = lagged
    return out


class ChannelSensor:
    """What a sensor shows of a quantity; its state goes on from block to block.

    A band limit is a first-order lag on the signal; the noise stops there steeply, as measured
    on the prototype (Appendix A: white to 150 Hz), and keeps its standard deviation. Tones ride on
    top: they come in behind the transducer. Shaft orders are waves locked to the pump's angle.

    `rng` is the channel's stream, `rate` (Hz) the rows per second.
    """

    def __init__(self, sensor: Sensor, rng: np.random.Generator, rate: float = RATE) -> None:
        self.sensor, self._rng = sensor, rng
        self.range = range_of(sensor)
        limit = sensor.bandwidth_hz
        limited = limit is not None and limit < HIGHEST_LIMIT
        share = -math.expm1(-2.0 * math.pi * limit / rate) if limited and limit is not None else 1.0
        self._constants = (sensor.gain, sensor.zero, sensor.noise, share)
        self._state = np.zeros(2)
        phases = [[a, b, rng.random()] for a, b in sensor.tones]
        self._tones = np.array(phases).reshape(-1, 3)
        # Of the angle in radians: turns of the wave per radian of the shaft.
        phases = [[order / (2.0 * math.pi), b, rng.random()] for order, b in sensor.shaft_orders]
        self._orders = np.array(phases).reshape(-1, 3)
        self._sections: Array | None = None
        self._filter = np.zeros((2, 2))
        if limited and limit is not None and sensor.noise > 0.0:
            self._sections, settled = band_limit(float(limit), rate)
            # Noise did not begin with the log.
            self._band(rng.standard_normal(settled))

    def observe(self, truth: Array, time: Array, angle: Array | None = None) -> Array:
        """The next n rows before range and rounding, (n,) in the channel's SI unit.

        Of the `truth` (n,), taken at `time` (n,) s; without the pump's `angle` (n,) rad nothing vibrates.
        """
        noise = _NOTHING
        if self.sensor.noise > 0.0:
            noise = self._rng.standard_normal(truth.size)
            if self._sections is not None:
                noise = self._band(noise)
        out = _observe(np.ascontiguousarray(truth, dtype=np.float64), noise, *self._constants, self._state)
        if self._tones.size:
            _waves(out, time, self._tones)
        if self._orders.size and angle is not None:
            _waves(out, np.ascontiguousarray(angle), self._orders)
        return out

    def _band(self, white: Array) -> Array:
        if not white.size:  # which sosfilt refuses
            return white
        out, self._filter = sosfilt(self._sections, white, zi=self._filter)
        return np.asarray(out)
