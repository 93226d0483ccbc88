"""The empirical transfer function estimate against filters whose response is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp, freqz, iirpeak, lfilter

from fdd.identification.experiments.etfe import (
    empirical_response,
    etfe,
    periodic_etfe,
    repetition,
    smoothed_etfe,
    swept,
)
from fdd.identification.experiments.polynomial import Series
from fdd.identification.experiments.spectra import welch

T = 1.0 / 400.0
TOP, BOTTOM = iirpeak(40.0, 8.0, fs=1.0 / T)
"""A resonance that rings for 60 ms."""


def response(frequency: np.ndarray) -> np.ndarray:
    return freqz(TOP, BOTTOM, worN=frequency, fs=1.0 / T)[1]


def answered(given: np.ndarray, noise: float = 0.0, seed: int = 0) -> Series:
    caused = lfilter(TOP, BOTTOM, given) + noise * np.random.default_rng(seed).standard_normal(given.size)
    used = np.ones(given.size, dtype=bool)
    used[:100] = used[-100:] = False
    return Series(given, caused, used)


def multi_sine(periods: int, rows: int = 800) -> tuple[np.ndarray, np.ndarray]:
    """Odd lines up to 120 Hz at random phases; the input, and the lines' frequencies (Hz)."""
    lines, rng = np.arange(1, int(120.0 * rows * T), 6), np.random.default_rng(1)
    phase = 2.0 * np.pi * (np.outer(lines, np.arange(rows * periods)) / rows + rng.random((lines.size, 1)))
    return np.cos(phase).sum(axis=0), lines / (rows * T)


def rest_chirp(seconds: float = 18.0) -> np.ndarray:
    """One second of rest, 0.5 to 120 Hz, one second of rest."""
    time = np.arange(round(seconds / T)) * T
    still = np.zeros(round(1.0 / T))
    return np.concatenate([still, chirp(time, 0.5, seconds, 120.0, phi=-90.0), still])


def test_a_periodic_multi_sine_is_exact_at_its_lines():
    given, lines = multi_sine(6)
    assert repetition(given) == (800, slice(0, 4800))
    found = etfe([[answered(given)]], T, 2.0)
    assert (found.given, found.trusted) == ("periodic", True)
    assert found.spectra.frequency == pytest.approx(lines)
    assert found.spectra.response == pytest.approx(response(lines), abs=1e-9)
    by_welch = welch([answered(given)], T, 1.0)  # windows of half a period: lines leak to where none is
    assert np.abs(by_welch.response - response(by_welch.frequency)).max() > 0.02


def test_a_multi_sine_after_a_stroke_is_found_and_nothing_else_used():
    given, lines = multi_sine(5)
    stroke, rest = np.full(500, -20.0), np.full(300, 3.0)
    whole = np.concatenate([rest, stroke, 3.0 + given, rest])
    s = answered(whole - whole.mean())
    found = repetition(s.given)
    assert found is not None and found[0] == 800
    assert found[1].start == pytest.approx(800, abs=40) and found[1].stop == pytest.approx(4800, abs=40)
    estimate = etfe([[s]], T, 2.0)
    assert estimate.given == "periodic" and "for 10" in estimate.why
    assert estimate.spectra.frequency == pytest.approx(lines)
    assert estimate.spectra.response == pytest.approx(response(lines), abs=1e-3)


def test_the_periods_spread_holds_the_true_response():
    """95 % circles of 20 noises, 40 lines each: fewer than 92 % or more than 98 % are four deviations off."""
    given, lines = multi_sine(8)
    inside = 0
    for seed in range(20):
        found = periodic_etfe([answered(given, 0.5, seed)], T, 800)
        inside += np.count_nonzero(np.abs(found.response - response(lines)) < found.radius)
    assert 0.92 < inside / (20 * lines.size) < 0.98


def test_a_chirp_between_rests_is_nearer_than_by_welch():
    s = answered(rest_chirp())
    low, high = swept(s.given, T)
    assert low < 3.0 and high == pytest.approx(120.0, abs=4.0)
    found = etfe([[s]], T, 1.0)
    assert (found.given, found.trusted) == ("chirp", True) and "nothing leaks" in found.why
    width = 0.5
    errors = []
    for spectra in (smoothed_etfe([s], T, width), welch([s], T, 1.0)):
        inside = (spectra.frequency > 2.0) & (spectra.frequency < 115.0)
        errors.append(np.abs(spectra.response - response(spectra.frequency))[inside].max())
    assert errors[0] < 0.02 and errors[0] < 0.5 * errors[1]
    # Without smoothing what is left is rounding: the whole sweep is a period of its own.
    frequency, raw = empirical_response(s.given, s.caused, T, 0.0)
    inside = (frequency > 2.0) & (frequency < 115.0)
    assert np.abs(raw - response(frequency))[inside].max() < 1e-3


def test_noise_is_left_to_welch():
    rng = np.random.default_rng(5)
    found = etfe([[answered(rng.standard_normal(8000))]], T, 2.0)
    assert (found.given, found.trusted) == ("other", False) and "Welch" in found.why
    true = response(found.spectra.frequency)
    assert np.sqrt(np.mean(np.abs(found.spectra.response - true) ** 2)) < 0.1
