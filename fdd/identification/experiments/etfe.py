"""Empirical transfer function estimate: the output's Fourier transform over the input's.

Thesis chapter 6 identifies by it; Ljung, System Identification, 2nd ed., section 6.3 says what it is
worth. For a periodic input it is unbiased at the excited lines and its variance falls with the number of
periods. For any other input its variance does not fall with the length of the log: neighbouring frequencies
are then averaged, cross and own spectrum under a Hamming window before the division (Ljung's eq. 6.46).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve, spectrogram
from scipy.stats import spearmanr

from fdd.identification.experiments.polynomial import Series
from fdd.identification.experiments.spectra import Spectra, averaged

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

LONGEST = 120.0
"""s of one stretch: a sweep or a period that is cut leaves a transient at either end."""
REPEATS = 0.02
"""Share of the input's power that may differ from one period to the next."""
ALIKE, MOST_LAGS = 0.7, 40
"""The same over all of a stretch, of which a part may repeat itself, for a lag to be tried; how many are."""
STILL = 0.1
"""Of a stretch's power, below which its part is no test signal."""
LEAST_PART = 0.25
"""Of a stretch that must repeat itself: two turns of a slow chirp are alike, too."""
LEAST_LINES = 5
EXCITED, SAME_LINE = 1e-5, 0.9
"""Of the strongest line's power, and of a line's own that is the same in all periods: then it is excited."""
SWEEP_WINDOW, SWEEP_RATIO, SWEEP_ORDER = 0.5, 4.0, 0.95
"""s; highest over lowest frequency of a chirp; rank correlation of its frequency with time."""
REST = 0.1
"""Of the input's standard deviation, within which it begins and ends at one level: then a sweep is whole."""


@dataclass(frozen=True)
class Empirical:
    """The estimate, its input's kind (periodic, chirp or other), whether to prefer it to Welch's, and why."""

    spectra: Spectra
    given: str
    trusted: bool
    why: str


def repetition(given: Array) -> tuple[int, slice] | None:
    """Rows after which an input repeats itself, and the longest part that does, a quarter at least.

    Parameters
    ----------
    given : (n,) input about its mean.

    Returns
    -------
    Rows of a period and the part, or None.

    Examples
    --------
    >>> repetition(np.sin(2.0 * np.pi * np.arange(100) / 20.0))
    (20, slice(0, 100, None))
    >>> repetition(np.arange(100.0) - 49.5) is None
    True
    """
    n = given.size
    power = np.concatenate(([0.0], np.cumsum(given**2)))
    sums = np.concatenate(([0.0], np.cumsum(given)))
    # Strokes before a test signal may hold more power than it does, but not in their changes.
    for lag in [*_lags(given), *_lags(np.diff(given))]:
        starts = np.arange(n - 2 * lag + 1)
        differed = np.concatenate(([0.0], np.cumsum((given[lag:] - given[:-lag]) ** 2)))
        mean = (sums[starts + 2 * lag] - sums[starts]) / (2 * lag)
        about_mean = power[starts + 2 * lag] - power[starts] - 2 * lag * mean**2
        moving = about_mean > STILL * 2 * lag * np.mean(given**2)
        repeats = (differed[starts + lag] - differed[starts] < REPEATS * about_mean) & moving
        edges = np.flatnonzero(np.diff(np.concatenate(([0], repeats.astype(np.int8), [0]))))
        if edges.size:
            begin, end = (int(x) for x in max(edges.reshape(-1, 2), key=lambda run: run[1] - run[0]))
            if end - 1 + 2 * lag - begin > LEAST_PART * n:
                return lag, slice(begin, end - 1 + 2 * lag)
    return None


