"""Scores of signals for channels by names, units and what signals do."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations, product, takewhile

import numpy as np

from fdd.bounds import MOST_ROWS_LOOKED_AT
from fdd.errors import InputError
from fdd.logs.formats import LogFile, Signal
from fdd.logs.formats.trees import grows, is_time_name, path_parts, time_unit
from fdd.logs.mapping.behaviour import Shaft, Signals, correlation, find_shaft
from fdd.logs.mapping.concepts import dimension_of, name_scores, said_and_unit
from fdd.logs.rates import aligned
from fdd.measures import measure
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
NAMED = 2.0
"""nats above which a name tells a channel."""
SURE_NATS, LIKELY_NATS = 4.0, 3.0
CLEAR_T = 2.0
RESTS = 0.6
"""Share of its scatter that a chamber's pressure keeps while the other's is high; above it none rests."""


@dataclass
class Clues:
    """What is known of a log's signals, without those of clocks.

    `data`: on one time base. `scores`: signal to channel to nats. `units`: signal to the unit that the file
    or its name gives. `said`: signal to the concepts of its name. `time`: the column of the time and its
    unit, where the file does not tell by itself. `reasons`: (signal, channel) to what spoke for it.
    `unnamed`: signals of which neither name nor unit says anything, the user's among them. `shaft`: the
    pump's, where an angle begins again each turn; its column in `data` is unwrapped and directed.
    """

    signals: dict[str, Signal]
    data: Signals
    scores: dict[str, dict[str, float]]
    units: dict[str, str | None]
    said: dict[str, set[str]]
    time: tuple[str, str] | None = None
    reasons: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    unnamed: list[str] = field(default_factory=list)
    shaft: Shaft | None = None

    def add(self, signal: str, channel: str, nats: float, reason: str) -> None:
        """Take up evidence, where the unit allows the channel at all."""
        if channel in self.scores[signal]:
            self.scores[signal][channel] += nats
            self.reasons.setdefault((signal, channel), []).append(reason)

    def allowing(self, *channels: str) -> list[str]:
        """Signals that move and may be one of these channels."""
        may = (n for n, scores in self.scores.items() if any(scores.get(c, -9.0) >= 0.0 for c in channels))
        return [n for n in may if np.ptp(self.data.columns[n]) > 0.0]

    def pressures(self) -> list[str]:
        """Signals that move and are pressures by their unit, or else by their name."""
        may = self.allowing(*PRESSURES)
        sure = [n for n in may if dimension_of(self.units[n]) == "pressure"]
        return sure or [n for n in may if "pressure" in self.said[n]]

    def named(self, channel: str) -> str | None:
        """The signal of which most speaks for a channel, where anything does."""
        best = max(self.scores, key=lambda n: self.scores[n].get(channel, -9.0), default=None)
        return best if best is not None and self.scores[best].get(channel, -9.0) >= NAMED else None


def gather(log: LogFile, given: dict[str, str]) -> Clues:
    """Read a log's signals and score them; `given`: channel to signal, as the user knows it, "" for none. An
    InputError where nothing in the log can be its time."""
    found = _read(log)
    for name, channels in found.scores.items():
        best = max(channels.values(), default=0.0)
        reason = "its name and unit" if found.units[name] else "its name"
        told = (channel for channel, nats in channels.items() if nats == best >= NAMED)
        found.reasons |= {(name, channel): [reason] for channel in told}
        if found.units[name] is None and best <= 0.0:
            found.unnamed.append(name)
    for channel, name in given.items():
        for channels in found.scores.values():
            channels.pop(channel, None)
        if name in found.scores:
            found.scores[name] = {channel: GIVEN_NATS}
    _shaft(found, {*given.values()})
    for look in (_pressures, _motion, _chambers, _accumulator, _torque):
        look(found)
    return found


def _read(log: LogFile) -> Clues:
    """All signals on the time base of the one with most rows, and what names and units say."""
    raw = log.read(log.signals)
    main = max(log.signals.values(), key=lambda s: raw[s.name].size).clock
    stamps = {clock: log.stamps(clock) for clock in dict.fromkeys(s.clock for s in log.signals.values())}
    time, at = None, stamps[main]
    if at is None:
        time = _time_column(log, raw, main)
        at = raw[time[0]] * measure(time[1], "time").factor
    good = np.flatnonzero(np.isfinite(at) & (np.diff(at, prepend=-np.inf) > 0.0))[:MOST_ROWS_LOOKED_AT]
    columns = {}
    for name, signal in log.signals.items():
        own = stamps[signal.clock]
        is_time = (time is not None and name == time[0]) or (is_time_name(name) and grows(raw[name]))
        if is_time or (signal.clock != main and own is None):  # T may be a temperature
            continue
        values = raw[name] if signal.clock == main or own is None else aligned(at, own, raw[name])
        values = np.where(np.abs(values[good]) < LARGEST, values[good], np.nan)
        if np.isfinite(values).any():
            columns[name] = values
    known = {n: log.signals[n] for n in columns}
    plain = _without_prefix(known)
    said = {n: said_and_unit(s) for n, s in plain.items()}
    units = {n: unit for n, (_, unit) in said.items()}
    for n, s in plain.items():  # SI, where a signal carries the contract's own name
        own_name = s.field or path_parts(s.name)[1]
        units[n] = units[n] or (CHANNELS[own_name].unit if own_name in CHANNELS else None)
    scores = {n: name_scores(s) for n, s in plain.items()}
    concepts = {n: c for n, (c, _) in said.items()}
    return Clues(known, Signals(at[good], columns), scores, units, concepts, time)


def _time_column(log: LogFile, raw: dict[str, np.ndarray], clock: str) -> tuple[str, str]:
    """The column that grows from row to row as a clock does, and its unit."""
    found = []
    for signal in log.signals.values():
        values = raw[signal.name]
        steps = np.diff(values[np.isfinite(values)])
        if signal.clock != clock or steps.size < 10 or not grows(values):
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
    letters = takewhile(lambda each: len(set(each)) == 1, zip(*own, strict=False))
    same = re.match(r".*[\W_]", "".join(each[0] for each in letters))
    if same is None or len(own) < LEAST_ALIKE:
        return signals
    n, out = len(same[0]), {}
    for name, s in signals.items():
        before, last = path_parts(s.name)
        plain = f"{before}/{last[n:]}" if before else last[n:]
        out[name] = replace(s, field=s.field[n:]) if s.field else replace(s, name=plain)
    return out


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
        alike = [(abs(found.data.follows(shaft.signal, n)), n) for n in others]
        rates = sorted((pair for pair in alike if pair[0] > SAME_SHAFT), reverse=True)
        for r, name in rates[:1]:
            found.add(name, "pump_speed", SURE_NATS, f"it adds up to {shaft.signal} ({r:.4f})")
        for _, name in rates[1:]:
            if found.data.leads(name, rates[0][1]) >= 0.0:
                found.add(name, "command", LIKELY_NATS, f"{rates[0][1]} comes after it")
    for name in unnamed:
        found.scores[name] = {channel: nats for channel, nats in found.scores[name].items() if nats > 0.0}


def _pressures(found: Clues) -> None:
    """Δp is what two others differ by; the accumulator's is the quietest of the rest."""
    sure = found.pressures()
    if (triple := found.data.difference(sure[:12])) is None:
        return
    d, one, two = triple
    # Nothing but its name and the pumping tell the two chambers apart, so each may be the other.
    for name, channel, nats in (
        (d, "pressure_difference", 3.0), (one, "pressure_1", 3.0), (two, "pressure_2", 3.0),
        (one, "pressure_2", 2.0), (two, "pressure_1", 2.0),
    ):  # fmt: skip
        found.add(name, channel, nats, f"{d} = {one} - {two}")
    if rest := [n for n in sure if n not in triple]:
        quiet = min(rest, key=lambda n: float(np.std(found.data.means(n))))
        found.add(quiet, "pressure_accumulator", 1.0, "it changes least")


