"""Is what a filter did not expect white? And if not, what is it: decided by spectra and correlations.

White innovations carry nothing that could still be predicted. What remains in those of an actuator
has few causes, and each leaves a mark of its own:

==============  =======================================================================
cause           mark
==============  =======================================================================
pump ripple     power at whole orders of the pump's turn (teeth times shaft speed)
tone            a narrow peak of the spectrum at a fixed frequency
delay           correlation with acceleration (position against angle) or with the
                pressure's own rate (pressure against motion)
quantisation    the sign of the innovation follows the last one while the motion is less
                than a step a sample, and does not while it is more
coloured noise  a sensor of limited bandwidth: little power near half the sample rate
caution         negative autocorrelation at a NIS of 1 or less: the process noise is larger
                than these logs need, and the filter follows the sensor's noise
slow flow       means over half a second scatter more than the filter's covariance says
==============  =======================================================================

Sources: Ljung and Box 1978, doi 10.1093/biomet/65.2.297, for whiteness; the orders are those of
computed order tracking (Fyfe and Munck 1997, doi 10.1006/mssp.1996.0056) without its resampling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import welch
from scipy.special import gammaincc, gammaincinv

from estimators.consistency import nis_band
from fdd.identify.innovations import Innovations

Array = NDArray[np.float64]

LAGS = 20
SILENT = 0.05
"""Mean NIS below which a channel's innovations are covered by process noise and test nothing."""
WORTH_NAMING = 0.05
"""Autocorrelation below which a departure from white noise, however sure, changes no estimate."""
FALSE_ALARM = 1e-3
"""Of each test; there are a handful per channel."""
LEAST_SAMPLES = 500
ORDERS = np.arange(1, 41)
"""Of the shaft: pumps have 7 to 20 teeth or pistons, and ripple a second harmonic."""
ORDER_BLOCK = 2.0
"""s, over which an order's phase is taken as constant."""
SHARE = 0.02
"""Of a channel's innovation power that a cause must explain to be named."""
SLOW_BLOCK = 0.5
"""s: leakage is learned from what lasts longer than this."""
LEAST_BLOCKS = 12


@dataclass(frozen=True)
class Cause:
    """One reason why innovations are not white: `name`, `share` of their power, a sentence."""

    name: str
    share: float
    sentence: str


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
            return "says nothing: the motion's process noise covers it, by choice"
        if self.white:
            return "white"
        return "; ".join(c.sentence for c in self.causes) or "not white, no cause found"


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


def order_shares(
    series: list[Array], angles: list[Array], period: float, orders: Array = ORDERS
) -> tuple[Array, Array, int]:
    """Share of the power at orders of the shaft, by correlation with its angle.

    Over blocks of 2 s, so that amplitude and phase may change from one to the next. Samples
    in which an order would turn faster than 0.45 times the sample rate, or the shaft stands, are left out.

    Parameters
    ----------
    series : of (n,) each, NaN where missing. angles : of (n,) each, rad. period : s.
    orders : waves per turn.

    Returns
    -------
    (orders,) shares of the power; (orders,) mean ratios to white noise's expectation, Gamma(blocks)
    over blocks when white; the number of blocks.
    """
    size = round(ORDER_BLOCK / period)
    share, ratio, weight = np.zeros(len(orders)), np.zeros(len(orders)), 0
    counts = np.zeros(len(orders))
    for y, angle in zip(series, angles, strict=True):
        speed = np.abs(np.gradient(uniform_filter1d(angle, 21, mode="nearest")))  # rad a sample
        for start in range(0, y.size - size + 1, size):
            rows = slice(start, start + size)
            e, th, w = y[rows], angle[rows], speed[rows]
            for j, order in enumerate(orders):
                use = np.isfinite(e) & (w > 5.0 * period) & (order * w < 0.9 * np.pi)
                n = int(use.sum())
                if n < 200:
                    continue
                line = abs(np.sum(e[use] * np.exp(-1j * order * th[use]))) ** 2
                power = float(e[use] @ e[use])
                ratio[j] += line / power
                share[j] += 2.0 * (line / power - 1.0) / n
                counts[j] += 1
            weight += 1
    there = np.maximum(counts, 1)
    return share / there, np.where(counts > 0, ratio / there, np.nan), int(counts.max(initial=0))


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
        causes = _causes(name, i, found, series, rho, step, nis)
        if drifting:
            causes.append(
                Cause(
                    "slow flow", min(slow * period / SLOW_BLOCK / max(nis, 1e-12), 1.0),
                    f"half-second means scatter {np.sqrt(slow):.1f} times as wide as they should: slow flow errors",
                )  # fmt: skip
            )
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


def _causes(
    name: str, i: int, found: list[Innovations], series: list[Array], rho: Array, step: float, nis: float
) -> list[Cause]:
    period = found[0].period
    causes = [_ripple(series, found), _tone(series, period)]
    if name.startswith("pressure"):
        causes += [_delay(i, name, found), _band_limited(series, period)]
    if step > 0.0:
        causes.append(_quantisation(name, i, found, step))
    early = float(np.mean(rho[:3]))
    if early < -0.5 * WORTH_NAMING and nis < 1.1:
        causes.append(
            Cause(
                "cautious", -early,
                "each takes back some of the last: more process noise than these logs need",
            )  # fmt: skip
        )
    return [c for c in causes if c is not None]


def _ripple(series: list[Array], found: list[Innovations]) -> Cause | None:
    share, ratio, blocks = order_shares(series, [f.states[:, 2] for f in found], found[0].period)
    if blocks < 3:
        return None
    sure = gammaincinv(blocks, 1.0 - FALSE_ALARM / len(ORDERS)) / blocks
    best = int(np.nanargmax(np.where(np.isnan(ratio), 0.0, share)))
    if not (ratio[best] > sure and share[best] > SHARE):
        return None
    return Cause(
        "ripple", float(share[best]),
        f"pump ripple: {100 * share[best]:.0f} % of it at order {ORDERS[best]} of the shaft (teeth times speed)",
    )  # fmt: skip


