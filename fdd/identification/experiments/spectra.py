"""Input and output of a log on a grid as coarse as the question allows, and their spectra by Welch."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, decimate
from scipy.stats import f as fisher

from fdd.errors import InputError
from fdd.identification.experiments.polynomial import Series
from fdd.identification.record import Record

Array = NDArray[np.float64]

LONGEST, SHORTEST = 10.0, 2.0
"""s of one stretch."""
MOST_ROWS = 40_000
"""Of the grid, those with the strongest input: more sharpen little and take minutes."""
QUIET = 0.1
"""Of the strongest stretch's input; weaker ones are left out."""
SETTLING = 0.25
"""s at either end of a stretch that do not count: the state before it is not known."""
PARTS = 8
"""Of each stretch: every other one is for the fit, those between to test it."""
OVERLAPPED = 1.056
"""Windows of Hann overlapping by half per independent one (Welch, doi.org/10.1109/TAU.1967.1161901)."""


def stretches(records: list[Record], given: str, caused: str, rate_hz: float) -> tuple[list[Series], float]:
    """The stretches of all logs with the strongest input, about their means, and their sampling interval (s).

    Every signal is averaged over each interval: for a held command and for counts of an encoder that is
    exact, where rates taken at one instant would be late by half a sample.

    Parameters
    ----------
    records : logs of one sampling rate. given : pump_speed or command.
    caused : rate, position or pressure_difference. rate_hz : the grid is no coarser than this.

    Raises InputError: no command in the log, logs of different rates, or no gapless two seconds.
    """
    period = records[0].period
    if any(abs(r.period / period - 1.0) > 0.01 for r in records):
        raise InputError("the logs' sampling rates differ", mend="give logs of one rate")
    coarser = max(int(1.0 / (period * rate_hz)), 1)
    rim = round(SETTLING / (coarser * period))
    found = []
    for record in records:
        signals = np.column_stack([np.diff(_integral(record, c)) / period for c in (given, caused)])
        edges = np.flatnonzero(np.diff(np.concatenate(([0], (~record.gap[1:]).astype(np.int8), [0]))))
        for start, stop in edges.reshape(-1, 2):
            count = -(-(stop - start) // round(LONGEST / period))
            for a, b in pairwise(np.linspace(start, stop, count + 1).astype(int)):
                if b - a < round(SHORTEST / period):
                    continue
                part = signals[a:b] - signals[a:b].mean(axis=0)
                if coarser > 1:
                    part = decimate(part, coarser, ftype="fir", axis=0)
                used = np.ones(part.shape[0], dtype=bool)
                used[:rim] = used[-rim:] = False
                found.append(Series(part[:, 0].copy(), part[:, 1].copy(), used))
    if not found:
        raise InputError(f"no {SHORTEST:.0f} s without a gap", mend="record without gaps")
    found.sort(key=lambda s: -float(np.std(s.given)))
    strongest = float(np.std(found[0].given))
    kept = [s for s in found if np.std(s.given) >= QUIET * strongest]
    sizes = np.cumsum([s.given.size for s in kept])
    return kept[: max(int(np.searchsorted(sizes, MOST_ROWS)), 1)], coarser * period


def _integral(record: Record, name: str) -> Array:
    """(n,) what, differenced, is a signal's mean over each sampling interval."""
    if name == "pump_speed":
        return record.angle
    if name in ("rate", "position"):
        return record.position
    values = record.difference if name == "pressure_difference" else record.command
    if values is None:
        raise InputError("the log has no command", mend="use --input pump_speed, or map a column to command")
    held = values if name == "command" else np.append(0.5 * (values[1:] + values[:-1]), 0.0)
    return np.concatenate([[0.0], np.cumsum(held[:-1]) * record.period])


def halves(series: list[Series]) -> list[list[Series]]:
    """The same stretches twice, with every other part to fit and the parts between to test."""
    parts = [np.arange(s.given.size) * PARTS // s.given.size for s in series]
    return [
        [Series(s.given, s.caused, s.used & (p % 2 == odd)) for s, p in zip(series, parts, strict=True)]
        for odd in (0, 1)
    ]


@dataclass(frozen=True)
class Spectra:
    """Empirical response over frequency (n,) in Hz.

    Attributes
    ----------
    response : cross spectrum over the input's own. coherence : squared, 0 to 1.
    radius : of the circle about the response that holds the true one in 95 % (Bendat and Piersol, Random
        Data, 9.2.3).
    """

    frequency: Array
    response: NDArray[np.complex128]
    coherence: Array
    radius: Array


def welch(series: list[Series], period: float, window_s: float) -> Spectra:
    """Welch's estimate with Hann windows of `window_s` that overlap by half, over all stretches."""
    rows = max(round(window_s / period), 16)
    powers, windows = np.zeros((3, rows // 2 + 1), dtype=np.complex128), 0
    for s in series:
        count = max((s.given.size - rows) // (rows - rows // 2) + 1, 0)
        if count:
            pairs = ((s.given, s.given), (s.caused, s.caused), (s.given, s.caused))
            powers += count * np.array(
                [csd(a, b, 1.0 / period, nperseg=rows, detrend="linear")[1] for a, b in pairs]
            )
            windows += count
    frequency = np.asarray(np.fft.rfftfreq(rows, period), dtype=np.float64)
    use = (frequency > 0.0) & (frequency < 0.4 / period)
    own, out = (np.maximum(x, 1e-12 * x.max(initial=0.0) + 1e-300) for x in powers[:2].real[:, use])
    cross = powers[2, use]
    response = cross / own
    coherence = np.clip(np.abs(cross) ** 2 / own / out, 1e-9, 1.0)
    free = max(windows / OVERLAPPED, 2.0)
    share = fisher.ppf(0.95, 2, 2.0 * free - 2.0) / (free - 1.0) * (1.0 / coherence - 1.0)
    return Spectra(frequency[use], response, coherence, np.abs(response) * np.sqrt(share))


def half_power_frequency(frequency: Array, magnitude: Array, reference: float) -> float:
    """Where a response first falls below `reference`/√2, between the points by a straight line.

    It is in Hz as `frequency` (n,), which rises; NaN where the `magnitude` (n,) never falls so far, the first
    frequency where it begins below.

    Examples
    --------
    >>> round(half_power_frequency(np.array([1.0, 2.0]), np.array([1.0, 0.0]), 1.0), 3)
    1.293
    """
    level = reference / np.sqrt(2.0)
    below = np.flatnonzero(magnitude < level)
    if below.size == 0:
        return float("nan")
    k = int(below[0])
    if k == 0:
        return float(frequency[0])
    share = (magnitude[k - 1] - level) / (magnitude[k - 1] - magnitude[k])
    return float(frequency[k - 1] + share * (frequency[k] - frequency[k - 1]))