def _lags(signal: Array) -> list[int]:
    """Rows after which a signal is like itself, shortest first."""
    n = signal.size
    lags = np.arange(n // 2 + 1)
    product = fftconvolve(signal, signal[::-1])[n - 1 + lags]
    power = np.concatenate(([0.0], np.cumsum(signal**2)))
    change = 1.0 - 2.0 * product / np.maximum(power[n - lags] + power[n] - power[lags], 1e-300)
    apart = int(np.argmax(change > ALIKE))
    inner = change[1:-1]
    valleys = np.flatnonzero((inner < ALIKE) & (inner <= np.minimum(change[:-2], change[2:]))) + 1
    return [int(lag) for lag in valleys if lag > apart > 0][:MOST_LAGS]


def swept(given: Array, period: float) -> tuple[float, float] | None:
    """Lowest and highest frequency (Hz) of a chirp, rising or falling; None for any other input.

    Parameters
    ----------
    given : (n,) input about its mean. period : s.
    """
    rows = round(SWEEP_WINDOW / period)
    frequency, time, power = spectrogram(given, 1.0 / period, nperseg=rows, noverlap=rows // 2)
    strong = power.sum(axis=0) > 0.05 * np.median(power.sum(axis=0))
    peaks, time = frequency[np.argmax(power, axis=0)][strong], time[strong]
    low, high = float(max(peaks.min(), frequency[1])), float(peaks.max())
    if time.size < 8 or high < SWEEP_RATIO * low or abs(spearmanr(time, peaks)[0]) < SWEEP_ORDER:
        return None
    return low, high


def empirical_response(
    given: Array, caused: Array, period: float, width_hz: float = 2.0
) -> tuple[Array, ComplexArray]:
    """The estimate from one stretch, smoothed over frequency by a Hamming window.

    Parameters
    ----------
    given, caused : (n,) input and output. period : s. width_hz : of the window.

    Returns
    -------
    frequency (n // 2 + 1,) in Hz and response (n // 2 + 1,).
    """
    frequency, (own, _, cross), _ = _smoothed(given - given.mean(), caused - caused.mean(), period, width_hz)
    return frequency, np.asarray(cross / np.maximum(own.real, 1e-12 * own.real.max()))


def _smoothed(
    given: Array, caused: Array, period: float, width_hz: float
) -> tuple[Array, ComplexArray, float]:
    """Frequency; smoothed powers of input and output and cross power; lines that the window is worth."""
    u, y = np.fft.rfft(given), np.fft.rfft(caused)
    window = np.hamming(max(round(width_hz * given.size * period), 1) | 1)
    powers = np.array([u, y, y]) * np.conj([u, y, u])
    frequency = np.asarray(np.fft.rfftfreq(given.size, period), dtype=np.float64)
    smooth = np.asarray(fftconvolve(powers, window[None, :], mode="same", axes=1), dtype=np.complex128)
    return frequency, smooth, float(window.sum() ** 2 / np.sum(window**2))


def smoothed_etfe(series: list[Series], period: float, width_hz: float) -> Spectra:
    """The smoothed estimate over all stretches, at half the window's width apart.

    Parameters
    ----------
    series : stretches. period : s. width_hz : of the Hamming window over frequency.
    """
    frequency: Array = np.arange(1.0, int(0.8 / (period * width_hz))) * 0.5 * width_hz
    powers, lines = np.zeros((3, frequency.size), dtype=np.complex128), 0.0
    for s in series:
        raw, smooth, count = _smoothed(s.given, s.caused, period, width_hz)
        powers += [np.interp(frequency, raw, p) for p in smooth]
        lines += count
    return averaged(frequency, powers[0].real, powers[1].real, powers[2], lines)


def periodic_etfe(series: list[Series], period: float, rows: int) -> Spectra:
    """The estimate at the excited lines of an input that repeats itself, averaged over its periods.

    Parameters
    ----------
    series : stretches. period : s. rows : of one period of the input.

    Returns
    -------
    Spectra : the band is that of the spread between periods.
    """
    own = out = same = np.zeros(rows // 2 + 1)
    cross, count = np.zeros(rows // 2 + 1, dtype=np.complex128), 0
    for s in series:
        inside = np.flatnonzero(s.used)
        n = inside.size // rows
        if n == 0:
            continue
        first = inside[0] + (rows if n > 2 else 0)  # the first period may still settle
        n -= n > 2
        u, y = (
            np.fft.rfft(x[first : first + n * rows].reshape(n, rows), axis=1) for x in (s.given, s.caused)
        )
        own = own + np.sum(np.abs(u) ** 2, axis=0)
        out = out + np.sum(np.abs(y) ** 2, axis=0)
        same = same + np.abs(u.sum(axis=0)) ** 2 / n
        cross, count = cross + np.sum(y * np.conj(u), axis=0), count + n
    excited = (own > EXCITED * own.max()) & (same > SAME_LINE * own)
    excited[0] = False
    lines = np.flatnonzero(excited & (np.arange(own.size) < 0.4 * rows))
    return averaged(lines / (rows * period), own[lines], out[lines], cross[lines], count)


def etfe(candidates: list[list[Series]], period: float, width_hz: float) -> Empirical:
    """The estimate from the stretches that suit it best.

    Parameters
    ----------
    candidates : the log cut into long stretches, and into short ones. period : s.
    width_hz : of the Hamming window where the input is not periodic.
    """
    for series in candidates:
        found = [(s, r) for s in series if (r := repetition(s.given)) is not None]
        if found:
            rows = found[0][1][0]
            alike = []
            for s, (_, part) in [(s, r) for s, r in found if r[0] == rows]:
                row = np.arange(s.given.size)
                alike.append(replace(s, used=s.used & (row >= part.start) & (row < part.stop)))
            spectra = periodic_etfe(alike, period, rows)
            if spectra.frequency.size >= LEAST_LINES:
                seconds = sum(int(np.count_nonzero(s.used)) for s in alike) * period
                return Empirical(spectra, "periodic", True, (
                    f"The input repeats itself every {rows * period:.3g} s for {seconds:.3g} s: trust the "
                    f"ETFE of these, at the {spectra.frequency.size} frequencies that it excites, where it "
                    "has no bias and averages over periods; Welch's windows leak from line to line. "
                    "Friction bends each period alike: that is in the curve, and not in its band."
                ))  # fmt: skip
    for series in candidates:
        sweeps = [(s, band) for s in series if (band := swept(s.given, period)) is not None]
        if sweeps:
            low, high = min(b[0] for _, b in sweeps), max(b[1] for _, b in sweeps)
            n = max(round(0.1 / period), 2)
            rests = [np.std(np.append(s.given[:n], s.given[-n:])) < REST * np.std(s.given) for s, _ in sweeps]
            ends = (
                "It begins and ends at one level, so nothing leaks." if all(rests)
                else "It does not begin and end at one level: the transients at its ends stay in it."
            )  # fmt: skip
            return Empirical(smoothed_etfe([s for s, _ in sweeps], period, width_hz), "chirp", True, (
                f"The input is a chirp, {low:.3g} to {high:.3g} Hz: trust the ETFE there, whose transform "
                f"covers the whole sweep; Welch's windows cut it and leak. {ends}"
            ))  # fmt: skip
    return Empirical(smoothed_etfe(candidates[0], period, width_hz), "other", False, (
        "The input is neither periodic nor a chirp: trust Welch's estimate. The ETFE's variance does not "
        "fall with the length of the log; only its smoothing over frequency keeps it down."
    ))  # fmt: skip


def half_power_frequency(frequency: Array, magnitude: Array, reference: float) -> float:
    """Where a response first falls below `reference`/√2, between the points by a straight line.

    Parameters
    ----------
    frequency : (n,) Hz, rising.
    magnitude : (n,) of the response.
    reference : magnitude that counts as undiminished.

    Returns
    -------
    Hz; NaN where the magnitude never falls so far, the first frequency where it begins below.

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