def _tone(series: list[Array], period: float) -> Cause | None:
    """A peak that stands ten times above its neighbourhood."""
    frequency, density = _spectrum(series, period)
    if frequency.size < 50:
        return None
    floor = median_filter(density, 31, mode="nearest")
    over = density / np.maximum(floor, 1e-300)
    over[:8] = 0.0  # slow errors have a slope of their own there
    peak = int(np.argmax(over))
    around = slice(max(peak - 2, 0), peak + 3)
    share = float(np.sum((density - floor)[around]) / np.sum(density))
    if over[peak] < 10.0 or share < SHARE:
        return None
    return Cause("tone", share, f"a tone at {frequency[peak]:.0f} Hz: {100 * share:.0f} % of it")


def _band_limited(series: list[Array], period: float) -> Cause | None:
    frequency, density = _spectrum(series, period)
    rate = 1.0 / period
    middle = density[(frequency > 0.02 * rate) & (frequency < 0.1 * rate)]
    upper = density[(frequency > 0.32 * rate) & (frequency < 0.48 * rate)]
    if not middle.size or not upper.size:
        return None
    ratio = float(np.median(upper) / max(np.median(middle), 1e-300))
    if ratio > 0.5:
        return None
    return Cause(
        "coloured noise", 1.0 - ratio,
        f"coloured: above {0.32 * rate:.0f} Hz {100 * ratio:.0f} % of the density at "
        f"{0.02 * rate:.0f} to {0.1 * rate:.0f} Hz, a sensor of limited bandwidth",
    )  # fmt: skip


def _spectrum(series: list[Array], period: float) -> tuple[Array, Array]:
    """Mean density over 1 s segments of which at least nine tenths are there; gaps are zeros."""
    size = round(1.0 / period)
    segments = []
    for y in series:
        count = y.size // size
        cut = y[: count * size].reshape(count, size)
        segments.append(np.nan_to_num(cut[np.isfinite(cut).mean(axis=1) > 0.9]))
    everything = np.concatenate(segments) if segments else np.empty((0, size))
    if everything.shape[0] < 3:
        return np.empty(0), np.empty(0)
    frequency, density = welch(everything, 1.0 / period, nperseg=size, axis=1)
    return frequency, density.mean(axis=0)


def _delay(i: int, name: str, found: list[Innovations]) -> Cause | None:
    """Innovations that follow the piston's acceleration, or the pressure's own rate."""
    gathered: dict[str, list[Array]] = {"y": [], "acceleration": [], "rate": []}
    for f in found:
        width = max(round(7e-3 / f.period), 1) | 1

        def slope(values: Array, width: int = width, period: float = f.period) -> Array:
            return np.gradient(uniform_filter1d(values, width, mode="nearest"), period)

        pressure = f.states[:, 4] - f.states[:, 5] if name == "pressure_difference" else (
            f.states[:, 4 if name == "pressure_1" else 5]
        )  # fmt: skip
        there = np.isfinite(f.white[:, i])
        gathered["y"].append(f.white[there, i])
        gathered["acceleration"].append(slope(f.states[:, 1])[there])
        gathered["rate"].append(slope(slope(pressure))[there])
    y = np.concatenate(gathered["y"])
    best, strength = "", 0.0
    for regressor in ("acceleration", "rate"):
        x = np.concatenate(gathered[regressor])
        correlation = float(np.corrcoef(x, y)[0, 1]) if np.ptp(x) > 0.0 else 0.0
        if abs(correlation) > abs(strength):
            best, strength = regressor, correlation
    if strength**2 < SHARE:
        return None
    meaning = {
        "acceleration": "acceleration: position and angle are not of the same moment",
        "rate": "the pressure's change of rate: the pressure comes late against the motion",
    }[best]
    return Cause("delay", strength**2, f"delay: correlation {strength:+.2f} with {meaning}")


def _quantisation(name: str, i: int, found: list[Innovations], step: float) -> Cause | None:
    """Rounding repeats itself while less than a step a sample is moved, and is white while more is."""
    state = {"position": 0, "pump_angle": 2, "pressure_1": 4, "pressure_2": 5}.get(name)
    if state is None:
        return None
    slow: list[Array] = []
    fast: list[Array] = []
    spread: list[Array] = []
    for f in found:
        moved = np.abs(np.gradient(uniform_filter1d(f.states[:, state], 5, mode="nearest")))
        y = f.white[:, i]
        slow.append(np.where(moved < 0.3 * step, y, np.nan))
        fast.append(np.where(moved > step, y, np.nan))
        spread.append(f.std[:, i][np.isfinite(y)])
    (rho_slow,), (pairs,) = masked_autocorrelation(slow, 1)
    (rho_fast,), _ = masked_autocorrelation(fast, 1)
    noise = float(np.median(np.concatenate(spread)))
    share = min(step**2 / 12.0 / max(noise**2, 1e-300), 1.0)
    gap = abs(rho_slow) - abs(rho_fast)
    if pairs < LEAST_SAMPLES or gap < max(0.1, 5.0 / np.sqrt(pairs)) or share < 0.05:
        return None
    return Cause(
        "quantisation", share,
        f"quantisation: a step of {step:.2g} makes {100 * share:.0f} % of it; autocorrelation {rho_slow:+.2f} "
        f"where the motion is slow, {rho_fast:+.2f} where it is not",
    )  # fmt: skip
