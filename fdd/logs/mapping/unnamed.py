"""Signals without name or unit, by physics alone: what a shaft moves, and which pressures its oil makes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from fdd.logs.angles import directed, unwrap_counts
from fdd.logs.mapping.behaviour import Signals, correlation, follows, leads, rises_with_pumping, slope_of
from fdd.samples import Column

if TYPE_CHECKING:
    from fdd.logs.mapping.evidence import Clues


SAME_SHAFT = 0.97
"""Correlation above which a signal's integral is the shaft's angle: a speed, or the demand for it."""
ALIKE = 0.8
"""Correlation of a demand with what follows it."""
CONTROL = 0.95
"""Share of a signal that the speeds explain, above which it is made of them: a loop's error or output."""
SAME_NUMBERS = 0.1
"""A demanded position whose slope over the measured one is so near to 1 is in the same numbers."""
COPY = 0.99
"""Share of equal values above which two signals are one."""
VACUUM = 0.1
"""No pressure is more than 1 bar below the atmosphere's, a tenth of what moves any cylinder under load."""
CLEAR_T = 2.0
SURE_NATS, LIKELY_NATS = 4.0, 3.0
RESTS = 0.6
"""Share of its scatter that a chamber's pressure keeps while the other's is high; above it none rests."""
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

    Examples
    --------
    >>> counts_a_turn(np.arange(0.0, 30_000.0, 37.0) % 4096.0), counts_a_turn(np.arange(0.0, 9.0, 0.01))
    (4096.0, None)
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


def without_copies(unnamed: list[str], data: Signals) -> tuple[list[str], list[str]]:
    """Signals that are no copy or mirror image, and those that are; of a mirrored pair the higher stays.

    Examples
    --------
    >>> t = np.arange(0.0, 10.0, 0.01)
    >>> without_copies(["a", "b", "c"], Signals(t, {"a": -t, "b": t, "c": t}))
    (['b'], ['a', 'c'])
    """
    kept: list[str] = []
    for name in sorted(unnamed, key=lambda n: (-float(np.nanmean(data.columns[n])), n)):
        if not any(_copied(data.columns[name], data.columns[other]) for other in kept):
            kept.append(name)
    return [n for n in unnamed if n in kept], [n for n in unnamed if n not in kept]


