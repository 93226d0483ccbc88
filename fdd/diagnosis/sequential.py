"""Sequential detection: Page's test on the log-likelihood ratio of fault against healthy.

``S ← max(0, S + ℓ)`` with ``ℓ`` a window's log-likelihood ratio; an alarm is raised when S reaches a
threshold ``h``. For independent windows Lorden (1971, doi 10.1214/aoms/1177693055) gives at most
one false alarm in ``exp(h)`` windows. Windows overlap and estimators remember, so here the rate of
excursions of S above ``h`` is taken from healthy logs that the classifier was not trained on: it
falls exponentially with ``h`` (peaks over a threshold, Pickands 1975, doi
10.1214/aos/1176343003, with the exponential tail that Page's test has), and the threshold is where
the fitted tail meets the wanted rate of false alarms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

CLIP_LOW, CLIP_HIGH = -2.0, 2.0
"""Bounds of one window's say: no single window raises an alarm, none wipes out a long record."""
LOWEST_THRESHOLD = 3.0 * CLIP_HIGH
"""At least three full windows' worth of evidence, however quiet the healthy logs were."""


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
        >>> round(AlarmTail(2.0, 1e-3, 1.5).threshold(1e-5), 2)
        8.91
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
        fewer; its scale is their mean excess (the maximum likelihood estimate), and not below
        a window's largest say divided by two.
        """
        ordered = sorted((float(p) for p in peaks), reverse=True)
        count = min(20, max(len(ordered) // 5, 1))
        if len(ordered) <= count:
            return cls(CLIP_HIGH, max(len(ordered), 1) / max(seconds, 1.0), CLIP_HIGH)
        height = ordered[count]
        excess = sum(p - height for p in ordered[:count]) / count
        return cls(height, count / seconds, max(excess, 0.5 * CLIP_HIGH))


def excursion_peaks(log_ratios: Iterable[float]) -> list[float]:
    """Largest S of each excursion from zero.

    Examples
    --------
    >>> excursion_peaks([1.0, 1.0, -2.0, -2.0, 0.5, -2.0])
    [2.0, 0.5]
    """
    peaks: list[float] = []
    s = peak = 0.0
    for ratio in log_ratios:
        s = max(0.0, s + min(max(ratio, CLIP_LOW), CLIP_HIGH))
        peak = max(peak, s)
        if s == 0.0 and peak > 0.0:
            peaks.append(peak)
            peak = 0.0
    return [*peaks, peak] if peak > 0.0 else peaks


@dataclass
class PageTest:
    """Page's test over windows.

    Attributes
    ----------
    threshold : alarm level of the statistic.
    statistic : S, never negative.
    since : end time (s) of the last window at which S was zero: where a change began at the latest.
    alarm_time : end time of the window that raised the alarm, NaN before.
    peak : largest S so far.
    """

    threshold: float
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
        self.statistic = max(0.0, self.statistic + min(max(log_ratio, CLIP_LOW), CLIP_HIGH))
        self.peak = max(self.peak, self.statistic)
        if not self.alarmed and self.statistic >= self.threshold:
            self.alarm_time = time
            return True
        return False
