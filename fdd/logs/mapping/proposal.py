"""A channel map proposed from a log: who is which channel, in which unit and with which sign."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fdd.errors import InputError
from fdd.logs.angles import accumulate_speed
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.formats.signals import LogFile, Signal
from fdd.logs.mapping.assignment import Choice, assign
from fdd.logs.mapping.behaviour import correlation, follows, rises_with_pumping
from fdd.logs.mapping.concepts import RULES, Words
from fdd.logs.mapping.delays import delays
from fdd.logs.mapping.evidence import Evidence, gather
from fdd.logs.mapping.units import Question, scale_of, unit_questions
from fdd.logs.near_misses import listed
from fdd.samples import CHANNELS, missing_required

SURE = 0.9
"""Below it a channel that a diagnosis needs is asked for; below `LIKELY` any other is left out."""
LIKELY = 0.75
CLEAR_T = 5.0
"""Student's t above which the pumping tells which chamber is filled."""
_NAMED_SIDES = {
    "ext", "extend", "ret", "retract", "head", "rod", "bore", "cap", "kolbenseite", "stangenseite",
    "bodenseite", "ringseite", "stange", "kolben", "tige", "fond",
}  # fmt: skip
"""Words that tell which end of the cylinder a chamber is at, and not only A and B."""


@dataclass
class Proposed:
    """One channel of a proposed map.

    Attributes
    ----------
    source : the map's entry. confidence : 0 to 1. why : what spoke for it.
    """

    channel: str
    source: ChannelSource
    confidence: float
    why: str


@dataclass
class Proposal:
    """A map, how sure each part is, and what has to be asked.

    Attributes
    ----------
    rows : by channel. questions : open ones. notes : what was found out, one line each.
    unused : signals that are no channel.
    """

    rows: dict[str, Proposed] = field(default_factory=dict)
    questions: list[Question] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)

    def answer(self, question: Question, option: str) -> None:
        """Take an answer up."""
        for channel, source in question.options[option].items():
            self.rows[channel] = Proposed(channel, source, 1.0, "answered")
        self.questions.remove(question)

    def channel_map(self, name: str = "", axis: str | None = None) -> ChannelMap:
        """The map as it stands.

        Raises
        ------
        InputError : it lacks what a diagnosis needs.
        """
        channels = {c: r.source for c, r in self.rows.items()}
        absent = missing_required(channels)
        if absent:
            raise InputError(
                f"found no {', no '.join(absent)}",
                mend=f"name it, e.g. --set position=SIGNAL; not used: {listed(self.unused) or 'none'}",
            )
        return ChannelMap(name=name, axis=axis, channels=channels)


def propose(log: LogFile, words: Words | None = None, given: dict[str, str] | None = None) -> Proposal:
    """Propose a map for a log.

    Parameters
    ----------
    log : opened. words : to read names by; the shipped ones.
    given : channel to signal, as the user knows it; "" for none.

    Raises
    ------
    InputError : nothing in the log can be its time, or a given signal is not there.

    Examples
    --------
    >>> propose(open_log("run.mf4")).channel_map()  # doctest: +SKIP
    """
    if not log.signals:
        raise InputError("no signals in it", where=log.path, mend="see fdd inspect what it holds")
    found = gather(log, words or Words())
    if found is None:
        raise InputError(
            "nothing in it grows as a time does",
            where=log.path,
            mend="add a column with the time of each row",
        )
    for channel, name in (given or {}).items():
        signal = None if name == "" else log.find(name)
        for scores in found.scores.values():
            scores.pop(channel, None)
        if signal is not None and signal.name in found.scores:
            found.scores[signal.name] = {channel: 50.0}
    channels = [c for c in RULES if c != "time"]
    chosen = assign(found.scores, channels)
    out = Proposal()
    if found.time is not None:
        name, unit = found.time
        source = ChannelSource(column=_short(log, log.signals[name]), unit=unit)
        out.rows["time"] = Proposed("time", source, 1.0, "it grows evenly")
    _signs_and_units(log, found, chosen, out)
    out.unused = [n for n in found.signals if n not in {c.signal for c in chosen.values()}]
    return out


