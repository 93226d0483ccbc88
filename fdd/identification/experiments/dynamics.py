"""Input and output of a log, and what joins them: spectra by Welch, and Box-Jenkins models.

Models are ``y = q⁻ᵏ·B/F·u + C/D·e``, fitted by the prediction-error method (Ljung 1999, 4.2 and 7). Of the
structures of thesis 6.1 it is the one that holds whatever the noise is: an output-error model is one
with C and D at one, ARX and ARMAX models give noise the plant's own poles. No library is used for it: those
that have it either give no standard deviations or weigh more than this module by their dependencies.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.optimize import least_squares
from scipy.signal import csd, decimate, lfilter
from scipy.stats import f as fisher

from fdd.errors import InputError
from fdd.identification import Array
from fdd.identification.record import Record

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
UNSTABLE = 1e3
"""Standard deviations of the output that a prediction with unstable filters counts as wrong."""
SCORE_SECONDS = 0.25
"""Errors farther apart than this count as independent in the standard deviations."""


@dataclass(frozen=True)
class Series:
    """Input and output of one uninterrupted stretch, (n,) each about their means, and the rows that count."""

    given: Array
    caused: Array
    used: NDArray[np.bool_]


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


@dataclass(frozen=True)
class Model:
    """A fitted model.

    Attributes
    ----------
    order : number of poles. delay, period : samples and s.
    theta, covariance : coefficients of b, c, d and f, and their covariance, which holds for coloured errors
        too. bic : Bayesian information criterion.
    """

    order: int
    delay: int
    period: float
    theta: Array
    covariance: Array
    bic: float

    def polynomials(self, theta: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """b, c, d and f in powers of 1/z, leading ones and the delay's zeros included."""
        return _split(self.order, self.delay, self.theta if theta is None else theta)

    def simulate(self, given: Array) -> Array:
        """What the input alone causes, (n,), from rest."""
        b, _, _, f = self.polynomials()
        return np.asarray(lfilter(b, f, given))

    def errors(self, series: Series) -> Array:
        """(n,) one-step prediction errors."""
        b, c, d, f = self.polynomials()
        return np.asarray(lfilter(d, c, series.caused - lfilter(b, f, series.given)))

    def at(self, frequency: Array) -> NDArray[np.complex128]:
        """Response at `frequency` (n,) in Hz."""
        b, _, _, f = self.polynomials()
        z = np.exp(-2j * np.pi * frequency * self.period)
        return np.asarray(np.polyval(b[::-1], z) / np.polyval(f[::-1], z), dtype=np.complex128)

    def facts(self, theta: Array | None = None) -> Array:
        """Gain at rest, then natural frequency (Hz) and damping of each pole, slowest first.

        A pole on the negative real axis or at zero belongs to no continuous system and has NaN.
        """
        b, _, _, f = self.polynomials(theta)
        z = np.roots(f).astype(np.complex128)
        possible = (z.real > 0.0) | (np.abs(z.imag) > 1e-9)
        s = np.log(np.where(possible, z, np.nan)) / self.period
        s = s[np.lexsort((s.imag, np.abs(s)))]
        size = np.abs(s)
        return np.concatenate([[b.sum() / f.sum()], size / (2.0 * np.pi), -s.real / size])

    def facts_std(self) -> Array:
        """Standard deviation of each of `facts`."""
        gradient = np.empty((self.facts().size, self.theta.size))
        for k in range(self.theta.size):
            step = np.zeros(self.theta.size)
            step[k] = 0.01 * np.sqrt(self.covariance[k, k]) + 1e-12
            gradient[:, k] = (self.facts(self.theta + step) - self.facts(self.theta - step)) / (2.0 * step[k])
        variance = np.einsum("ik,kl,il->i", gradient, self.covariance, gradient)
        # Rounding makes the covariance of parameters that the data do not tell apart indefinite.
        return np.where(variance < 0.0, np.inf, np.sqrt(np.maximum(variance, 0.0)))


