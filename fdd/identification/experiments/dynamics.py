"""Input and output of a log, and what joins them: spectra by Welch, and a pole pair through them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeWarning, curve_fit
from scipy.signal import csd, decimate
from scipy.stats import f as fisher

from fdd.errors import InputError
from fdd.identification import Array
from fdd.identification.record import Record

LONGEST, SHORTEST = 10.0, 2.0
"""s of one stretch."""
QUIET = 0.1
"""Of the strongest stretch's input; weaker ones are left out."""
OVERLAPPED = 1.056
"""Windows of Hann overlapping by half per independent one (Welch, doi.org/10.1109/TAU.1967.1161901)."""
NEIGHBOURS = 1.94
"""Frequencies per independent one: the squared correlations of Hann's neighbours, summed."""
CIRCLE_95 = 2.448
"""Standard deviations of either part of a complex number, in the radius that holds it in 95 %."""
LEAST_WINDOWS = 8
"""Of Welch; of fewer, noise alone is coherent."""
FINEST = 1e-4
"""Least standard deviation of a response over its size: no sensor is better."""
COHERENT = 0.6
"""Squared coherence from which the response counts as told."""


def stretches(records: list[Record], given: str, rate_hz: float) -> tuple[list[Array], float]:
    """Input, `given`, and velocity (n, 2) in all stretches with the strongest input, and their sampling
    interval (s): of at least `rate_hz`.

    Every signal is averaged over each interval: for a held command and for counts of an encoder that is
    exact, where rates taken at one instant would be late by half a sample.

    Raises InputError: no command in the log, logs of different rates, or no gapless two seconds.
    """
    period = records[0].period
    if any(abs(r.period / period - 1.0) > 0.01 for r in records):
        raise InputError("the logs' sampling rates differ", mend="give logs of one rate")
    coarser = max(int(1.0 / (period * rate_hz)), 1)
    found = []
    for record in records:
        signals = np.diff(np.column_stack([_integral(record, given), record.position]), axis=0) / period
        edges = np.flatnonzero(np.diff(np.concatenate(([0], (~record.gap[1:]).astype(np.int8), [0]))))
        for start, stop in edges.reshape(-1, 2):
            count = -(-(stop - start) // round(LONGEST / period))
            for a, b in pairwise(np.linspace(start, stop, count + 1).astype(int)):
                if b - a < round(SHORTEST / period):
                    continue
                part = signals[a:b] - signals[a:b].mean(axis=0)
                found.append(decimate(part, coarser, ftype="fir", axis=0) if coarser > 1 else part)
    if not found:
        raise InputError(f"no {SHORTEST:.0f} s without a gap", mend="record without gaps")
    strength = np.array([np.std(part[:, 0]) for part in found])
    kept = np.flatnonzero(strength >= QUIET * strength.max())
    return [found[k] for k in kept], coarser * period


def _integral(record: Record, given: str) -> Array:
    """(n,) what, differenced, is the input's mean over each sampling interval."""
    if given == "pump_speed":
        return record.angle
    if record.command is None:
        raise InputError("the log has no command", mend="use --input pump_speed, or map a column to command")
    return np.concatenate([[0.0], np.cumsum(record.command[:-1]) * record.period])


@dataclass(frozen=True)
class Spectra:
    """Empirical response over frequency (n,) in Hz: cross spectrum over the input's own."""

    frequency: Array
    response: NDArray[np.complex128]
    coherence: Array
    """Squared, 0 to 1."""
    radius: Array
    """Of the circle about the response that holds the true one in 95 % (Bendat and Piersol, Random Data,
    9.2.3)."""


def welch(parts: list[Array], period: float, window_s: float) -> Spectra:
    """Welch's estimate from input and output (n, 2), with Hann windows of `window_s` that overlap by half.

    Raises InputError: too few windows in the stretches.
    """
    rows = max(round(window_s / period), 16)
    powers, windows = np.zeros((3, rows // 2 + 1), dtype=np.complex128), 0
    for part in parts:
        count = max((len(part) - rows) // (rows - rows // 2) + 1, 0)
        if count:
            for k, (a, b) in enumerate(((0, 0), (1, 1), (0, 1))):
                cross = csd(part[:, a], part[:, b], 1.0 / period, nperseg=rows, detrend="linear")[1]
                powers[k] += count * cross
            windows += count
    if windows < LEAST_WINDOWS:
        problem = f"{windows} windows of {window_s:.3g} s without a gap, {LEAST_WINDOWS} are needed"
        raise InputError(problem, mend="give a shorter --window, or longer logs")
    frequency = np.asarray(np.fft.rfftfreq(rows, period), dtype=np.float64)
    use = (frequency > 0.0) & (frequency < 0.4 / period)
    own, out = (np.maximum(x, 1e-12 * x.max(initial=0.0) + 1e-300) for x in powers[:2].real[:, use])
    cross = powers[2, use]
    response = cross / own
    coherence = np.clip(np.abs(cross) ** 2 / own / out, 1e-9, 1.0)
    free = windows / OVERLAPPED
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


@dataclass(frozen=True)
class PolePair:
    """A pole pair behind a delay: gain at rest, natural frequency (Hz), damping ratio, delay (s), (4,)."""

    theta: Array
    std: Array
    fit: float
    """One less its squared relative error, a mean over the logarithm of frequency."""

    def at(self, frequency: Array) -> NDArray[np.complex128]:
        """Response at `frequency` (n,) in Hz."""
        return _pole_pair(frequency, *self.theta)


def _pole_pair(f: Array, gain: float, hz: float, damping: float, delay: float) -> NDArray[np.complex128]:
    resonance = hz**2 / (hz**2 - f**2 + 2j * damping * hz * f)
    return np.asarray(gain * resonance * np.exp(-2j * np.pi * f * delay))


def fit_pole_pair(found: Spectra, natural: float) -> PolePair | None:
    """Least squares of a pole pair to the coherent part of a response, each frequency by its circle.

    It starts from `natural` (Hz); None where it does not converge.
    """
    use = found.coherence > COHERENT
    f, response = found.frequency[use], found.response[use]
    sigma = np.maximum(found.radius[use] / CIRCLE_95, FINEST * np.abs(response))

    def parts(values: NDArray[np.complex128]) -> Array:
        return np.concatenate([values.real, values.imag])

    level = float(np.median(response.real[f <= 2.0 * f[0]]))
    try:
        with warnings.catch_warnings(action="error", category=OptimizeWarning):
            theta, covariance = curve_fit(
                lambda f, *theta: parts(_pole_pair(f, *theta)), f, parts(response),
                (level, natural, 0.3, 0.0), np.tile(sigma, 2), absolute_sigma=True,
            )  # fmt: skip
    except (RuntimeError, OptimizeWarning):
        return None
    theta[2] *= np.sign(theta[1])
    theta[1] = abs(theta[1])
    left = response - _pole_pair(f, *theta)
    misfit = float(np.sum(np.abs(left / sigma) ** 2)) / (2 * f.size - theta.size)
    std = np.sqrt(NEIGHBOURS * max(misfit, 1.0) * np.diag(covariance))
    return PolePair(theta, std, 1.0 - float(np.average(np.abs(left / response) ** 2, weights=1.0 / f)))
