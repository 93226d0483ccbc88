"""Scores of signals for channels by names, units and what signals do, and the likeliest assignment."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import permutations, product, takewhile

import numpy as np
from numpy.typing import NDArray

from fdd.bounds import MOST_ROWS_LOOKED_AT
from fdd.errors import InputError
from fdd.logs.formats.signals import LogFile, Signal
from fdd.logs.mapping.behaviour import Signals, correlation, difference, follows, leads, roughness
from fdd.logs.mapping.concepts import Words, dimension_of, name_scores, said_and_unit
from fdd.logs.mapping.unnamed import Shaft, around_shaft, chambers, find_shaft, without_copies
from fdd.logs.names import is_time_name, path_parts, time_unit
from fdd.logs.rates import aligned
from fdd.measures import MEASURES
from fdd.samples import CHANNELS

IMPOSSIBLE = -1e3
LEAST_SCORE = 1.5
"""nats; a signal of which less speaks for a channel is left without one."""
LARGEST = 1e100
"""No signal has such a value; its square would be infinite."""
GIVEN_NATS = 50.0
LEAST_ALIKE = 4
"""Signals whose common beginning is that of their rig; fewer may all be pressures."""
PRESSURES = ("pressure_1", "pressure_2", "pressure_difference", "pressure_accumulator")
CLOSE = 0.9
"""Correlation above which one signal's motion is another's."""


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
    unnamed : signals of which neither name nor unit says anything.
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
    for channel, name in given.items():
        for channels in scores.values():
            channels.pop(channel, None)
        if name in scores:
            scores[name] = {channel: GIVEN_NATS}
    silent = [n for n, s in scores.items() if units[n] is None and max(s.values(), default=0.0) <= 0.0]
    found.unnamed, copies = without_copies(silent, data)
    for copy in copies:
        scores[copy].clear()
    _shaft(found)
    _pressures(found)
    _motion(found)
    if found.shaft is not None:
        around_shaft(found, found.shaft)
    chambers(found)
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


def _shaft(found: Clues) -> None:
    """An angle that begins again each turn is the pump's; no other shaft is there to turn."""
    angles = found.allowing("pump_angle")
    shaft = find_shaft(found.data, angles, found.allowing("position"), found.unnamed)
    if shaft is None:
        return
    found.shaft = shaft
    found.data.columns[shaft.signal] = shaft.turned
    if shaft.direction is not None:
        found.scores[shaft.direction].clear()


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
    # Beside a shaft's angle nothing has to be guessed from an integral alone.
    told = set(found.unnamed) if found.shaft is not None else set()
    rates = [n for n in found.allowing("pump_speed", "command") if n not in told]
    places = [n for n in found.allowing("position", "position_setpoint") if n not in told]
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
    rows = [[of.get(channel, IMPOSSIBLE) for channel in channels] for of in scores.values()]
    table = np.array(rows).reshape(len(signals), len(channels))
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
