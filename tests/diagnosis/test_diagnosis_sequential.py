"""Page's test against Lorden's bound and the textbook delay (no forgetting), and what forgetting does."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.sequential import (
    CLIP_HIGH,
    LOWEST_THRESHOLD,
    AlarmTail,
    PageTest,
    excursion_peaks,
    forgetting,
)


def run_length(rng: np.random.Generator, shift: float, threshold: float, mean: float) -> int:
    """Windows to the alarm; ratios of N(shift, 1) against N(0, 1) for observations of `mean`."""
    test = PageTest(threshold, hop_s=0.0)  # a hop of no time forgets nothing: Page's own test
    k = 0
    while True:
        k += 1
        x = rng.normal(mean)
        if test.step(shift * x - 0.5 * shift**2, float(k)):
            return k


def test_false_alarms_are_rarer_than_wanted() -> None:
    # Lorden: the mean run length without a fault is at least exp(h). 200 runs: the mean's standard
    # error is about 7 %, so a fall below 0.75 exp(h) by chance has a probability below 1e-3.
    rng = np.random.default_rng(5)
    threshold = 4.0
    lengths = [run_length(rng, 1.0, threshold, 0.0) for _ in range(200)]
    assert np.mean(lengths) > 0.75 * np.exp(threshold)


def test_delay_is_threshold_over_information() -> None:
    # Mean drift of the ratio under the fault is shift²/2 per window; the overshoot adds about one step.
    rng = np.random.default_rng(6)
    lengths = [run_length(rng, 1.0, 6.0, 1.0) for _ in range(300)]
    assert 6.0 / 0.5 * 0.8 < np.mean(lengths) < 6.0 / 0.5 * 1.5


def test_threshold_meets_the_wanted_rate() -> None:
    # Healthy ratios of N(-1, 3²), forgetting at half-second hops. A tail fitted to 40,000 windows must put
    # the threshold where 800,000 other windows exceed it at the wanted rate: 200 expected excursions have
    # a standard error of 7 %, and the fit's own error is larger, so within a factor of two.
    rng = np.random.default_rng(8)
    wanted = 200
    tail = AlarmTail.fit(excursion_peaks(rng.normal(-1.0, 3.0, 40_000), 0.5), 40_000.0)
    h = tail.threshold(wanted / 800_000.0)
    assert h > LOWEST_THRESHOLD
    alarms = sum(peak >= h for peak in excursion_peaks(rng.normal(-1.0, 3.0, 800_000), 0.5))
    assert 0.5 * wanted < alarms < 2.0 * wanted


def test_rarer_alarms_want_more_evidence() -> None:
    tail = AlarmTail(10.0, 1e-2, 5.0)
    rates = [1e-3, 1e-4, 1e-5, 1e-6]
    heights = [tail.threshold(r) for r in rates]
    assert heights == sorted(heights)
    assert heights[-1] - heights[-2] == pytest.approx(5.0 * np.log(10.0))


def test_no_single_window_raises_an_alarm() -> None:
    test = PageTest(LOWEST_THRESHOLD, hop_s=0.5)
    assert not test.step(1e9, 1.0)
    assert test.since == 1.0
    assert test.statistic == CLIP_HIGH
    assert not test.step(1e9, 1.5)
    assert test.step(1e9, 2.0)


def test_repeating_weak_evidence_proves_nothing() -> None:
    # A steady ratio settles at ratio / (1 - λ), however long the log.
    test = PageTest(20.0, hop_s=0.5)
    for k in range(10_000):
        test.step(1.0, 0.5 * k)
    assert not test.alarmed
    assert test.statistic == pytest.approx(1.0 / (1.0 - forgetting(0.5)))


def test_alarm_latches_and_keeps_its_time() -> None:
    test = PageTest(6.0, hop_s=0.5)
    for k in range(5):
        test.step(4.0, float(k))
    assert test.alarmed and test.alarm_time == 1.0
    for k in range(5, 50):
        test.step(-1.0, float(k))
    assert test.alarmed and test.alarm_time == 1.0 and test.statistic == 0.0
