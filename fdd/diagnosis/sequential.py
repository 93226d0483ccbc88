"""Sequential detection: Page's test on the log-likelihood ratio of fault against healthy.

``S ← max(0, S + ℓ)`` with ``ℓ`` the window's log-likelihood ratio; an alarm is raised when S
reaches ``h``. Lorden (1971, doi 10.1214/aoms/1177693055) bounds the mean number of independent
windows between false alarms from below by ``exp(h)``, so the threshold follows from a wanted
rate of false alarms alone: ``h = ln(1 / (rate · seconds per independent window))``.

Windows overlap and the estimators remember, so neighbouring ratios are not independent. They
are discounted by the share of independent windows, which training measures on healthy logs
(see `fdd.diagnosis.training`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

CLIP_LOW, CLIP_HIGH = -1.5, 2.5
"""Bounds of one window's say: no single window raises an alarm, none wipes out a long record."""


def alarm_threshold(false_alarms_per_second: float, independent_period_s: float) -> float:
    """Threshold of Page's test for a wanted rate of false alarms.

    Parameters
    ----------
    false_alarms_per_second : wanted rate, 1/s. independent_period_s : s per independent window.

    Examples
    --------
    >>> round(alarm_threshold(0.1 / 3600.0, 1.0), 2)
    10.49
    """
    return max(math.log(1.0 / (false_alarms_per_second * independent_period_s)), 1.0)


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
