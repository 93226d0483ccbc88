"""Which signal is which channel: all of them together, with how sure each is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IMPOSSIBLE = -1e3
LEAST_SCORE = 1.5
"""nats; a signal of which less speaks for a channel is left without one."""


@dataclass(frozen=True)
class Choice:
    """A channel's signal, how sure that is (0 to 1), and the signal that comes next."""

    signal: str
    confidence: float
    other: str | None


def assign(scores: dict[str, dict[str, float]], channels: list[str]) -> dict[str, Choice]:
    """The assignment of the highest total score, each signal and channel at most once.

    How sure a choice is follows from how much the total falls where it is forbidden.

    Parameters
    ----------
    scores : signal to channel to nats; a channel that is not there is impossible.
    channels : to be filled.

    Examples
    --------
    >>> assign({"x": {"position": 4.0}, "y": {"position": 1.6}}, ["position"])["position"].signal
    'x'
    """
    signals = list(scores)
    table = np.full((len(signals), len(channels)), IMPOSSIBLE)
    for i, name in enumerate(signals):
        for j, channel in enumerate(channels):
            table[i, j] = scores[name].get(channel, IMPOSSIBLE)
    total, chosen = _best(table)
    out: dict[str, Choice] = {}
    for i, j in chosen:
        without = table.copy()
        without[i, j] = IMPOSSIBLE
        less, others = _best(without)
        other = next((signals[a] for a, b in others if b == j), None)
        confidence = float(1.0 / (1.0 + np.exp(-min(total - less, 50.0))))
        out[channels[j]] = Choice(signals[i], confidence, other)
    return out


def _best(table: NDArray[np.float64]) -> tuple[float, list[tuple[int, int]]]:
    from scipy.optimize import linear_sum_assignment

    rows, columns = table.shape
    # As many columns that mean "no channel" as there are signals, so that nothing is forced.
    wide = np.concatenate([table, np.full((rows, rows), LEAST_SCORE)], axis=1)
    i, j = linear_sum_assignment(wide, maximize=True)
    chosen = [(int(a), int(b)) for a, b in zip(i, j, strict=True) if b < columns]
    return float(wide[i, j].sum()), chosen
