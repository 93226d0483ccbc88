"""The test signals of chapter 6: chirps, binary noise and the sum of both that the thesis identifies with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evidence.thesis.runs import PERIOD

Array = NDArray[np.float64]


def chirp(seconds: float, low_hz: float, high_hz: float) -> Array:
    """A sine of amplitude 1 whose frequency rises evenly from `low_hz` to `high_hz`, (n,).

    Examples
    --------
    >>> chirp(1.0, 1.0, 1.0)[250].round(6)
    np.float64(1.0)
    """
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    return np.asarray(np.sin(2.0 * np.pi * (low_hz + 0.5 * (high_hz - low_hz) * time / seconds) * time))


def binary_noise(seconds: float, switching_hz: float, seed: int) -> Array:
    """Pseudo-random ±1 that may change `switching_hz` times a second, (n,)."""
    time = np.arange(round(seconds / PERIOD)) * PERIOD
    which = np.floor(time * switching_hz + 1e-9).astype(np.int64)
    bits = np.random.default_rng(seed).integers(0, 2, int(which[-1]) + 1) * 2.0 - 1.0
    return np.asarray(bits[which], dtype=np.float64)


def identification_volts(seconds: float, seed: int, high_hz: float = 150.0) -> Array:
    """Section 6.2's signal: a chirp of ±1.5 V from 0.1 to 150 Hz with binary noise of ±0.25 V at 450 Hz."""
    return 1.5 * chirp(seconds, 0.1, high_hz) + 0.25 * binary_noise(seconds, 450.0, seed)
