"""Sequential detection: Page's test with forgetting on the log-likelihood ratio of fault against healthy.

``S ← max(0, λ S + ℓ)`` with ``ℓ`` a window's log-likelihood ratio; an alarm is raised when S reaches a
threshold ``h``. Page's own test has λ = 1, which is right for independent windows. Here windows
overlap, and what makes a healthy log look odd (its load, its sensors' gains) lasts as long as the
log: repeating it proves nothing more. So evidence is forgotten over `MEMORY_S`, and S settles at
``ℓ / (1 − λ)``: what counts is how strong evidence is and that it lasts, not how long the log is.

The threshold follows from a wanted rate of false alarms. Rates are taken from healthy logs of units
that the classifier was not trained on: excursions of S above ``h`` become exponentially rarer with
``h`` (peaks over a threshold, Pickands 1975, doi 10.1214/aos/1176343003, with an exponential tail), and
the threshold is where the fitted tail meets the wanted rate.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

MEMORY_S = 5.0
"""s over which evidence is forgotten: a few windows, as long as a change takes to settle in them."""
CLIP_LOW, CLIP_HIGH = -4.0, 7.0
"""Bounds of one window's say: odds of a thousand to one against healthy, of fifty to one for it."""
LOWEST_THRESHOLD = 2.0 * CLIP_HIGH
"""More than any single window says, however quiet the healthy logs were."""


def forgetting(hop_s: float) -> float:
    """λ for windows every `hop_s` seconds.

    Examples
    --------
    >>> round(forgetting(0.5), 4)
    0.9048
    """
    return math.exp(-hop_s / MEMORY_S)


@dataclass(frozen=True)
class AlarmTail:
    """How often S exceeds a height on healthy logs: ``rate · exp(−(h − height) / scale)`` per second.

    Attributes
    ----------
    height : of the peaks that the tail was fitted over. rate : 1/s of excursions above it.
    scale : mean excess of the peaks over it.
    """

    height: float
    rate: float
    scale: float

    def threshold(self, false_alarms_per_second: float) -> float:
        """Height that healthy excursions exceed at the wanted rate (1/s).

        Examples
        --------
        >>> round(AlarmTail(2.0, 1e-3, 4.0).threshold(1e-5), 2)
        20.42
        """
        wanted = max(false_alarms_per_second, 1e-12)
        return max(self.height + self.scale * math.log(max(self.rate / wanted, 1.0)), LOWEST_THRESHOLD)

    @classmethod
    def fit(cls, peaks: Iterable[float], seconds: float) -> AlarmTail:
        """Fit to the highest points of the healthy excursions of S.

        Parameters
        ----------
        peaks : largest S of each excursion from zero. seconds : of healthy logs that they come from.

        The tail starts so that twenty peaks lie above it, or a fifth of them where there are
        fewer; its scale is their mean excess (the maximum likelihood estimate), and not below 1.
        """
        ordered = sorted((float(p) for p in peaks), reverse=True)
        count = min(20, max(len(ordered) // 5, 1))
        if len(ordered) <= count:
            return cls(LOWEST_THRESHOLD, max(len(ordered), 1) / max(seconds, 1.0), 1.0)
        height = ordered[count]
        excess = sum(p - height for p in ordered[:count]) / count
        return cls(height, count / seconds, max(excess, 1.0))


def excursion_peaks(log_ratios: Iterable[float], hop_s: float) -> list[float]:
    """Largest S of each excursion from zero, for windows every `hop_s` seconds.

    Examples
    --------
    >>> excursion_peaks([1.0, -2.0, -2.0, 0.5, -2.0], 0.5)
    [1.0, 0.5]
    """
    keep = forgetting(hop_s)
    peaks: list[float] = []
    s = peak = 0.0
    for ratio in log_ratios:
        s = max(0.0, keep * s + min(max(ratio, CLIP_LOW), CLIP_HIGH))
        peak = max(peak, s)
        if s == 0.0 and peak > 0.0:
            peaks.append(peak)
            peak = 0.0
    return [*peaks, peak] if peak > 0.0 else peaks


@dataclass
class PageTest:
    """Page's test with forgetting, over windows.

    Attributes
    ----------
    threshold : alarm level of the statistic. hop_s : s between windows.
    statistic : S, never negative.
    since : end time (s) of the last window at which S was zero: where a change began at the latest.
    alarm_time : end time of the window that raised the alarm, NaN before.
    peak : largest S so far.
    """

    threshold: float
    hop_s: float
    statistic: float = 0.0
    since: float = math.nan
    alarm_time: float = math.nan
    peak: float = 0.0

    @property
    def alarmed(self) -> bool:
        """Whether the alarm stands; it latches."""
        return not math.isnan(self.alarm_time)

    def step(self, log_ratio: float, time: float) -> bool:
        """Take one window; True when it raises the alarm."""
        if self.statistic <= 0.0 and not self.alarmed:
            self.since = time
        ratio = min(max(log_ratio, CLIP_LOW), CLIP_HIGH)
        self.statistic = max(0.0, forgetting(self.hop_s) * self.statistic + ratio)
        self.peak = max(self.peak, self.statistic)
        if not self.alarmed and self.statistic >= self.threshold:
            self.alarm_time = time
            return True
        return False
