"""When a fault that comes and goes acts: a hidden Markov chain over frames."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_START = 0.1
"""Prior probability that it acts in the first frame, as in the recipes; assumed. Else it begins in any."""
SWITCHES = 0.05
"""Probability that it goes, or comes back, from one frame to the next: ten seconds on average; assumed."""
MOST_ODDS = 50.0
"""Of the logarithm, beyond which a frame leaves no doubt."""


def coming_and_going(log_odds: Sequence[float]) -> tuple[Array, Array]:
    """Posterior probabilities (h,) that a fault has begun by each frame, and that it acts in it.

    The states are not yet, acting and away; forward and backward recursions, scaled, as in Rabiner 1989 (doi
    10.1109/5.18626).

    Parameters
    ----------
    log_odds : (h,), log likelihood ratio of each frame's rows, the fault acting against not.
    """
    odds = [math.exp(min(max(x, -MOST_ODDS), MOST_ODDS)) for x in log_odds]
    begins, stays = 1.0 / len(odds), 1.0 - SWITCHES
    yet, acting, away = 1.0 - AT_START, AT_START * odds[0], 0.0
    forward = [(yet, acting, away)]
    for ratio in odds[1:]:
        yet, acting, away = (
            yet * (1.0 - begins),
            (yet * begins + acting * stays + away * SWITCHES) * ratio,
            acting * SWITCHES + away * stays,
        )
        total = yet + acting + away
        yet, acting, away = yet / total, acting / total, away / total
        forward.append((yet, acting, away))
    backward = [(1.0, 1.0, 1.0)]
    for ratio in odds[:0:-1]:
        later = backward[-1]
        acts = later[1] * ratio
        yet, acting, away = (
            later[0] * (1.0 - begins) + acts * begins,
            acts * stays + later[2] * SWITCHES,
            acts * SWITCHES + later[2] * stays,
        )
        total = yet + acting + away
        backward.append((yet / total, acting / total, away / total))
    both = np.array(forward) * np.array(backward[::-1])
    both /= both.sum(axis=1, keepdims=True)
    return 1.0 - both[:, 0], both[:, 1]
