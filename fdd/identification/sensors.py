"""What a healthy log says about its sensors: noise, resolution, and zeros that redundancy shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from fdd.identification.least_squares import Estimate
from fdd.identification.record import Record
from fdd.samples import PRESSURES, Samples

Array = NDArray[np.float64]

SEGMENT = 0.5
"""s, over which a spectrum is taken."""
LOWEST_HZ, HIGHEST_HZ = 8.0, 100.0
"""Band in which the spectral density stands for the noise. Pressure sensors are limited to some 150 Hz
and carry tones above, so that differences of neighbouring samples would show too little; a filter
that follows the oil, which resonates below 100 Hz, needs the density there."""
QUIETEST = 0.25
"""Share of the segments that is taken for free of motion."""
SELECTION = 0.86
"""Mean of the lowest quarter over the mean of all, where half of the segments are free of motion: a
segment's band power scatters by 17 %, and the lower half of a normal distribution lies 0.8 deviations low."""
LEAST_STEPS = 50
LEAST_ZERO = 1.0
"""Pa; less means that the difference was computed from the chambers."""


def effective_noise(values: Array, period: float) -> float | None:
    """White noise (standard deviation) with the spectral density that the channel has below 100 Hz.

    ``sqrt(mean PSD over 8 to 100 Hz · f_s/2)``, in the quietest quarter of half-second segments.

    Parameters
    ----------
    values : (n,) one row per `period` (s).

    Returns
    -------
    In the channel's unit; None where there are fewer than four segments.

    Examples
    --------
    >>> noise = np.random.default_rng(1).standard_normal(60_000)
    >>> abs(effective_noise(noise, 1e-3) - 1.0) < 0.1
    True
    """
    length = round(SEGMENT / period)
    count = values.size // max(length, 1)
    if length < 64 or count < 4:
        return None
    segments = values[: count * length].reshape(count, length)
    frequency, density = welch(segments, 1.0 / period, nperseg=length // 2, detrend="linear", axis=1)
    band = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
    power = np.sort(density[:, band].mean(axis=1))[: max(int(QUIETEST * count), 1)]
    return float(np.sqrt(power.mean() / SELECTION * 0.5 / period))


def resolution(values: Array) -> float | None:
    """Quantum of a channel: the step of which all steps are multiples; None for a smooth channel.

    Examples
    --------
    >>> resolution(0.25 * np.rint(np.sin(np.arange(0.0, 9.0, 0.01)) * 40.0))
    0.25
    """
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    span = float(np.ptp(values[np.isfinite(values)])) if steps.size else 0.0
    steps = steps[steps > 1e-9 * max(span, 1e-30)]
    if steps.size < LEAST_STEPS:
        return None
    least = float(np.quantile(steps, 0.002))
    near = steps[steps < 1.5 * least]
    quantum = float(np.median(near))
    small = steps[steps < 20.5 * quantum]
    for _ in range(2):
        counts = np.maximum(np.rint(small / quantum), 1.0)
        quantum = float(np.sum(small * counts) / np.sum(counts**2))
    off = np.abs(small / quantum - np.rint(small / quantum))
    if np.quantile(off, 0.9) > 0.15:
        return None
    return float(f"{quantum:.5g}")


def redundancy_offset(records: list[Record]) -> Estimate | None:
    """Mean of the differential sensor less the chambers' difference (Pa), where all three are measured."""
    parts = [(r.difference - r.pressure_1 + r.pressure_2)[~r.gap] for r in _redundant(records)]
    if not any(np.any(p) for p in parts):
        return None
    everything = np.concatenate(parts)
    seconds = np.array_split(everything, max(min(everything.size // 1000, 200), 2))
    means = np.array([p.mean() for p in seconds])
    return Estimate(float(everything.mean()), float(means.std(ddof=1) / np.sqrt(means.size)))


def gain_mismatch(records: list[Record]) -> float | None:
    """Slope of the differential sensor over the chambers' difference, less one."""
    if not (use := _redundant(records)):
        return None
    x = np.concatenate([r.smooth(r.pressure_1 - r.pressure_2, 0.05)[~r.gap] for r in use])
    y = np.concatenate([r.smooth(r.difference, 0.05)[~r.gap] for r in use])
    x = x - x.mean()
    spread = float(np.mean(x**2))
    return None if spread < 1e9 else float(np.mean(x * (y - y.mean())) / spread - 1.0)


def _redundant(records: list[Record]) -> list[Record]:
    return [r for r in records if r.has_difference and r.chambers_measured]


def fit_sensors(logs: list[Samples], records: list[Record]) -> dict[str, dict[str, float]]:
    """Noise of pressures and position, resolutions, and the zero of the differential sensor.

    Parameters
    ----------
    logs : as recorded, for the resolutions. records : the same logs made even.

    Returns
    -------
    channel to what was found of its sensor: noise, resolution and zero, SI.
    """
    fits: dict[str, dict[str, float]] = {}
    for channel in (*PRESSURES, "position", "pump_angle", "pump_speed"):
        # NaN are dropped, not bridged: a bridge is free of noise.
        columns = [log[channel][np.isfinite(log[channel])] for log in logs if channel in log]
        pump = channel.startswith("pump")
        noise = None if pump else _lowest([effective_noise(c, records[0].period) for c in columns])
        step = _lowest([resolution(c) for c in columns])
        fit = fits[channel] = {}
        if noise is not None:
            # Rounding adds its own noise to the measured density; the profile lists it apart.
            rounding = (step or 0.0) / np.sqrt(12.0)
            left = float(np.sqrt(max(noise**2 - rounding**2, 0.0)))
            if channel != "position" or left > rounding:
                fit["noise"] = float(f"{left:.4g}")
        if step is not None:
            fit["resolution"] = step
    offset = redundancy_offset(records)
    if offset is not None and abs(offset.value) > LEAST_ZERO:
        fits["pressure_difference"]["zero"] = offset.value
    return {c: f for c, f in fits.items() if f}


def _lowest(values: list[float | None]) -> float | None:
    there = [v for v in values if v is not None]
    return min(there) if there else None
