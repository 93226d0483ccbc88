"""The compiler of this package; a seal's friction, first-order lags, windowed means, suffix sums."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimators.compiled import compiler

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]

njit = compiler(Path(__file__).parent)
"""What it compiles is kept on disk, and made anew when a source beside it changes."""
LUBRICATION_LAG_S = 0.03
"""s, lag of the lubricating film, and with it of the falling part of friction, behind the sliding speed: 5 to
60 ms by Hess and Soom 1990 (doi 10.1115/1.2920240) and Armstrong-Helouvry et al. 1994 (doi
10.1016/0005-1098(94)90209-7)."""


@njit()
def friction(
    step: Array, dt: Array, state: Array, forward: Array, reverse: Array, stiffness: float,
    out: Array, film: Array,
) -> None:  # fmt: skip
    """Prandtl's stop operator whose yield is Stribeck's curve (thesis eq. 5.12): a healthy seal's friction.

    Parameters
    ----------
    step : (n,) m of the piston. dt : (n,) s.
    state : (2,) N and m/s, the seal's force and its film's speed; kept for the next call.
    forward, reverse : (4,) Coulomb, static, Stribeck's speed and exponent.
    out : (n,) N, against extension. film : (n,) m/s, of sliding.
    """
    for k in range(step.size):
        tried = state[0] + stiffness * step[k]
        branch = forward if tried >= 0.0 else reverse
        most = branch[0] + (branch[1] - branch[0]) * np.exp(-((abs(state[1]) / branch[2]) ** branch[3]))
        state[0] = min(most, max(-most, tried))
        slid = (tried - state[0]) / stiffness
        state[1] += (slid - state[1] * dt[k]) / (LUBRICATION_LAG_S + dt[k])
        out[k], film[k] = state[0], state[1]


@njit()
def follow(values: Array, state: Array, decay: Array, out: Array) -> None:
    """First-order lags behind a signal, (n, lags); a missing value leaves them as they are. `decay` (lags,)
    is the share that a bin closes; `state` (lags,), NaN before the first, is kept for the next call."""
    for k in range(values.size):
        if np.isfinite(values[k]):
            for i in range(state.size):
                state[i] = values[k] if np.isnan(state[i]) else state[i] + decay[i] * (values[k] - state[i])
        out[k] = state


@njit()
def windowed_means(
    time: Array, values: Array, bin_of: Indices, grid: tuple[int, float, int],
    out: Array,
) -> None:  # fmt: skip
    """Means under Hann windows of two bins about the middle of each; NaN at the ends of frames.

    From 100 Hz on they pass a tenth or less of what a bin's mean passes and the bins' rate folds onto slower
    lines, as a gear pump's ten teeth onto twice a turn at 16.7 turns a second.

    Parameters
    ----------
    time, values, bin_of : (n,) s, samples, and their bins. grid : bin that `out` begins with, s of a
        bin, and bins of a frame.
    """
    first, bin_s, frame_bins = grid
    weights = np.zeros(out.size)
    out[:] = 0.0
    for i in range(values.size):
        if np.isfinite(values[i]):
            for k in range(max(bin_of[i] - 1, 0), min(bin_of[i] + 2, out.size)):
                off = time[i] / bin_s - (first + k + 0.5)
                if abs(off) < 1.0:
                    w = 1.0 + np.cos(np.pi * off)
                    out[k] += w * values[i]
                    weights[k] += w
    for k in range(out.size):
        inside = 0 < k % frame_bins < frame_bins - 1 and weights[k] > 0.0
        out[k] = out[k] / weights[k] if inside else np.nan


@njit()
def sum_from_here(x: Array) -> None:
    """Replace rows (h, m) by the sum of each and all later ones, in a fraction of `np.cumsum`'s time."""
    for k in range(len(x) - 2, -1, -1):
        for i in range(x.shape[1]):
            x[k, i] += x[k + 1, i]
