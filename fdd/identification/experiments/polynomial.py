"""Linear models by the prediction-error method: ``A·y = q⁻ᵏ·B/F·u + C/D·e`` (Ljung 1999, 4.2 and 7).

ARX, ARMAX, output-error and Box-Jenkins models (thesis 6.1) are this one structure with some polynomials
left at one. No library is used for it: those that have all four either give no standard deviations or weigh
more than this module by their dependencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.optimize import least_squares
from scipy.signal import lfilter

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STRUCTURES = {"ARX": "ab", "ARMAX": "abc", "OE": "bf", "BJ": "bcdf"}
"""The polynomials that each structure has."""
UNSTABLE = 1e3
"""Standard deviations of the output that a prediction with unstable filters counts as wrong."""
SCORE_SECONDS = 0.25
"""Errors farther apart than this count as independent in the standard deviations."""


@dataclass(frozen=True)
class Series:
    """Input and output of one uninterrupted stretch, (n,) each about their means, and the rows that count."""

    given: Array
    caused: Array
    used: Mask


@dataclass(frozen=True)
class Model:
    """A fitted model.

    Attributes
    ----------
    structure : ARX, ARMAX, OE or BJ. order : number of poles. delay, period : samples and s.
    theta, covariance : coefficients, b first where there is no a, and their covariance, which holds for
        coloured errors too. variance : of the prediction error. bic : Bayesian information criterion.
    """

    structure: str
    order: int
    delay: int
    period: float
    theta: Array
    covariance: Array
    variance: float
    bic: float

    def polynomials(self, theta: Array | None = None) -> dict[str, Array]:
        """a, b, c, d and f in powers of 1/z, leading ones and the delay's zeros included."""
        return _split(self.structure, self.order, self.delay, self.theta if theta is None else theta)

    def simulate(self, given: Array) -> Array:
        """What the input alone causes, (n,), from rest."""
        p = self.polynomials()
        return np.asarray(lfilter(p["b"], np.convolve(p["a"], p["f"]), given))

    def errors(self, series: Series) -> Array:
        """(n,) one-step prediction errors."""
        return _predict(self.polynomials(), series)[0]

    def at(self, frequency: Array) -> NDArray[np.complex128]:
        """Response at `frequency` (n,) in Hz."""
        p, z = self.polynomials(), np.exp(-2j * np.pi * frequency * self.period)
        ratio = np.polyval(p["b"][::-1], z) / np.polyval(np.convolve(p["a"], p["f"])[::-1], z)
        return np.asarray(ratio, dtype=np.complex128)

    def facts(self, theta: Array | None = None) -> Array:
        """Gain at rest, then natural frequency (Hz) and damping of each pole, slowest first.

        A pole on the negative real axis or at zero belongs to no continuous system and has NaN.
        """
        p = self.polynomials(theta)
        bottom = np.convolve(p["a"], p["f"])
        z = np.roots(bottom).astype(np.complex128)
        possible = (z.real > 0.0) | (np.abs(z.imag) > 1e-9)
        s = np.log(np.where(possible, z, np.nan)) / self.period
        s = s[np.lexsort((s.imag, np.abs(s)))]
        size = np.abs(s)
        return np.concatenate([[p["b"].sum() / bottom.sum()], size / (2.0 * np.pi), -s.real / size])

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


def fit_model(series: list[Series], period: float, structure: str, order: int, delay: int) -> Model:
    """Make the sum of squared prediction errors least.

    Parameters
    ----------
    series : one or more stretches. period : s.
    structure : ARX, ARMAX, OE or BJ.
    order : of all its polynomials but c and d, which have two coefficients at most; b has one more.
    delay : samples.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> u = rng.standard_normal(4000)
    >>> y = lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.1 * rng.standard_normal(4000)
    >>> model = fit_model([Series(u, y, np.ones(4000, bool))], 0.01, "OE", 1, 1)
    >>> model.facts()[:2].round(1).tolist(), bool(model.facts_std()[0] < 0.02)
    ([2.5, 3.5], True)
    """
    size = float(np.sqrt(np.mean(np.concatenate([s.caused[s.used] ** 2 for s in series]))))

    def residual(theta: Array) -> Array:
        p = _split(structure, order, delay, theta)
        if not (_stable(p["c"]) and _stable(p["f"])):
            return np.full(sum(int(s.used.sum()) for s in series), UNSTABLE * size)
        return np.concatenate([_predict(p, s)[0][s.used] for s in series])

    def jacobian(theta: Array) -> Array:
        p = _split(structure, order, delay, theta)
        return np.concatenate([_gradient(p, structure, order, delay, s)[s.used] for s in series])

    theta = _start(series, structure, order, delay)
    if structure != "ARX":  # that one is linear, and its start the answer
        theta = least_squares(residual, theta, jacobian, method="lm", x_scale="jac", max_nfev=100).x
    left, slopes = residual(theta), jacobian(theta)
    rows = left.size
    inverse = np.linalg.pinv(slopes.T @ slopes, hermitian=True)
    step = max(round(SCORE_SECONDS / period), 1)
    scores = np.add.reduceat(slopes * left[:, None], np.arange(0, rows, step))
    groups = scores.shape[0]
    meat = scores.T @ scores * groups / max(groups - theta.size, 1)
    variance = float(np.mean(left**2))
    bic = rows * np.log(variance + 1e-300) + theta.size * np.log(rows)
    return Model(structure, order, delay, period, theta, inverse @ meat @ inverse, variance, float(bic))


