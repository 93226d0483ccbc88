"""A channel map proposed from a log: who is which channel, in which unit and with which sign."""

from __future__ import annotations

from dataclasses import dataclass, field

from fdd.errors import InputError
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.formats.signals import LogFile, Signal
from fdd.logs.mapping.assignment import Choice, assign, signs_of
from fdd.logs.mapping.concepts import RULES, Words
from fdd.logs.mapping.evidence import Clues, gather
from fdd.logs.mapping.given import Given
from fdd.logs.mapping.units import Question, scale_of, unit_questions
from fdd.logs.names import path_parts
from fdd.near_misses import listed
from fdd.samples import CHANNELS, missing_required

SURE = 0.9
"""Below it a channel that a diagnosis needs is asked for; below `LIKELY` any other is left out."""
LIKELY = 0.75


@dataclass
class Proposed:
    """One channel of a proposed map.

    Attributes
    ----------
    source : the map's entry. confidence : 0 to 1. why : what spoke for it.
    """

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
            self.rows[channel] = Proposed(source, 1.0, "answered")
        self.questions.remove(question)

    def assume(self, question: Question) -> None:
        """Take the likeliest answer, and say that it was nobody's."""
        option, sources = next(iter(question.options.items()))
        for channel, source in sources.items():
            self.rows[channel].source = source
            self.rows[channel].why += f"; {option} assumed"
        self.notes.append(f"{question.text} Assumed: {option}")
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
            lone = [c for c in ("pressure_1", "pressure_2") if c not in channels]
            wanted = lone[0] if len(lone) == 1 and "pressure_1" in absent[0] else absent[0].split()[0]
            raise InputError(
                f"found no {', no '.join(absent)}",
                mend=f"name it, e.g. --set {wanted}=SIGNAL; not used: {listed(self.unused) or 'none'}",
            )
        return ChannelMap(name=name, axis=axis, channels=channels)


def propose(log: LogFile, words: Words | None = None, given: dict[str, Given] | None = None) -> Proposal:
    """Propose a map for a log.

    Parameters
    ----------
    log : opened. words : to read names by; the shipped ones.
    given : what the user knows, by channel; see `given_of`.

    Raises
    ------
    InputError : nothing in the log can be its time, or a given signal is not there.
    """
    if not log.signals:
        raise InputError("no signals in it", where=log.path, mend="see fdd inspect what it holds")
    given = given or {}
    signals = {
        channel: log.find(known.signal).name if known.signal else ""
        for channel, known in given.items()
        if known.signal is not None and channel in CHANNELS
    }
    found = gather(log, words or Words(), signals)
    channels = [c for c in RULES if c != "time"]
    chosen = assign(found.scores, channels)
    out = Proposal()
    if found.time is not None:
        name, unit = found.time
        out.rows["time"] = Proposed(_source(log, log.signals[name], unit=unit), 1.0, "it grows evenly")
    _signs_and_units(log, found, chosen, out, given)
    used = {*(c.signal for c in chosen.values()), found.shaft and found.shaft.direction}
    out.unused = [n for n in found.signals if n not in used]
    return out


def _signs_and_units(
    log: LogFile, found: Clues, chosen: dict[str, Choice], out: Proposal, given: dict[str, Given]
) -> None:
    needed = {"position", "pressure_difference", "pressure_1", "pressure_2"}
    needed |= {"pump_speed"} if "pump_angle" not in chosen else {"pump_angle"}
    for channel in [c for c in chosen if c not in needed and chosen[c].confidence < LIKELY]:
        name = chosen.pop(channel).signal
        out.notes.append(f"{name} may be {channel}; left out, say --set {channel}=… if it is")
    signs, told = signs_of(found, chosen)
    out.notes += told
    speed = chosen["pump_speed"].signal if "pump_speed" in chosen else None
    for channel, choice in sorted(chosen.items(), key=lambda item: list(CHANNELS).index(item[0])):
        signal = found.signals[choice.signal]
        scaled = scale_of(found, speed, channel, choice.signal)
        shaft = found.shaft
        if shaft is not None and shaft.signal == choice.signal and shaft.direction is not None:
            valve = found.signals[shaft.direction]
            scaled["sign_of"] = valve.field if valve.topic is not None else _short(log, valve)
            out.notes.append(f"the pump turns one way: {valve.name} has the sign of its direction")
        reasons = found.reasons.get((choice.signal, channel), ["nothing else fits better"])
        source = _source(log, signal, **scaled, sign=signs.get(channel, 1))
        out.rows[channel] = Proposed(source, choice.confidence, "; ".join(reasons[:3]))
        if choice.confidence < SURE and channel in needed and choice.other is not None:
            other = _source(log, found.signals[choice.other], **scale_of(found, speed, channel, choice.other))
            text = f"Which signal is {channel} ({CHANNELS[channel].meaning})?"
            options = {choice.signal: {channel: source}, choice.other: {channel: other}}
            out.questions.append(Question(channel, text, options, f"--set {channel}={choice.signal}"))
    names = {c: choice.signal for c, choice in chosen.items()}
    for channel, known in given.items():
        signal_name = log.find(known.signal).name if known.signal else None
        for c, row in out.rows.items():
            mine = names.get(c) == signal_name if signal_name else c == channel
            if mine or (signal_name is None and channel == "pressure" and c.startswith("pressure")):
                row.source = known.applied(row.source)
    asked = unit_questions(found, names, {c: r.source for c, r in out.rows.items() if c in names})
    for question, sources in asked:
        for channel, source in sources.items():
            out.rows[channel].source = source
        if question is not None:
            out.questions.append(question)


def _source(log: LogFile, signal: Signal, **more: object) -> ChannelSource:
    if signal.topic is not None:
        return ChannelSource.model_validate({"topic": signal.topic, "field": signal.field, **more})
    return ChannelSource.model_validate({"column": _short(log, signal), **more})


def _short(log: LogFile, signal: Signal) -> str:
    """The last part of a signal's path where it alone ends so."""
    last = path_parts(signal.name)[1]
    alone = sum(n == last or n.endswith(f"/{last}") for n in log.signals) == 1
    return last if alone and last else signal.name
