"""Scores of signals for channels by names, units and what signals do."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product, takewhile

import numpy as np

from fdd.bounds import MOST_ROWS_LOOKED_AT
from fdd.errors import InputError
from fdd.logs.formats.signals import LogFile, Signal
from fdd.logs.mapping.behaviour import (
    Signals,
    correlation,
    difference,
    follows,
    leads,
    rises_with_pumping,
    roughness,
)
from fdd.logs.mapping.concepts import Words, dimension_of, name_scores, said_and_unit
from fdd.logs.mapping.shaft import Shaft, find_shaft
from fdd.logs.names import is_time_name, path_parts, time_unit
from fdd.logs.rates import aligned
from fdd.measures import MEASURES
from fdd.samples import CHANNELS

LARGEST = 1e100
"""No signal has such a value; its square would be infinite."""
GIVEN_NATS = 50.0
LEAST_ALIKE = 4
"""Signals whose common beginning is that of their rig; fewer may all be pressures."""
PRESSURES = ("pressure_1", "pressure_2", "pressure_difference", "pressure_accumulator")
CLOSE = 0.9
"""Correlation above which one signal's motion is another's."""
SAME_SHAFT = 0.97
"""Correlation above which a signal's integral is the shaft's angle: a speed, or the demand for it."""
SURE_NATS, LIKELY_NATS = 4.0, 3.0
CLEAR_T = 2.0
RESTS = 0.6
"""Share of its scatter that a chamber's pressure keeps while the other's is high; above it none rests."""


@dataclass
class Clues:
    """What is known of a log's signals.

    Attributes
    ----------
    signals : by name, without those of clocks.
    data : on one time base.
    scores : signal to channel to nats.
    reasons : (signal, channel) to what spoke for it.
    units : signal to the unit that the file or its name gives.
    time : the column of the time and its unit, where the file does not tell by itself.
    words : that names were read by. said : signal to the concepts of its name.
    unnamed : signals of which neither name nor unit says anything, the user's among them.
    shaft : the pump's, where an angle begins again each turn; its column in `data` is unwrapped and directed.
    """

    signals: dict[str, Signal]
    data: Signals
    scores: dict[str, dict[str, float]]
    units: dict[str, str | None]
    words: Words
    said: dict[str, set[str]]
    reasons: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    time: tuple[str, str] | None = None
    unnamed: list[str] = field(default_factory=list)
    shaft: Shaft | None = None

    def add(self, signal: str, channel: str, nats: float, reason: str) -> None:
        """Take up evidence, where the unit allows the channel at all."""
        if channel in self.scores[signal]:
            self.scores[signal][channel] += nats
            self.reasons.setdefault((signal, channel), []).append(reason)

    def allowing(self, *channels: str) -> list[str]:
        """Signals that move and may be one of these channels."""
        return [
            n
            for n, scores in self.scores.items()
            if any(scores.get(c, -9.0) >= 0.0 for c in channels) and np.ptp(self.data.columns[n]) > 0.0
        ]

    def named_as(self, signal: str, concept: str) -> bool:
        """Whether a signal's name says a thing, whatever its unit."""
        return any(s >= 2.0 for c, s in self.scores[signal].items() if c.startswith(concept))

    def pressures(self) -> list[str]:
        """Signals that move and are pressures by their unit, or else by their name."""
        may = self.allowing(*PRESSURES)
        sure = [n for n in may if dimension_of(self.units[n]) == "pressure"]
        return sure or [n for n in may if "pressure" in self.said[n]]

    @property
    def sides_known(self) -> bool:
        """Whether a name tells a chamber's pressure, or their difference."""
        return any(self.named(channel) is not None for channel in PRESSURES[:3])

    def named(self, channel: str) -> str | None:
        """The signal of which most speaks for a channel, where anything does."""
        best = max(self.scores, key=lambda n: self.scores[n].get(channel, -9.0), default=None)
        return best if best is not None and self.scores[best].get(channel, -9.0) >= 2.0 else None