def best_model(
    series: list[Series], period: float, structure: str, orders: tuple[int, ...], delay: int
) -> Model:
    """The model of the order with the least BIC; parameters as in `fit_model`."""
    return min((fit_model(series, period, structure, n, delay) for n in orders), key=lambda m: m.bic)


def find_delay(series: list[Series], most: int) -> int:
    """Samples of delay, 0 to `most`, with which an ARX model of fourth order errs least."""
    return min(range(most + 1), key=lambda d: fit_model(series, 1.0, "ARX", 4, d).variance)


def _counts(structure: str, order: int) -> dict[str, int]:
    few = min(order, 2)
    counts = {"a": order, "b": order + 1, "c": few, "d": few, "f": order}
    return {name: counts[name] for name in STRUCTURES[structure]}


def _split(structure: str, order: int, delay: int, theta: Array) -> dict[str, Array]:
    p = {name: np.ones(1) for name in "abcdf"}
    first = 0
    for name, count in _counts(structure, order).items():
        head = np.zeros(delay) if name == "b" else np.ones(1)
        p[name] = np.concatenate([head, theta[first : first + count]])
        first += count
    return p


def _stable(polynomial: Array) -> bool:
    return polynomial.size < 2 or bool(np.max(np.abs(np.roots(polynomial))) < 1.0)


def _predict(p: dict[str, Array], s: Series) -> tuple[Array, Array, Array]:
    """Prediction error, and on the way to it the response and what it leaves."""
    response = lfilter(p["b"], p["f"], s.given)
    left = lfilter(p["a"], [1.0], s.caused) - response
    return lfilter(p["d"], p["c"], left), response, left


def _gradient(p: dict[str, Array], structure: str, order: int, delay: int, s: Series) -> Array:
    """(n, parameters) of the prediction errors over each coefficient."""
    error, response, left = _predict(p, s)
    both = np.convolve(p["c"], p["f"])
    of = {
        "a": (lfilter(p["d"], p["c"], s.caused), 1),
        "b": (-lfilter(p["d"], both, s.given), delay),
        "c": (-lfilter([1.0], p["c"], error), 1),
        "d": (lfilter([1.0], p["c"], left), 1),
        "f": (lfilter(p["d"], both, response), 1),
    }
    counts = _counts(structure, order)
    return np.hstack([_lagged(of[name][0], count, of[name][1]) for name, count in counts.items()])


def _lagged(values: Array, count: int, first: int) -> Array:
    """(n, count) the values `first`, `first` + 1, … samples ago."""
    late = np.concatenate([np.zeros(first), values])[: values.size]
    return np.asarray(toeplitz(late, np.zeros(count)))


def _arx(series: list[Series], order: int, delay: int) -> Array:
    """(2·order + 1,) coefficients a and b, by linear least squares."""
    rows = [
        np.hstack([-_lagged(s.caused, order, 1), _lagged(s.given, order + 1, delay)])[s.used] for s in series
    ]
    wanted = np.concatenate([s.caused[s.used] for s in series])
    return np.asarray(np.linalg.lstsq(np.concatenate(rows), wanted, rcond=None)[0])


def _start(series: list[Series], structure: str, order: int, delay: int) -> Array:
    """A first guess: linear least squares, for output-error structures filtered (Steiglitz and McBride)."""
    theta, few = _arx(series, order, delay), min(order, 2)
    if structure == "ARX":
        return theta
    if structure == "ARMAX":
        return np.concatenate([theta, np.zeros(few)])
    for _ in range(10):
        bottom = _reflected(np.concatenate([[1.0], theta[:order]]))
        smooth = [(lfilter([1.0], bottom, s.given), lfilter([1.0], bottom, s.caused)) for s in series]
        theta = _arx([Series(*x, s.used) for x, s in zip(smooth, series, strict=True)], order, delay)
    f = _reflected(np.concatenate([[1.0], theta[:order]]))[1:]
    return np.concatenate([theta[order:], np.zeros(2 * few if structure == "BJ" else 0), f])


def _reflected(polynomial: Array) -> Array:
    """The polynomial with its roots brought inside the unit circle."""
    roots = np.roots(polynomial)
    size = np.abs(roots)
    roots = np.where(size > 1.0, roots / np.maximum(size, 1.0) ** 2, roots)
    return np.real(np.poly(roots * np.minimum(1.0, 0.999 / np.maximum(np.abs(roots), 1e-12))))
