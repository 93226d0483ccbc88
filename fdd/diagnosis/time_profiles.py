"""Time profiles of faults, a step, a ramp or a drift, and sums over them for every onset."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KINDS = ("step", "ramp", "drift")
RAMP_FRAMES = 24
"""Frames over which a ramp grows to its full size: 12 s."""
DRIFT_FRAMES = 100
"""Frames in which a drift grows by one: 50 s."""


def time_profile_of(kind: str, frames: int, onset: int) -> Array:
    """Time profile φ (frames,) of a step, ramp or drift that begins with a frame."""
    since = np.arange(frames) - onset
    if kind == "ramp":
        return np.clip((since + 0.5) / RAMP_FRAMES, 0.0, 1.0)
    if kind == "drift":
        return np.maximum((since + 0.5) / DRIFT_FRAMES, 0.0)
    return (since >= 0).astype(np.float64)


class SuffixSums:
    """Sums over frames of (h, …) times a time profile or its square, one for each onset of the profile,
    (k, …).

    They come from repeated suffix sums, so that every onset costs the same.
    """

    def __init__(self, x: Array) -> None:
        self.one = _from_here(x)
        self.two = _from_here(self.one)

    def over(self, kind: str, onsets: Indices) -> Array:
        """Σ φ x."""
        if kind == "step":
            return self.one[onsets]
        grown = self.two - 0.5 * self.one
        if kind == "drift":
            return grown[onsets] / DRIFT_FRAMES
        return (grown[onsets] - _later(grown, onsets)) / RAMP_FRAMES

    def squared(self, kind: str, onsets: Indices) -> Array:
        """Σ φ² x."""
        if kind == "step":
            return self.one[onsets]
        grown = self.two - 0.5 * self.one
        square = 2.0 * (_from_here(self.two) - self.two) + 0.25 * self.one
        if kind == "drift":
            return square[onsets] / DRIFT_FRAMES**2
        # Past its end a ramp has grown by its whole length l: (k + l)² - l² = k² + 2 l k is too much.
        past = _later(square + 2.0 * RAMP_FRAMES * grown, onsets)
        return (square[onsets] - past) / RAMP_FRAMES**2


def _from_here(x: Array) -> Array:
    """Sums of (h, …) from each frame to the last."""
    return np.asarray(np.cumsum(x[::-1], axis=0)[::-1])


def _later(x: Array, onsets: Indices) -> Array:
    """Values a ramp's length after onsets; none after the last frame."""
    at = onsets + RAMP_FRAMES
    out = np.zeros((at.size, *x.shape[1:]))
    inside = at < len(x)
    out[inside] = x[at[inside]]
    return out