def gather(log: LogFile, words: Words, given: dict[str, str]) -> Clues:
    """Read a log's signals and score them.

    Parameters
    ----------
    log : opened. words : to read names by. given : channel to signal, as the user knows it; "" for none.

    Raises
    ------
    InputError : nothing in the log can be its time.
    """
    raw = log.read(log.signals)
    main = max(log.signals.values(), key=lambda s: raw[s.name].size).clock
    stamps = {clock: log.stamps(clock) for clock in dict.fromkeys(s.clock for s in log.signals.values())}
    time, at = None, stamps[main]
    if at is None:
        time = _time_column(log, raw, main)
        at = raw[time[0]] * MEASURES[time[1]].factor
    clocks = {log.clock_column(clock) for clock in stamps} | {time[0] if time else None}
    good = np.flatnonzero(np.isfinite(at) & (np.diff(at, prepend=-np.inf) > 0.0))[:MOST_ROWS_LOOKED_AT]
    columns = {}
    for name, signal in log.signals.items():
        if name in clocks or (is_time_name(name) and _grows(raw[name])):  # T may be a temperature
            continue
        own = stamps[signal.clock]
        if signal.clock != main and own is None:
            continue
        values = raw[name] if signal.clock == main or own is None else aligned(at, own, raw[name])
        values = np.where(np.abs(values[good]) < LARGEST, values[good], np.nan)
        if np.isfinite(values).any():
            columns[name] = values
    known = {n: log.signals[n] for n in columns}
    plain = _without_prefix(known)
    data = Signals(at[good], columns)
    scores = {n: name_scores(s, words) for n, s in plain.items()}
    said = {n: said_and_unit(s, words) for n, s in plain.items()}
    # SI, where a signal carries the contract's own name.
    own_names = {n: s.field or path_parts(s.name)[1] for n, s in plain.items()}
    si = {n: CHANNELS[own].unit for n, own in own_names.items() if own in CHANNELS}
    units = {n: unit or si.get(n) for n, (_, unit) in said.items()}
    found = Clues(known, data, scores, units, words, {n: c for n, (c, _) in said.items()}, time=time)
    for name, channels in scores.items():
        best = max(channels.values(), default=0.0)
        for channel, score in channels.items():
            if score >= 2.0 and score == best:
                found.reasons[(name, channel)] = ["its name" + (" and unit" if units[name] else "")]
    found.unnamed = [n for n, s in scores.items() if units[n] is None and max(s.values(), default=0.0) <= 0.0]
    for channel, name in given.items():
        for channels in scores.values():
            channels.pop(channel, None)
        if name in scores:
            scores[name] = {channel: GIVEN_NATS}
    _shaft(found, {*given.values()})
    _pressures(found)
    _motion(found)
    _chambers(found)
    _accumulator(found)
    _torque(found)
    return found


def _time_column(log: LogFile, raw: dict[str, np.ndarray], clock: str) -> tuple[str, str]:
    """The column that grows from row to row as a clock does, and its unit."""
    found = []
    for signal in log.signals.values():
        values = raw[signal.name]
        steps = np.diff(values[np.isfinite(values)])
        if signal.clock != clock or steps.size < 10 or not _grows(values):
            continue
        usual = float(np.median(steps))
        even = float((np.abs(steps - usual) < 0.5 * usual).mean()) + 2.0 * is_time_name(signal.name)
        if usual > 0.0 and even > 0.9:
            found.append((even, signal.name, time_unit(signal.name, signal.unit, usual)))
    if not found:
        mend = "add a column with the time of each row"
        raise InputError("nothing in it grows as a time does", where=log.path, mend=mend)
    return max(found, key=lambda row: row[0])[1:]


def _without_prefix(signals: dict[str, Signal]) -> dict[str, Signal]:
    """What all names begin with, e.g. EHA1_, tells none from another."""
    own = [s.field or path_parts(s.name)[1] for s in signals.values()]
    pairs = zip(min(own, default=""), max(own, default=""), strict=False)
    same = re.match(r".*[\W_]", "".join(a for a, b in takewhile(lambda pair: pair[0] == pair[1], pairs)))
    if same is None or len(own) < LEAST_ALIKE:
        return signals
    n, out = len(same[0]), {}
    for name, s in signals.items():
        before, last = path_parts(s.name)
        plain = f"{before}/{last[n:]}" if before else last[n:]
        out[name] = replace(s, field=s.field[n:]) if s.field else replace(s, name=plain)
    return out


def _grows(values: np.ndarray) -> bool:
    """Whether it never falls, but for a few rows."""
    steps = np.diff(values[np.isfinite(values)])
    return steps.size > 0 and float((steps >= 0.0).mean()) >= 0.95


def _shaft(found: Clues, given: set[str]) -> None:
    """An angle that begins again each turn is the pump's, as no other shaft is there to turn.

    A signal without a name that adds up to it is its speed, another one that comes before that the demand. Of
    other signals without names nobody knows the scale, so who gives that has to name them as well.
    """
    unnamed = [n for n in found.unnamed if n not in given]
    shaft = find_shaft(found.data, found.allowing("pump_angle"), found.allowing("position"), unnamed)
    if shaft is not None:
        found.shaft = shaft
        found.data.columns[shaft.signal] = shaft.turned
        found.add(shaft.signal, "pump_angle", SURE_NATS, f"it begins again each {shaft.wrap:g} counts")
        others = [n for n in unnamed if n not in (shaft.signal, shaft.direction)]
        alike = [(abs(follows(found.data, shaft.signal, n)), n) for n in others]
        rates = sorted((pair for pair in alike if pair[0] > SAME_SHAFT), reverse=True)
        for r, name in rates[:1]:
            found.add(name, "pump_speed", SURE_NATS, f"it adds up to {shaft.signal} ({r:.4f})")
        for _, name in rates[1:]:
            if leads(found.data, name, rates[0][1]) >= 0.0:
                found.add(name, "command", LIKELY_NATS, f"{rates[0][1]} comes after it")
    for name in unnamed:
        found.scores[name] = {channel: nats for channel, nats in found.scores[name].items() if nats > 0.0}


