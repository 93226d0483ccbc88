"""The sensors: from what was in the plant to what a log shows."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfiltfilt

from fdd.plant.faults.injection import SENSOR_FAULTS
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.scenario import Recording
from fdd.unit import Sensor, Unit

Array = NDArray[np.float64]

_RATE = 1000.0
_NOMINAL_PERIOD = 1e-3
MEASURED = (
    "pump_angle",
    "position",
    "pressure_difference",
    "pressure_1",
    "pressure_2",
    "pressure_accumulator",
    "motor_current",
    "oil_temperature",
    "load_force",
)
"""Channels that a sensor gives. Pump speed is the angle's count difference; set-points are known."""


def generator(seed: int, purpose: str) -> np.random.Generator:
    """A stream of its own for each purpose, so that one more draw here changes nothing there."""
    return np.random.default_rng(np.random.SeedSequence([seed, zlib.crc32(purpose.encode())]))


def measure_channel(sensor: Sensor, truth: Array, time: Array, rng: np.random.Generator) -> Array:
    """What a sensor shows of a quantity, before faults of its own.

    A band limit is a first-order lag on the signal; the noise stops there steeply, as measured
    on the prototype (Appendix A: white to 150 Hz), and keeps its standard deviation. Tones ride on
    top: they come in behind the transducer.

    Parameters
    ----------
    sensor : gain, zero, noise, band, tones.
    truth : (n,) one value per millisecond.
    time : (n,) s.
    rng : the channel's stream.

    Returns
    -------
    (n,) before range and rounding (see `digitise`).
    """
    value = truth
    noise = rng.standard_normal(truth.size) if sensor.noise > 0.0 else None
    limit = sensor.bandwidth_hz
    if limit is not None and limit < 0.45 * _RATE:
        pole = float(np.exp(-2.0 * np.pi * limit / _RATE))
        start = truth[0] if truth.size else 0.0
        section = np.array([[1.0 - pole, 0.0, 0.0, 1.0, -pole, 0.0]])
        value = start + np.asarray(sosfilt(section, truth - start))
        if noise is not None and truth.size > 64:
            sections = butter(4, limit, fs=_RATE, output="sos")
            noise = np.asarray(sosfiltfilt(sections, noise))
            noise = noise / _deviation_left(sections)
    measured = sensor.gain * value + sensor.zero
    if noise is not None:
        measured = measured + sensor.noise * noise
    for frequency, amplitude in sensor.tones:
        phase = rng.uniform(0.0, 2.0 * np.pi)
        measured = measured + amplitude * np.sin(2.0 * np.pi * frequency * time + phase)
    return np.asarray(measured)


def _deviation_left(sections: Array) -> float:
    """Standard deviation that filtering forwards and backwards leaves of white noise."""
    impulse = np.zeros(4097)
    impulse[2048] = 1.0
    return float(np.sqrt(np.sum(sosfiltfilt(sections, impulse) ** 2)))


def digitise(sensor: Sensor, value: Array) -> Array:
    """Clip to the range and round to the resolution, (n,)."""
    if sensor.low is not None or sensor.high is not None:
        value = np.clip(value, sensor.low, sensor.high)
    if sensor.resolution > 0.0:
        value = sensor.resolution * np.rint(value / sensor.resolution)
    return value


def measure_all(
    unit: Unit, truth: dict[str, Array], time: Array, faults: list[FaultSpec], recording: Recording, seed: int
) -> dict[str, Array]:
    """All measured channels, before rows are lost.

    Parameters
    ----------
    unit : its sensors.
    truth : column of each channel in `MEASURED`, (n,).
    time : (n,) s, when each row was taken.
    faults : those of sensors act here.
    recording : whether the load is measured.
    seed : of the scenario.

    Returns
    -------
    channel to (n,) values.
    """
    measured: dict[str, Array] = {}
    for channel in MEASURED:
        if channel == "load_force" and not recording.load_force:
            continue
        sensor = unit.sensor(channel)
        value = measure_channel(sensor, truth[channel], time, generator(seed, f"sensor {channel}"))
        for spec in faults:
            target = SENSOR_FAULTS.get(spec.fault)
            if target is not None and target[0] == channel:
                value = target[1](value, spec.over(time), time)
        measured[channel] = digitise(sensor, value)
        if channel == "pump_angle":
            # Counts since the last sample over a nominal period: a late row shows too much speed.
            speed = np.diff(measured["pump_angle"], prepend=measured["pump_angle"][:1]) / _NOMINAL_PERIOD
            speed_sensor = unit.sensor("pump_speed").model_copy(update={"bandwidth_hz": None})
            value = measure_channel(speed_sensor, speed, time, generator(seed, "sensor pump_speed"))
            measured["pump_speed"] = digitise(speed_sensor, value)
    return measured


def lateness(n: int, recording: Recording, substeps: int, seed: int) -> NDArray[np.int64]:
    """Steps by which each row is taken late, (n,); the first is on time."""
    rng = generator(seed, "late rows")
    most = min(int(recording.latest * substeps / _NOMINAL_PERIOD + 1e-9), substeps - 1)
    drawn = rng.random(n)
    steps = rng.integers(1, max(most, 1) + 1, n)
    late = np.where((drawn < recording.late) & (most > 0), steps, 0)
    late[:1] = 0
    return late.astype(np.int64)


def kept_rows(n: int, recording: Recording, seed: int) -> NDArray[np.bool_]:
    """Which rows the log has, (n,)."""
    kept = generator(seed, "dropped rows").random(n) >= recording.dropped
    kept[:1] = True
    return np.asarray(kept)


def blank_bursts(columns: dict[str, Array], recording: Recording, seed: int) -> None:
    """Put bursts of NaN into measured channels, in place."""
    n = next(iter(columns.values())).size
    rng = generator(seed, "NaN bursts")
    names = [c for c in columns if c not in ("command", "position_setpoint")]
    for _ in range(int(rng.poisson(recording.nan_bursts_per_minute * n / 60_000.0))):
        start, length = int(rng.integers(0, n)), int(rng.integers(5, 31))
        for name in rng.permutation(names)[: int(rng.integers(1, 5))]:
            columns[str(name)][start : start + length] = np.nan
