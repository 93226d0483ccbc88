"""What two logs asked of the actuator, and the power densities of what both measured.

Much that differs between two logs is their duty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.history.answers import DutyRow, Line
from fdd.samples import CHANNELS, PRESSURES, Samples

Array = NDArray[np.float64]

SIGNALS = ("position", "pump_speed", *PRESSURES, "motor_current", "load_force", "oil_temperature")
SIGNED = ("position", "oil_temperature")
PERCENTILES = (5.0, 50.0, 95.0)
SEGMENT_S = 2.0
"""s of a segment: lines half a hertz apart."""
LEAST_SEGMENTS = 4
LEAST_HZ = 3.0
"""Below it is the duty."""
AROUND_HZ = 10.0
"""Either side of a line, whose median ratio is what it is held against."""
CHANCE = 0.01
SEGMENT_FREEDOM = 1.89
"""Degrees of freedom that a half overlapping Hann segment adds to an average."""
MOST_SPREAD = 0.2
"""Of the turning shaft's speed between its quartiles, over the median: beyond it a line has no order."""
LEAST_TURN = 0.1
"""Of the log's largest speed, from which on the shaft turns."""


def column(samples: Samples, channel: str) -> Array:
    """A channel, (n,), NaN where there is none; the pump's speed is its angle's where only that is there.

    Examples
    --------
    >>> log = Samples([0.0, 0.1, 0.2], {"pump_angle": [0.0, 1.0, 2.0]})
    >>> column(log, "pump_speed").tolist()
    [10.0, 10.0, 10.0]
    """
    if channel == "pump_speed" and not has(samples, channel) and "pump_angle" in samples and len(samples) > 1:
        return np.asarray(np.gradient(samples["pump_angle"], samples.time))
    return samples.get(channel)


def has(samples: Samples, channel: str) -> bool:
    """Whether the channel has any value."""
    return channel in samples and bool(np.isfinite(samples[channel]).any())


def duty_rows(a: Samples, b: Samples) -> list[DutyRow]:
    """Percentiles of the signals that either log has."""

    def percentiles(samples: Samples, name: str) -> tuple[float, float, float] | None:
        values = column(samples, name)
        values = values[np.isfinite(values)]
        if not values.size:
            return None
        low, middle, high = np.percentile(values if name in SIGNED else np.abs(values), PERCENTILES)
        return float(f"{low:.5g}"), float(f"{middle:.5g}"), float(f"{high:.5g}")

    found = [
        DutyRow(signal=name, unit=CHANNELS[name].unit, a=percentiles(a, name), b=percentiles(b, name))
        for name in SIGNALS
    ]
    return [row for row in found if row.a is not None or row.b is not None]


@dataclass(frozen=True)
class Spectrum:
    """One channel in both logs: frequency (m,) Hz, power densities (m,) of A and B, SI²/Hz, their freedom."""

    channel: str
    frequency: Array
    a: Array
    b: Array
    freedom: tuple[float, float]


def spectra_of(a: Samples, b: Samples) -> list[Spectrum]:
    """Welch's power densities of all channels that both logs have, each sampled evenly first.

    Logs below eight seconds have none, and no channel of which half is missing.
    """
    found = []
    for name in (n for n in SIGNALS if n != "oil_temperature"):
        one, other = _density(a, name), _density(b, name)
        if one is not None and other is not None:
            frequency = one[0][one[0] <= other[0][-1]]
            there = np.interp(frequency, other[0], other[1])
            found.append(Spectrum(name, frequency, one[1][: frequency.size], there, (one[2], other[2])))
    return found


def _density(samples: Samples, name: str) -> tuple[Array, Array, float] | None:
    from scipy.signal import welch

    values = column(samples, name)
    good = np.isfinite(values)
    if good.sum() < max(0.5 * len(samples), 2) or samples.duration < SEGMENT_S * LEAST_SEGMENTS:
        return None
    rate = 1.0 / float(np.median(np.diff(samples.time)))
    even = np.arange(samples.time[0], samples.time[-1], 1.0 / rate)
    segment = round(SEGMENT_S * rate)
    if segment < 16:
        return None
    evenly = np.interp(even, samples.time[good], values[good])
    frequency, density = welch(evenly, rate, nperseg=segment, detrend="linear")
    segments = 2 * even.size // segment - 1
    # A channel that stands still has no density at all, and a ratio needs one.
    return frequency[1:], density[1:] + 1e-14 * float(density.max()) + 1e-300, SEGMENT_FREEDOM * segments


def changed_lines(spectra: list[Spectrum], a: Samples, b: Samples) -> list[Line]:
    """Each channel's line of the largest change, those beyond chance first."""
    from scipy.ndimage import median_filter
    from scipy.stats import f as fisher

    bins = sum(int((s.frequency >= LEAST_HZ).sum()) for s in spectra)
    found = []
    for s in spectra:
        ratio = np.log(s.b / s.a)
        width = max(round(AROUND_HZ / max(s.frequency[1] - s.frequency[0], 1e-9)), 1)
        beside = ratio - median_filter(ratio, 2 * width + 1, mode="nearest")
        inside = np.flatnonzero(s.frequency >= LEAST_HZ)
        if not inside.size:
            continue
        k = int(inside[np.argmax(np.abs(beside[inside]))])
        up, frequency = beside[k] > 0.0, float(s.frequency[k])
        freedom = s.freedom[::-1] if up else s.freedom
        limit = float(np.log(fisher.isf(CHANCE / (2.0 * bins), *freedom)))
        found.append(Line(
            channel=s.channel, frequency_hz=round(frequency, 2), ratio=float(np.exp(ratio[k])),
            order=_order(b if up else a, frequency), beyond_chance=abs(beside[k]) > limit,
        ))  # fmt: skip
    return sorted(found, key=lambda x: (not x.beyond_chance, -abs(np.log(x.ratio))))


def _order(samples: Samples, frequency_hz: float) -> float | None:
    """Order of the shaft that a frequency is, where the shaft turns evenly."""
    speed = np.abs(column(samples, "pump_speed"))
    speed = speed[np.isfinite(speed)]
    turning = speed[speed > LEAST_TURN * speed.max(initial=0.0)]
    if not turning.size:
        return None
    low, middle, high = np.percentile(turning, (25.0, 50.0, 75.0))
    even = high - low <= MOST_SPREAD * middle
    return round(float(frequency_hz * 2.0 * np.pi / middle), 2) if even else None
