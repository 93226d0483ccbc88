"""The sensors and the recorder: blocks of the plant's truth in, blocks of the log out, the same bits however
it is cut.

A channel has lag, errors, noise, tones and vibration, then range and rounding; then rows are lost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from fdd.plant import Array
from fdd.plant.compiled import njit
from fdd.plant.faults import FaultScales, FaultSpec
from fdd.plant.sensors.faults import USUAL, SensorFault, sensor_fault, struck_channel
from fdd.plant.sensors.recording import NanBursts, Recording, generator
from fdd.sections import Sensor
from fdd.unit import Unit

MEASURED = (
    "pump_angle", "position", "pressure_difference", "pressure_1", "pressure_2", "pressure_accumulator",
    "motor_current", "oil_temperature", "load_force",
)  # fmt: skip
"""Channels that a sensor gives. Pump speed is the angle's count difference; set-points are known."""
KNOWN = ("command", "position_setpoint")
"""Channels that the controller itself gives: rounded, never missing."""
RATE = 1000.0
"""Hz, rows per second, usually."""
HIGHEST_LIMIT = 450.0
"""Hz; a limit from here on is none."""
MOST_JITTER = 4.0
"""Standard deviations at which a stamp's error ends, so that stamps always increase."""


class Recorded(NamedTuple):
    """Stamps (n,) s; by channel (n,) values, NaN where a burst or a fault took them; rows the log has."""

    time: Array
    columns: dict[str, Array]
    kept: NDArray[np.bool_]


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

    Butterworth of fourth order, its gain one over the root of the impulse response's sum of squares. Gives
    (2, 6) second-order sections, and the rows after which a billionth of their start is left.
    """
    sections = np.array(butter(4, limit_hz, fs=rate, output="sos"))
    poles = np.abs(np.concatenate([np.roots(section[3:]) for section in sections]))
    settled = min(int(np.log(1e-9) / np.log(poles.max())) + 1, 1_000_000)
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
    lag goes in a row (1 follows at once), `state` (1,) the lagged signal, NaN at first."""
    out = np.empty(truth.size)
    lagged = state[0]
    for i in range(truth.size):
        value = truth[i]
        if share < 1.0:
            lagged = value if math.isnan(lagged) else lagged + share * (value - lagged)
            value = lagged
        value = gain * value + zero
        if noise.size > 0:
            value += deviation * noise[i]
        out[i] = value
    state[0] = lagged
    return out


class ChannelSensor:
    """What a sensor shows of a quantity; its state goes on from block to block.

    A band limit is a first-order lag on the signal; the noise stops there steeply, as measured
    on the prototype (Appendix A: white to 150 Hz), and keeps its standard deviation. Tones come in behind the
    transducer. Shaft orders are waves locked to the pump's angle.

    `rng` is the channel's stream, `rate` (Hz) the rows per second.
    """

    def __init__(self, sensor: Sensor, rng: np.random.Generator, rate: float = RATE) -> None:
        self.sensor, self._rng = sensor, rng
        self.range = range_of(sensor)
        limit = math.inf if sensor.bandwidth_hz is None else sensor.bandwidth_hz
        limited = limit < HIGHEST_LIMIT
        share = -math.expm1(-2.0 * math.pi * limit / rate) if limited else 1.0
        self._constants = (sensor.gain, sensor.zero, sensor.noise, share)
        self._state = np.full(1, np.nan)
        phases = [[a, b, rng.random()] for a, b in sensor.tones]
        self._tones = np.array(phases).reshape(-1, 3)
        # Of the angle in radians: turns of the wave per radian of the shaft.
        phases = [[order / (2.0 * math.pi), b, rng.random()] for order, b in sensor.shaft_orders]
        self._orders = np.array(phases).reshape(-1, 3)
        self._sections: Array | None = None
        self._filter = np.zeros((2, 2))
        if limited and sensor.noise > 0.0:
            self._sections, settled = band_limit(float(limit), rate)
            # Noise did not begin with the log.
            self._band(rng.standard_normal(settled))

    def observe(self, truth: Array, time: Array, angle: Array | None = None) -> Array:
        """The next n rows before range and rounding, (n,) in the channel's SI unit.

        Of the `truth` (n,), taken at `time` (n,) s; without the pump's `angle` (n,) rad nothing vibrates.
        """
        noise = np.empty(0)
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


