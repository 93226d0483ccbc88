"""A shaft whose angle begins again each turn: its counts, its direction, and the speeds that add up to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdd.logs.angles import directed, unwrap_counts
from fdd.logs.mapping.behaviour import Signals, correlation
from fdd.samples import Column

LEAST_TURNS = 5
A_JUMP = 0.6
"""Share of the range by which an angle falls back where it begins again."""
AGREE = 0.02
"""Falls and the steps around them give the counts of a turn; they agree so well where it is an angle."""
SNAP = 0.005
"""An encoder's own error of linearity, within which the counts of a turn are one of the usual figures."""
_DECADES = (1.0, 1.25, 2.0, 2.5, 3.6, 5.0)
MOST_STATES = 5
"""A valve has a few states; a signal of more values is none."""
FOLLOWS, MORE = 0.8, 0.3
"""Correlation of the directed angle with some position, and how much more that is than without direction."""


@dataclass(frozen=True)
class Shaft:
    """An angle that begins again each turn.

    Attributes
    ----------
    signal : its name. wrap : counts a turn. direction : the signal whose sign is the direction, or None.
    turned : (n,) counts, unwrapped and with that direction.
    """

    signal: str
    wrap: float
    direction: str | None
    turned: Column


def counts_a_turn(values: Column) -> float | None:
    """Counts after which a saw-tooth begins again; None where a signal is none.

    Between two falls an angle goes on as before, so each fall and the steps beside it give the counts of a
    turn. They agree with each other and with the signal's range, which those of a spike or a switch do not.

    Parameters
    ----------
    values : (n,) raw; NaN where missing.
    """
    there = values[np.isfinite(values)]
    spread = float(np.ptp(there)) if there.size else 0.0
    steps = np.diff(there)
    falls = np.flatnonzero(np.abs(steps) > A_JUMP * spread)
    falls = falls[(falls > 0) & (falls < steps.size - 1)]
    if spread == 0.0 or falls.size < LEAST_TURNS or falls.size > 0.2 * steps.size:
        return None
    turns = np.abs(steps[falls] - 0.5 * (steps[falls - 1] + steps[falls + 1]))
    turn = float(np.median(turns))
    moving = float(np.median(np.abs(steps[falls - 1])))
    if float(np.median(np.abs(turns - turn))) > AGREE * turn or abs(turn / spread - 1.0) > 0.1 or not moving:
        return None
    if np.all(there == np.round(there)):
        decade = 10.0 ** np.floor(np.log10(turn))
        usual = [2.0 ** round(np.log2(turn)), *(m * decade for m in _DECADES)]
    else:
        usual = [1.0, 2.0 * np.pi, 360.0]
    nearest = min(usual, key=lambda u: abs(np.log(u / turn)))
    return float(nearest) if abs(nearest / turn - 1.0) < SNAP else float(f"{turn:.4g}")


def find_shaft(data: Signals, angles: list[str], positions: list[str], valves: list[str]) -> Shaft | None:
    """The saw-tooth among signals that may be angles, with the direction without which nothing follows it.

    Parameters
    ----------
    angles, positions, valves : names of signals that may be such.
    """
    for name in angles:
        wrap = counts_a_turn(data.columns[name])
        if wrap is None:
            continue
        turned = unwrap_counts(data.columns[name], wrap)
        places = [data.changes(n) for n in positions if n != name]
        plain = _followed(data, turned, places)
        best: tuple[float, str | None, Column] = (max(plain + MORE, FOLLOWS), None, turned)
        for valve in valves:
            states = np.unique(data.columns[valve][np.isfinite(data.columns[valve])])
            if not (states.size <= MOST_STATES and states.min() < 0.0 < states.max()):
                continue
            way = directed(turned, data.columns[valve], accumulate=True)
            best = max(best, (_followed(data, way, places), valve, way), key=lambda row: row[0])
        return Shaft(name, wrap, best[1], best[2])
    return None


def _followed(data: Signals, turned: Column, places: list[Column]) -> float:
    """The largest correlation of a motion with the angle's."""
    way = Signals(data.time, {"turned": turned}).changes("turned")
    return max((abs(correlation(place, way)) for place in places), default=0.0)
