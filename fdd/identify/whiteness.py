"""Is what a filter did not expect white?

White innovations carry nothing that could still be predicted; `fdd.identify.colour` says what others
are made of.

Source: Ljung and Box 1978, doi 10.1093/biomet/65.2.297, for whiteness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc, gammaincinv

from estimators.consistency import nis_band
from fdd.identify.colour import FALSE_ALARM, WORTH_NAMING, Cause, causes_of
from fdd.identify.innovations import Innovations

Array = NDArray[np.float64]

LAGS = 20
SILENT = 0.1
"""Mean NIS below which a channel's innovations are covered by process noise and test nothing."""
QUIET = 0.7
"""Mean NIS below which a channel's noise is called too large; two sensors may share one number."""
LEAST_SAMPLES = 500
SLOW_BLOCK = 0.5
"""s: leakage is learned from what lasts longer than this."""
LEAST_BLOCKS = 12


@dataclass(frozen=True)
class ChannelTest:
    """How one channel's innovations compare with what the filter expects of them.

    Attributes
    ----------
    channel : name. samples : tested ones.
    nis : mean of their squares in sigmas, 1 when consistent; `low`, `high` : its 95 % band.
    inside : share within 1.96 sigmas, 0.95 when consistent.
    autocorrelation : (20,) at lags 1 to 20. p_value : of Ljung and Box's test.
    slow : mean square of half-second means, times their number of samples: 1 when white.
    slow_band : its 95 % band, from the number of such means.
    white : no autocorrelation that is both sure and worth naming, and no slow excess.
    causes : what the departure is made of, the largest first.
    """

    channel: str
    samples: int
    nis: float
    low: float
    high: float
    inside: float
    autocorrelation: Array
    p_value: float
    slow: float
    slow_band: tuple[float, float]
    white: bool
    causes: tuple[Cause, ...]

    @property
    def words(self) -> str:
        """What remains, in words."""
        if self.samples < LEAST_SAMPLES:
            return "too few samples"
        if self.nis < SILENT:
            return "no test: process noise of motion or refeeding covers it, by choice"
        if self.white:
            what = "white"
        else:
            what = "; ".join(c.sentence for c in self.causes) or "not white, no cause found"
        return f"{what}; quieter than the filter's noise for it" if self.nis < QUIET else what


def channel_tests(found: list[Innovations], resolution: dict[str, float] | None = None) -> list[ChannelTest]:
    """Test each channel of the innovations of some logs of one filter.

    Parameters
    ----------
    found : of logs with the same channels.
    resolution : each channel's smallest step, SI; none where it is left out.

    Returns
    -------
    One test per channel, in the order of the innovations' channels.
    """
    names = found[0].channels
    steps = resolution or {}
    return [_tested(name, i, found, steps.get(name, 0.0)) for i, name in enumerate(names)]


def masked_autocorrelation(series: list[Array], lags: int = LAGS) -> tuple[Array, Array]:
    """Autocorrelation about zero over pairs that are both there.

    Parameters
    ----------
    series : of (n,) each, NaN where a sample is missing.
    lags : 1 to `lags`.

    Returns
    -------
    (lags,) autocorrelations, and (lags,) numbers of pairs; each is about N(0, 1/pairs) when white.

    Examples
    --------
    >>> rho, pairs = masked_autocorrelation([np.array([1.0, -1.0, np.nan, -1.0, 1.0])], 1)
    >>> rho.tolist(), pairs.tolist()
    ([-1.0], [2.0])
    """
    power, count = 0.0, 0
    products, pairs = np.zeros(lags), np.zeros(lags)
    for y in series:
        there = np.isfinite(y)
        filled = np.where(there, y, 0.0)
        power, count = power + float(filled @ filled), count + int(there.sum())
        for k in range(1, min(lags, y.size - 1) + 1):
            products[k - 1] += filled[:-k] @ filled[k:]
            pairs[k - 1] += np.sum(there[:-k] & there[k:])
    scale = power / max(count, 1)
    return products / np.maximum(pairs, 1) / max(scale, 1e-300), pairs


def slow_excess(series: list[Array], period: float, block: float = SLOW_BLOCK) -> tuple[float, int]:
    """Mean square of block means times samples per block: 1 for white noise of unit variance.

    Blocks of which a tenth or more is missing are left out.

    Parameters
    ----------
    series : of (n,) each, in sigmas, NaN where missing. period : s. block : s.

    Returns
    -------
    The mean square (NaN without a block), and the number of blocks.

    Examples
    --------
    >>> value, blocks = slow_excess([np.random.default_rng(0).standard_normal(200_000)], 1e-3)
    >>> 0.85 < value < 1.15, blocks
    (True, 400)
    """
    size = max(round(block / period), 1)
    squares: list[Array] = []
    for y in series:
        count = y.size // size
        cut = y[: count * size].reshape(count, size)
        there = np.isfinite(cut).sum(axis=1)
        use = there > 0.9 * size
        squares.append(np.nansum(cut[use], axis=1) ** 2 / there[use])
    everything = np.concatenate(squares) if squares else np.empty(0)
    return (float(everything.mean()) if everything.size else np.nan), int(everything.size)


def _tested(name: str, i: int, found: list[Innovations], step: float) -> ChannelTest:
    series = [f.white[:, i] for f in found]
    period = found[0].period
    values = np.concatenate(series)
    values = values[np.isfinite(values)]
    n = int(values.size)
    if n < LEAST_SAMPLES:
        nothing = np.full(LAGS, np.nan)
        return ChannelTest(
            name, n, np.nan, np.nan, np.nan, np.nan, nothing, np.nan, np.nan, (np.nan, np.nan), True, ()
        )
    low, high = nis_band(1, n)
    rho, pairs = masked_autocorrelation(series)
    statistic = float(np.sum(rho**2 * pairs))
    p_value = float(gammaincc(0.5 * LAGS, 0.5 * statistic))
    nis = float(np.mean(values**2))
    slow, blocks = slow_excess(series, period)
    band = nis_band(1, max(blocks, 1))
    # Against the channel's own power: a noise that is set too large is another matter.
    sure_slow = _slow_bound(blocks)
    coloured = p_value < FALSE_ALARM and float(np.max(np.abs(rho))) > WORTH_NAMING
    drifting = blocks >= LEAST_BLOCKS and slow > sure_slow * max(nis, 1.0)
    causes: list[Cause] = []
    if nis >= SILENT:
        causes = causes_of(name, i, found, series, rho, step, nis)
        if drifting:
            times = f"{np.sqrt(slow):.1f} times as wide as they should"
            words = f"half-second means scatter {times}: slow flow errors"
            causes.append(Cause("slow flow", min(slow * period / SLOW_BLOCK / nis, 1.0), words))
    ripple = any(c.name in ("ripple", "tone") for c in causes)
    white = not (coloured or drifting or ripple) or nis < SILENT
    causes.sort(key=lambda c: -c.share)
    return ChannelTest(
        name, n, nis, low, high, float(np.mean(np.abs(values) < 1.96)), rho, p_value, slow, band, white,
        tuple(causes) if not white else (),
    )  # fmt: skip


def _slow_bound(blocks: int) -> float:
    """What the mean square of that many half-second means stays below, but for `FALSE_ALARM`."""
    k = 0.5 * max(blocks, 1)
    return float(gammaincinv(k, 1.0 - FALSE_ALARM) / k)
