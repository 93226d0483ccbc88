"""What innovations that are not white are made of: decided by spectra and correlations.

What could still be predicted in the innovations of an actuator has few causes, and each leaves a
mark of its own:

==============  =======================================================================
cause           mark
==============  =======================================================================
pump ripple     power at whole orders of the pump's turn (teeth times shaft speed)
tone            a narrow peak of the spectrum at a fixed frequency
delay           correlation with acceleration (position against angle) or with the
                pressure's own rate (pressure against motion)
quantisation    most samples read exactly as the one before
coloured noise  a sensor of limited bandwidth: little power near half the sample rate
caution         negative autocorrelation at a NIS of 1 or less: the process noise is larger
                than these logs need, and the filter follows the sensor's noise
slow flow       means over half a second scatter more than the filter's covariance says
==============  =======================================================================

The orders are those of computed order tracking (Fyfe and Munck 1997, doi 10.1006/mssp.1996.0056) without
its resampling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.signal import welch
from scipy.special import gammaincinv

from fdd.identify.innovations import Innovations

Array = NDArray[np.float64]

WORTH_NAMING = 0.05
"""Autocorrelation below which a departure from white noise, however sure, changes no estimate."""
FALSE_ALARM = 1e-3
"""Of each test; there are a handful per channel."""
ORDERS: Array = np.arange(5.0, 41.0)
"""Of the shaft: pumps have 7 to 20 teeth or pistons, and ripple a second harmonic; the lowest orders are
those of the motion itself."""
ORDER_BLOCK = 2.0
"""s, over which an order's phase is taken as constant."""
REPEATED = 0.5
"""Share of repeated readings: with white noise of more than half a step fewer are."""
SHARE = 0.02
"""Of a channel's innovation power that a cause must explain to be named."""


@dataclass(frozen=True)
class Cause:
    """One reason why innovations are not white: `name`, `share` of their power, a sentence."""

    name: str
    share: float
    sentence: str


def causes_of(
    name: str, i: int, found: list[Innovations], series: list[Array], rho: Array, step: float, nis: float
) -> list[Cause]:
    """Causes that are found in a channel's innovations.

    Parameters
    ----------
    name, i : channel and its column. found : innovations of some logs.
    series : of (n,) each, that column in sigmas, NaN where missing.
    rho : (lags,) its autocorrelation. step : smallest step of the channel, SI; 0 where unknown.
    nis : mean of its squares.

    Returns
    -------
    In no order; empty where nothing is found.
    """
    period = found[0].period
    rounded = _quantisation(i, found, step) if step > 0.0 else None
    causes = [_ripple(series, found), _tone(series, period), rounded]
    if name.startswith("pressure"):
        # Rounding that repeats itself has no power at high frequencies either.
        causes += [_delay(i, name, found), _band_limited(series, period) if rounded is None else None]
    early = float(np.mean(rho[:3]))
    if early < -0.5 * WORTH_NAMING and nis < 1.1:
        words = "each takes back some of the last: more process noise than these logs need"
        causes.append(Cause("caution", -early, words))
    return [c for c in causes if c is not None]


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


def _ripple(series: list[Array], found: list[Innovations]) -> Cause | None:
    share, ratio, blocks = order_shares(series, [f.states[:, 2] for f in found], found[0].period)
    if blocks < 3:
        return None
    sure = gammaincinv(blocks, 1.0 - FALSE_ALARM / len(ORDERS)) / blocks
    best = int(np.nanargmax(np.where(np.isnan(ratio), 0.0, share)))
    # Coloured noise raises all orders: a ripple's stands out of them.
    if not (ratio[best] > sure * max(float(np.nanmedian(ratio)), 1.0) and share[best] > SHARE):
        return None
    return Cause(
        "ripple", float(share[best]),
        f"pump ripple: {100 * share[best]:.0f} % of it at order {ORDERS[best]:.0f} (teeth times speed)",
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


def _quantisation(i: int, found: list[Innovations], step: float) -> Cause | None:
    """Most samples read as the one before: noise is smaller than the step, and rounding repeats itself."""
    repeats = float(np.mean([f.repeats[i] for f in found]))
    spread = np.concatenate([f.std[:, i][np.isfinite(f.white[:, i])] for f in found])
    share = min(step**2 / 12.0 / float(np.median(spread)) ** 2, 1.0)
    if repeats < REPEATED or share < 0.05:
        return None
    return Cause(
        "quantisation", share,
        f"quantisation: {100 * repeats:.0f} % of the samples read as the one before, and a step of "
        f"{step:.2g} makes {100 * share:.0f} % of what the filter expects",
    )  # fmt: skip