def fit_model(series: list[Series], period: float, order: int, delay: int) -> Model:
    """Make the sum of squared prediction errors least.

    `order` is that of f: b has one coefficient more, c and d two at most. `period` in s, `delay` in samples.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> u = rng.standard_normal(4000)
    >>> y = lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.1 * rng.standard_normal(4000)
    >>> model = fit_model([Series(u, y, np.ones(4000, bool))], 0.01, 1, 1)
    >>> model.facts()[:2].round(1).tolist(), bool(model.facts_std()[0] < 0.02)
    ([2.5, 3.5], True)
    """
    size = float(np.sqrt(np.mean(np.concatenate([s.caused[s.used] ** 2 for s in series]))))
    few = min(order, 2)

    def residual(theta: Array) -> Array:
        b, c, d, f = _split(order, delay, theta)
        if max(np.abs(np.roots(p)).max(initial=0.0) for p in (c, f)) >= 1.0:
            return np.full(sum(int(s.used.sum()) for s in series), UNSTABLE * size)
        return np.concatenate([lfilter(d, c, s.caused - lfilter(b, f, s.given))[s.used] for s in series])

    def jacobian(theta: Array) -> Array:
        b, c, d, f = _split(order, delay, theta)
        both, parts = np.convolve(c, f), []
        for s in series:
            response = lfilter(b, f, s.given)
            left = s.caused - response
            of = (
                (-lfilter(d, both, s.given), order + 1, delay),
                (-lfilter([1.0], c, lfilter(d, c, left)), few, 1),
                (lfilter([1.0], c, left), few, 1),
                (lfilter(d, both, response), order, 1),
            )
            parts.append(np.hstack([_lagged(*each) for each in of])[s.used])
        return np.concatenate(parts)

    start = _start(series, order, delay)
    theta = least_squares(residual, start, jacobian, method="lm", x_scale="jac", max_nfev=100).x
    left, slopes = residual(theta), jacobian(theta)
    rows = left.size
    inverse = np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    step = max(round(SCORE_SECONDS / period), 1)
    scores = np.add.reduceat(slopes * left[:, None], np.arange(0, rows, step))
    meat = scores.T @ scores * len(scores) / max(len(scores) - theta.size, 1)
    bic = rows * np.log(float(np.mean(left**2)) + 1e-300) + theta.size * np.log(rows)
    return Model(order, delay, period, theta, inverse @ meat @ inverse, float(bic))


def find_delay(series: list[Series], most: int) -> int:
    """Samples of delay, 0 to `most`, with which an ARX model of fourth order errs least."""
    return min(range(most + 1), key=lambda d: _arx(series, 4, d)[1])


def _split(order: int, delay: int, theta: Array) -> tuple[Array, Array, Array, Array]:
    few = min(order, 2)
    b, *others = np.split(theta, np.cumsum([order + 1, few, few]))
    c, d, f = (np.concatenate([[1.0], p]) for p in others)
    return np.concatenate([np.zeros(delay), b]), c, d, f


def _lagged(values: Array, count: int, first: int) -> Array:
    """(n, count) the values `first`, `first` + 1, … samples ago."""
    late = np.concatenate([np.zeros(first), values])[: values.size]
    return np.asarray(toeplitz(late, np.zeros(count)))


def _arx(series: list[Series], order: int, delay: int) -> tuple[Array, float]:
    """(2·order + 1,) a and b of ``A·y = q⁻ᵏ·B·u + e`` by least squares, and the mean square error."""
    rows = np.concatenate([
        np.hstack([-_lagged(s.caused, order, 1), _lagged(s.given, order + 1, delay)])[s.used] for s in series
    ])  # fmt: skip
    wanted = np.concatenate([s.caused[s.used] for s in series])
    theta = np.asarray(np.linalg.lstsq(rows, wanted, rcond=None)[0])
    return theta, float(np.mean((wanted - rows @ theta) ** 2))


def _start(series: list[Series], order: int, delay: int) -> Array:
    """A first guess: linear least squares of what is filtered by the model before (Steiglitz and McBride)."""
    theta = _arx(series, order, delay)[0]
    for _ in range(10):
        bottom = _reflected(np.concatenate([[1.0], theta[:order]]))
        filtered = [
            Series(lfilter([1.0], bottom, s.given), lfilter([1.0], bottom, s.caused), s.used) for s in series
        ]
        theta = _arx(filtered, order, delay)[0]
    f = _reflected(np.concatenate([[1.0], theta[:order]]))[1:]
    return np.concatenate([theta[order:], np.zeros(2 * min(order, 2)), f])


def _reflected(polynomial: Array) -> Array:
    """The polynomial with its roots brought inside the unit circle."""
    roots = np.roots(polynomial)
    size = np.abs(roots)
    roots = np.where(size > 1.0, roots / np.maximum(size, 1.0) ** 2, roots)
    return np.real(np.poly(roots * np.minimum(1.0, 0.999 / np.maximum(np.abs(roots), 1e-12))))