def _signs_and_units(log: LogFile, found: Evidence, chosen: dict[str, Choice], out: Proposal) -> None:
    needed = {"position", "pressure_difference", "pressure_1", "pressure_2"}
    needed |= {"pump_speed"} if "pump_angle" not in chosen else {"pump_angle"}
    for channel in [c for c in chosen if c not in needed and chosen[c].confidence < LIKELY]:
        out.notes.append(
            f"{chosen[channel].signal} may be {channel}; left out, say --set {channel}=… if it is"
        )
        del chosen[channel]
    signs = _signs(found, chosen, out)
    speed = chosen["pump_speed"].signal if "pump_speed" in chosen else None
    for channel, choice in sorted(chosen.items(), key=lambda item: list(CHANNELS).index(item[0])):
        signal = found.signals[choice.signal]
        scaled = scale_of(found, speed, channel, choice.signal)
        reasons = found.reasons.get((choice.signal, channel), ["nothing else fits better"])
        source = _source(log, signal, **{**scaled, **({"sign": -1} if signs.get(channel) == -1 else {})})
        out.rows[channel] = Proposed(channel, source, choice.confidence, "; ".join(reasons[:3]))
        if choice.confidence < SURE and channel in needed and choice.other is not None:
            other = _source(log, found.signals[choice.other], **scale_of(found, speed, channel, choice.other))
            out.questions.append(
                Question(
                    channel,
                    f"Which signal is {channel} ({CHANNELS[channel].meaning})?",
                    {choice.signal: {channel: source}, choice.other: {channel: other}},
                )
            )
    names = {c: chosen[c].signal for c in chosen}
    _delays(found, chosen, out)
    asked = unit_questions(found, names, {c: r.source for c, r in out.rows.items() if c in names})
    for question, sources in asked:
        for channel, source in sources.items():
            out.rows[channel].source = source
        if question is not None:
            out.questions.append(question)


def _delays(found: Evidence, chosen: dict[str, Choice], out: Proposal) -> None:
    """Delays of motion and pressures against the pump, where the volume balance closes better with them."""
    name = {c: chosen[c].signal for c in chosen}
    one, two, drop = (name.get(c) for c in ("pressure_1", "pressure_2", "pressure_difference"))
    columns, time = found.data.columns, found.data.time
    if "position" not in name or not {"pump_speed", "pump_angle"} & set(name):
        return
    if "pump_angle" in name:
        turned = columns[name["pump_angle"]]
    else:
        turned = accumulate_speed(time, columns[name["pump_speed"]], float(np.median(np.diff(time))))
    difference = columns[one] - columns[two] if one and two else columns[drop] if drop else None
    if difference is None:
        return
    of_position, of_pressure = delays(time, turned, columns[name["position"]], difference)
    groups = (
        (of_position, ("position",)),
        (of_pressure, ("pressure_difference", "pressure_1", "pressure_2")),
    )
    for late, channels in groups:
        if late == 0.0:
            continue
        out.notes.append(
            f"{channels[0].split('_')[0]} comes {1e3 * late:.3g} ms later than the pump's motion"
        )
        for channel in channels:
            if channel in out.rows:
                row = out.rows[channel]
                row.source = row.source.model_copy(update={"delay": float(f"{late:.3g}")})