def _copied(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether a signal or its mirror image is the other one but for the last digit, read a little later."""
    steps = np.abs(np.diff(one))
    digit = float(np.min(steps[steps > 0.0], initial=np.inf))
    digit = digit if digit < 0.01 * float(np.ptp(one)) else 0.0  # a switch has no last digit
    return any(float(np.mean(np.abs(one - k * other) <= digit)) > COPY for k in (1.0, -1.0))


def around_shaft(found: Clues, shaft: Shaft) -> None:
    """A speed adds up to the shaft's angle, the position is what it moves, a demand comes before either."""
    data = found.data
    found.add(shaft.signal, "pump_angle", SURE_NATS, f"it begins again each {shaft.wrap:g} counts")
    others = [n for n in found.unnamed if n not in (shaft.signal, shaft.direction)]
    rates = sorted(
        (n for n in others if abs(follows(data, shaft.signal, n)) > SAME_SHAFT),
        key=lambda n: -abs(follows(data, shaft.signal, n)),
    )
    for k, name in enumerate(rates):
        r = abs(follows(data, shaft.signal, name))
        if k == 0:
            found.add(name, "pump_speed", SURE_NATS, f"it adds up to {shaft.signal} ({r:.4f})")
        elif leads(data, name, rates[0]) >= 0.0:
            found.add(name, "command", LIKELY_NATS, f"{rates[0]} comes after it")
    turned = data.changes(shaft.signal)
    both_ways = np.column_stack([np.maximum(turned, 0.0), np.minimum(turned, 0.0)])
    moved = {n: _explained(data.changes(n), both_ways) for n in others if n not in rates}
    place = found.named("position")
    if place is None and moved:
        place = max(moved, key=lambda n: moved[n])
        second = max((share for n, share in moved.items() if n != place), default=0.0)
        if moved[place] < 0.5 or 1.0 - moved[place] > 0.5 * (1.0 - second):
            return
        why = f"{shaft.signal} explains {100 * moved[place]:.0f} % of its motion"
        found.add(place, "position", SURE_NATS, why)
    alike = {n: correlation(data.means(n), data.means(place)) for n in moved if n != place} if place else {}
    demand = max(alike, key=lambda n: alike[n], default=None)
    if demand is None or place is None or alike[demand] < ALIKE or leads(data, demand, place) <= 0.0:
        return
    if abs(slope_of(data, demand, place)[0] - 1.0) < SAME_NUMBERS:
        found.add(demand, "position_setpoint", LIKELY_NATS, f"{place} comes after it ({alike[demand]:.2f})")


def _explained(wanted: np.ndarray, columns: np.ndarray) -> float:
    """Share of the sum of squares that a linear combination explains."""
    rest = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    return 1.0 - float(rest @ rest) / max(float(wanted @ wanted), 1e-300)


def chambers(found: Clues) -> None:
    """The chambers' pressures: oil that moves no piston fills them, and one rests while the other works.

    Check valves or a directional valve keep the side that is emptied near the accumulator's pressure. A
    motor's current, which grows with either, does not rest so.
    """
    data, rate = found.data, found.shaft is None
    pump = found.named("pump_speed") if found.shaft is None else found.shaft.signal
    x = found.named("position")
    if pump is None or x is None:
        return
    speed = data.sums(pump) if rate else data.changes(pump)
    # A pressure is filled by the motion that counts as positive, whichever way the pump counts.
    way = 1.0 if correlation(data.changes(x), speed) > 0.0 else -1.0
    told = [n for n in found.unnamed if max(found.scores[n].values(), default=1.0) > 0.0]
    motion = [np.ones_like(speed), speed, np.abs(speed)]
    motion += [data.means(n) for n in told if abs(correlation(data.means(n), speed)) > ALIKE]
    columns = np.column_stack(motion)
    may = []
    pressures = set(found.pressures())
    for name in sorted({*found.unnamed, *pressures} - set(told)):
        if name in pressures and (found.sides_known or found.named_as(name, "pressure")):
            continue
        mean = data.means(name)
        if not mean.size or float(np.percentile(mean, 1.0)) < -VACUUM * float(np.percentile(mean, 99.0)):
            continue
        if float(np.ptp(mean)) > 0.0 and _explained(mean - mean.mean(), columns) < CONTROL:
            may.append(name)
    middles = {n: data.columns[n] - float(np.nanmedian(data.columns[n])) for n in may}
    t = {n: way * rises_with_pumping(data, v, x, pump, rate=rate) for n, v in middles.items()}
    for side, sense, word in (("pressure_1", 1.0, "raises"), ("pressure_2", -1.0, "lowers")):
        best = max((sense * t[n] for n in may), default=0.0)
        for name in may:
            if sense * t[name] > 0.0:  # what explains less than half of what the best does is none beside it
                nats = min(0.5 * t[name] ** 2, SURE_NATS) * min(2.0 * (t[name] / best) ** 2, 1.0)
                found.add(name, side, nats, f"pumping {word} it (t = {abs(t[name]):.0f})")
    clear = [n for n in may if abs(t[n]) > CLEAR_T]
    pairs = [(_rest(data, a, b), a, b) for a, b in combinations(clear, 2) if t[a] * t[b] < 0.0]
    if pairs and min(pairs)[0] < RESTS:
        share, *both = min(pairs)
        one, two = sorted(both, key=lambda n: -t[n])
        nats = -2.0 * float(np.log(share / RESTS))
        found.add(one, "pressure_1", nats, f"it rests while {two} is high")
        found.add(two, "pressure_2", nats, f"it rests while {one} is high")


def _rest(data: Signals, a: str, b: str) -> float:
    """The share of its scatter that one keeps while the other is high, the larger of both ways round."""
    shares = []
    for one, other in ((a, b), (b, a)):
        mine, its = data.means(one), data.means(other)
        low, high = np.percentile(its, [5.0, 95.0])
        working = its > 0.5 * (low + high)
        shares.append(float(np.std(mine[working]) / np.std(mine)) if working.any() else 1.0)
    return max(max(shares), 1e-3)