class Recorder:
    """Measures a run block by block: sensors, their faults, and what the recording loses.

    Of the `faults` those of sensors act here; an `InputError` where this unit's sensors cannot have one. Rows
    that are late come late from the plant (see `Lateness`). `seed` is the scenario's, `stream` tells its axes
    apart ("" for the first): noise, bursts and faults are each axis's own, dropped rows and stamps are all
    axes' in common, as one computer samples them. `scales` are the figures of severity 1.
    """

    def __init__(
        self, unit: Unit, faults: list[FaultSpec], recording: Recording, seed: int, stream: str = "",
        scales: FaultScales = USUAL,
    ) -> None:  # fmt: skip
        self.unit, self.recording = unit, recording
        channels = [c for c in MEASURED if c != "load_force" or recording.load_force]
        rate = 1.0 / recording.period
        self._sensors = {
            c: ChannelSensor(unit.sensor(c), generator(seed, f"sensor {c}{stream}"), rate) for c in channels
        }
        speed = unit.sensor("pump_speed")
        counts = unit.sensor("pump_angle").resolution / recording.period
        # A difference of counts is on their grid already; rounding it to a printed one would shift it.
        own_grid = counts > 0.0 and abs(speed.resolution / counts - 1.0) < 0.01
        step = 0.0 if own_grid else speed.resolution
        self._speed = ChannelSensor(
            speed.model_copy(update={"bandwidth_hz": None, "resolution": step}),
            generator(seed, f"sensor pump_speed{stream}"),
            rate,
        )
        self._faults: dict[str, list[SensorFault]] = {}
        for spec in faults:
            kind, channel = sensor_fault(spec), struck_channel(spec, recording)
            if kind is not None and channel in self._sensors:
                effect = kind(spec, unit.sensor(channel), seed, stream, scales, recording.period)
                self._faults.setdefault(channel, []).append(effect)
        self._drops, self._stamps = generator(seed, "dropped rows"), generator(seed, "stamps")
        self._bursts = NanBursts(recording, seed, [*self._sensors, "pump_speed"], stream)
        self._angle = np.empty(0)
        self.row = 0

    def measure(self, truth: Mapping[str, Array], time: Array) -> Recorded:
        """Record the next n rows, with the channels in the order known, measured, known.

        Of a column (n,) of each channel of `MEASURED` (``load_force`` only where it is measured), and of
        `KNOWN` where there are any, taken at `time` (n,) s.
        """
        time = np.ascontiguousarray(time, dtype=np.float64)
        columns: dict[str, Array] = {}
        if "command" in truth:
            columns["command"] = range_of(self.unit.sensor("command")).digitise(truth["command"])
        for channel, sensor in self._sensors.items():
            there = np.ascontiguousarray(truth[channel], dtype=np.float64)
            value = sensor.observe(there, time, truth["pump_angle"])
            for effect in self._faults.get(channel, ()):
                value = effect.distort(value, there, time, self.row)
            columns[channel] = sensor.range.digitise(value)
            if channel == "pump_angle":
                counted = self.recording.speed == "counts"
                speed = self._count_difference(columns[channel]) if counted else truth["pump_speed"]
                columns["pump_speed"] = self._speed.range.digitise(self._speed.observe(speed, time))
        for channel, effects in self._faults.items():
            for effect in effects:
                columns[channel] = effect.replace(columns[channel], time)
        self._bursts.blank(columns, time.size)
        if "position_setpoint" in truth:
            columns["position_setpoint"] = np.array(truth["position_setpoint"], dtype=np.float64)
        columns = {name: values for name, values in columns.items() if self.recording.has(name)}
        # One computer samples all axes (thesis A.3): of a scenario they lose the same rows, never the first.
        stamps, kept = time, np.ones(time.size, dtype=np.bool_)
        if self.recording.dropped > 0.0:
            kept = self._drops.random(time.size) >= self.recording.dropped
            kept[:1] |= self.row == 0
        if self.recording.jitter > 0.0:
            error = np.clip(self._stamps.standard_normal(time.size), -MOST_JITTER, MOST_JITTER)
            error[:1] *= self.row > 0
            stamps = time + self.recording.jitter * error
        if self.recording.keeps_every > 1:
            kept = kept & (np.arange(self.row, self.row + time.size) % self.recording.keeps_every == 0)
        self.row += time.size
        return Recorded(stamps, columns, kept)

    def _count_difference(self, angle: Array) -> Array:
        """Counts since the last sample over a nominal period: a late row shows too much speed."""
        before = angle[:1] if self.row == 0 else self._angle
        self._angle = angle[-1:].copy() if angle.size else self._angle
        return np.diff(angle, prepend=before) / self.recording.period