def _signs(found: Evidence, chosen: dict[str, Choice], out: Proposal) -> dict[str, int]:
    """Signs by physics: a positive pump motion extends the cylinder and raises the pressure of chamber 1."""
    data = found.data
    signs: dict[str, int] = dict.fromkeys(chosen, 1)
    pump = next((c for c in ("pump_speed", "pump_angle", "command") if c in chosen), None)
    if pump is None or "position" not in chosen:
        return signs
    name = {c: chosen[c].signal for c in chosen}
    columns = data.columns
    one, two, drop = (name.get(c) for c in ("pressure_1", "pressure_2", "pressure_difference"))
    if one and two and drop:
        between = correlation(data.means(drop), data.means(one) - data.means(two))
        if between < -0.5:
            signs["pressure_difference"] = -1
    rate = pump != "pump_angle"
    along = (
        follows(data, name["position"], name[pump])
        if rate
        else correlation(data.changes(name["position"]), data.changes(name[pump]))
    )
    difference = columns[one] - columns[two] if one and two else columns[drop] if drop else None
    if difference is None:
        return signs
    t = rises_with_pumping(data, difference, name["position"], name[pump], rate=rate)
    motion, pressures = 1 if along > 0 else -1, 1 if t > 0 else -1
    if abs(along) < 0.5:
        out.notes.append("the position does not follow the pump in this log: signs are taken as they are")
        return signs
    if abs(t) < CLEAR_T:
        out.notes.append("this log does not tell which chamber the pump fills: chambers are taken as named")
        pressures = 1
    pumped: list[str] = [c for c in ("pump_speed", "pump_angle", "command") if c in chosen]
    moved: list[str] = [c for c in ("position", "position_setpoint") if c in chosen]
    flip: list[str] = []
    if (motion, pressures) == (-1, 1):
        flip = moved
        out.notes.append("the position counts against the pump: its sign is turned")
    elif (motion, pressures) == (-1, -1):
        flip = pumped
        out.notes.append("the pump counts against position and pressures: its sign is turned")
    elif (motion, pressures) == (1, -1):
        if one and two and not _sides_named(found.words, one, two):
            chosen["pressure_1"], chosen["pressure_2"] = chosen["pressure_2"], chosen["pressure_1"]
            signs["pressure_difference"] = -signs.get("pressure_difference", 1)
            out.notes.append(f"a positive pump motion raises {two}: it is chamber 1")
        elif one and two:
            flip = [*pumped, *moved]
            out.notes.append(f"a positive pump motion raises {two}: retracting counts as positive, turned")
        else:
            signs["pressure_difference"] = -1
            out.notes.append(f"a positive pump motion lowers {drop}: its sign is turned")
    for channel in flip:
        signs[channel] = -1
    _like(found, chosen, signs, "command", pump)
    _like(found, chosen, signs, "position_setpoint", "position")
    if "motor_current" in chosen and drop:
        torque = correlation(data.means(name["motor_current"]), data.means(drop))
        sense = signs["pressure_difference"] * (1 if torque > 0 else -1)
        if abs(torque) > 0.5 and sense < 0:
            signs["motor_current"] = -1
            out.notes.append(
                "the current is negative where the pump works against pressure: its sign is turned"
            )
    return signs


def _like(
    found: Evidence, chosen: dict[str, Choice], signs: dict[str, int], demand: str, measured: str
) -> None:
    """Give a demand the sign of what follows it."""
    if demand not in chosen or demand == measured:
        return
    alike = (
        correlation(found.data.means(chosen[demand].signal), found.data.means(chosen[measured].signal))
        if measured != "pump_angle"
        else 0.0
    )
    if abs(alike) > 0.5:
        signs[demand] = signs[measured] * (1 if alike > 0 else -1)


def _sides_named(words: Words, *names: str) -> bool:
    """Whether names say extending and retracting side, and not only A and B."""
    return any(_NAMED_SIDES & set(words.taken_apart(n)) for n in names)


def _source(log: LogFile, signal: Signal, **more: object) -> ChannelSource:
    where: dict[str, object] = (
        {"topic": signal.topic, "field": signal.field}
        if signal.topic is not None
        else {"column": _short(log, signal)}
    )
    return ChannelSource.model_validate({**where, **more})


def _short(log: LogFile, signal: Signal) -> str:
    """The last part of a signal's path where it alone ends so."""
    last = signal.name.rsplit("/", 1)[-1]
    alone = sum(n == last or n.endswith(f"/{last}") for n in log.signals) == 1
    return last if alone and last else signal.name