def _motion(found: Clues) -> None:
    """The position follows the pump's speed; a demand is smooth and comes first."""
    data = found.data
    rates = [n for n in found.allowing("pump_speed", "command") if n not in found.unnamed]
    places = [n for n in found.allowing("position", "position_setpoint") if n not in found.unnamed]
    for x, w in product(places, rates):
        if x != w and (r := abs(data.follows(x, w))) > CLOSE:
            found.add(x, "position", 2.0 * r - 1.0, f"it follows {w} ({r:.2f})")
            found.add(w, "pump_speed", 2.0 * r - 1.0, f"{x} follows it ({r:.2f})")
    for group, demand, measured in (
        (rates, "command", "pump_speed"), (places, "position_setpoint", "position"),
    ):  # fmt: skip
        for a, b in permutations(group, 2):
            smooth = abs(data.alike(a, b)) >= CLOSE and data.roughness(a) < 0.5 * data.roughness(b)
            if smooth and data.leads(a, b) > 0.0:
                found.add(a, demand, 1.0, f"it is smooth and comes before {b}")
                found.add(b, measured, 1.0, f"it comes after {a}")


def _chambers(found: Clues) -> None:
    """Which pressures are the chambers', where no name tells: oil that moves no piston fills them.

    One rests while the other works: check valves or a directional valve keep the emptied side near the
    accumulator's pressure.
    """
    data = found.data
    pump = found.named("pump_speed") if found.shaft is None else found.shaft.signal
    x, told = found.named("position"), any(found.named(channel) for channel in PRESSURES[:3])
    may = sorted(
        n for n in found.pressures()
        if not any(nats >= NAMED for c, nats in found.scores[n].items() if c.startswith("pressure"))
    )  # fmt: skip
    if pump is None or x is None or told or not data.changes(x).size:
        return
    # A pressure is filled by the motion that counts as positive, whichever way the pump counts.
    turned = data.sums(pump) if found.shaft is None else data.changes(pump)
    way = 1.0 if correlation(data.changes(x), turned) > 0.0 else -1.0
    middles = {n: data.columns[n] - float(np.nanmedian(data.columns[n])) for n in may}
    t = {n: way * data.rises_with_pumping(v, x, turned) for n, v in middles.items()}
    for side, sense, word in (("pressure_1", 1.0, "raises"), ("pressure_2", -1.0, "lowers")):
        best = max((sense * t[n] for n in may), default=0.0)
        for name in may:
            if sense * t[name] > 0.0:  # what explains less than half of what the best does is none beside it
                nats = min(0.5 * t[name] ** 2, SURE_NATS) * min(2.0 * (t[name] / best) ** 2, 1.0)
                found.add(name, side, nats, f"pumping {word} it (t = {abs(t[name]):.0f})")

    def rest(a: str, b: str) -> float:
        """The share of its scatter that one keeps while the other is high, the larger of both ways round."""
        shares = [1e-3]
        for mine, its in permutations((data.means(a), data.means(b))):
            working = its > 0.5 * float(np.sum(np.percentile(its, [5.0, 95.0])))
            shares.append(float(np.std(mine[working]) / np.std(mine)) if working.any() else 1.0)
        return max(shares)

    clear = [n for n in may if abs(t[n]) > CLEAR_T]
    pairs = [(rest(a, b), a, b) for a, b in combinations(clear, 2) if t[a] * t[b] < 0.0]
    if pairs and min(pairs)[0] < RESTS:
        share, *both = min(pairs)
        one, two = sorted(both, key=lambda n: -t[n])
        nats = -2.0 * float(np.log(share / RESTS))
        found.add(one, "pressure_1", nats, f"it rests while {two} is high")
        found.add(two, "pressure_2", nats, f"it rests while {one} is high")


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
    for name in found.allowing("motor_current") if drop is not None else ():
        r = abs(found.data.alike(name, str(drop)))
        if name != drop and r > 0.7 and dimension_of(found.units[name]) in ("current", None):
            found.add(name, "motor_current", 1.0, f"it goes with {drop} ({r:.2f})")