def _pressures(found: Clues) -> None:
    """Δp is what two others differ by; the accumulator's is the quietest of the rest."""
    sure = found.pressures()
    if (triple := difference(found.data, sure[:12])) is not None:
        d, one, two = triple
        # Nothing but its name and the pumping tell the two chambers apart, so each may be the other.
        for name, channel, nats in (
            (d, "pressure_difference", 3.0), (one, "pressure_1", 3.0), (two, "pressure_2", 3.0),
            (one, "pressure_2", 2.0), (two, "pressure_1", 2.0),
        ):  # fmt: skip
            found.add(name, channel, nats, f"{d} = {one} - {two}")
        rest = [n for n in sure if n not in (d, one, two)]
        if rest:
            quiet = min(rest, key=lambda n: float(np.std(found.data.means(n))))
            found.add(quiet, "pressure_accumulator", 1.0, "it changes least")


def _motion(found: Clues) -> None:
    """The position follows the pump's speed; a demand is smooth and comes first."""
    rates = [n for n in found.allowing("pump_speed", "command") if n not in found.unnamed]
    places = [n for n in found.allowing("position", "position_setpoint") if n not in found.unnamed]
    for x, w in product(places, rates):
        r = 0.0 if x == w else abs(follows(found.data, x, w))
        if r > CLOSE:
            found.add(x, "position", 2.0 * r - 1.0, f"it follows {w} ({r:.2f})")
            found.add(w, "pump_speed", 2.0 * r - 1.0, f"{x} follows it ({r:.2f})")
    groups = (rates, "command", "pump_speed"), (places, "position_setpoint", "position")
    for group, demand, measured in groups:
        for a, b in permutations(group, 2):
            if abs(correlation(found.data.means(a), found.data.means(b))) < CLOSE:
                continue
            smooth = roughness(found.data, a) < 0.5 * roughness(found.data, b)
            if smooth and leads(found.data, a, b) > 0.0:
                found.add(a, demand, 1.0, f"it is smooth and comes before {b}")
                found.add(b, measured, 1.0, f"it comes after {a}")


def _chambers(found: Clues) -> None:
    """Which pressures are the chambers', where no name tells: oil that moves no piston fills them.

    One rests while the other works: check valves or a directional valve keep the emptied side near the
    accumulator's pressure.
    """
    data, rate = found.data, found.shaft is None
    pump = found.named("pump_speed") if found.shaft is None else found.shaft.signal
    x = found.named("position")
    may = sorted(n for n in found.pressures() if not found.named_as(n, "pressure"))
    if pump is None or x is None or found.sides_known or not data.changes(x).size:
        return
    # A pressure is filled by the motion that counts as positive, whichever way the pump counts.
    way = 1.0 if correlation(data.changes(x), data.sums(pump) if rate else data.changes(pump)) > 0.0 else -1.0
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


def _accumulator(found: Clues) -> None:
    """The emptied chamber is refed from the accumulator, and rests at its pressure."""
    one, two, drop = (found.named(c) for c in PRESSURES[:3])
    if one is not None and two is not None and found.units[one] == found.units[two]:
        sides = found.data.means(one), found.data.means(two)
        high, low = np.maximum(*sides), np.minimum(*sides)
        why = f"the lower of {one} and {two} rests at it"
    elif drop is not None:
        high, low, why = np.abs(found.data.means(drop)), None, f"it changes little beside {drop}"
    else:
        return
    if not high.size:  # too short a log
        return
    most = np.percentile(high, 95.0)
    for name in found.pressures():
        level = found.data.means(name)
        if name in (one, two, drop) or np.min(level) < 0.0 or np.ptp(level) > 0.5 * most:
            continue
        if low is None or np.mean(np.abs(low - level) < 0.1 * most) > 0.5:
            found.add(name, "pressure_accumulator", 2.0, why)


def _torque(found: Clues) -> None:
    """The motor's current goes with the pressure difference."""
    drop = found.named("pressure_difference")
    if drop is None:
        return
    for name in found.allowing("motor_current"):
        r = correlation(found.data.means(name), found.data.means(drop))
        if name != drop and abs(r) > 0.7 and dimension_of(found.units[name]) in ("current", None):
            found.add(name, "motor_current", 1.0, f"it goes with {drop} ({abs(r):.2f})")
