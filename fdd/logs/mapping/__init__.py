"""Channel maps that write themselves: from names, units, and what the signals do."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import yaml

from fdd.errors import InputError, did_you_mean, listed
from fdd.logs.channel_map import ChannelMap, ChannelSource
from fdd.logs.formats import LogFile, Signal
from fdd.logs.formats.trees import path_parts
from fdd.logs.mapping.assignment import Choice, Question, assign, scale_of, signs_of, with_units
from fdd.logs.mapping.behaviour import Signals
from fdd.logs.mapping.concepts import RULES
from fdd.logs.mapping.evidence import Clues, gather
from fdd.measures import measure
from fdd.samples import CHANNELS, Samples, missing_required

__all__ = ["Given", "Proposal", "Question", "balance_words", "given_of", "propose"]

SURE = 0.9
"""Below it a channel that a diagnosis needs is asked for; below `LIKELY` any other is left out."""
LIKELY = 0.75
_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_VALUE = re.compile(
    rf"(?P<signal>.*?)(?:\*(?P<scale>-?{_NUMBER})(?P<offset>[+-]{_NUMBER})?)?(?::(?P<unit>[^:]*))?", re.DOTALL
)


@dataclass(frozen=True)
class Given:
    """What a user knows of one channel.

    `signal`: "" for none at all, None where only the unit is known. `unit`: of ``scale * raw + offset``.
    """

    signal: str | None
    unit: str | None = None
    scale: float | None = None
    offset: float = 0.0

    def applied(self, source: ChannelSource) -> ChannelSource:
        """A source with this unit and scale; the sign stays as found, unless the scale has one itself."""
        if self.unit is None:
            return source
        update: dict[str, object] = {"unit": self.unit}
        if self.scale is not None:
            sign = -1 if source.sign < 0 < self.scale else 1
            update |= {"scale": self.scale, "offset": sign * self.offset, "sign": sign}
        elif not source.wrap:
            update["scale"] = 1.0
        return source.model_copy(update=update)


def given_of(options: Iterable[str]) -> dict[str, Given]:
    """Read what a user says of channels, each as ``CHANNEL=[SIGNAL][*SCALE[+OFFSET]][:UNIT]``. An InputError
    where there is no such channel, a scale is no number or has no unit, or a unit is of another dimension."""
    out: dict[str, Given] = {}
    for option in options:
        channel, equals, value = option.partition("=")
        if not equals or channel not in ("pressure", *CHANNELS):
            near = did_you_mean(channel, ("pressure", *CHANNELS))
            mend = f"write CHANNEL=[SIGNAL][*SCALE[+OFFSET]][:UNIT], with one of: {', '.join(CHANNELS)}"
            raise InputError(f"--set {option}: no channel {channel!r}{near}", mend=mend)
        parts = _VALUE.fullmatch(value)
        assert parts is not None  # every text matches, as a name at least
        signal, unit = parts["signal"], parts["unit"]
        scale = float(parts["scale"]) if parts["scale"] else None
        offset = float(parts["offset"] or 0.0)
        odd = re.search(r"\*[-+.\d]", signal) is not None or scale == 0.0
        if odd or (scale is not None and not np.isfinite([scale, offset]).all()):
            problem = f"--set {option}: the scale is no number other than 0"
            raise InputError(problem, mend="write it like *0.0625-0.625:bar")
        if scale is not None and not unit:
            raise InputError(f"--set {option}: a scale without a unit", mend="add it, e.g. *0.025:mm")
        if unit is not None:
            measure(unit, CHANNELS["pressure_1" if channel == "pressure" else channel].dimension)
        out[channel] = Given(signal if signal or unit is None else None, unit or None, scale, offset)
    return out


@dataclass
class Proposed:
    """One channel of a proposed map: the map's entry, how sure it is (0 to 1), and what spoke for it."""

    source: ChannelSource
    confidence: float
    why: str


@dataclass
class Proposal:
    """A map by channel, open questions, what was found out, and signals that are no channel."""

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
        """The map as it stands. Raises InputError: it lacks what a diagnosis needs."""
        channels = {c: r.source for c, r in self.rows.items()}
        if absent := missing_required(channels):
            lone = [c for c in ("pressure_1", "pressure_2") if c not in channels]
            wanted = lone[0] if len(lone) == 1 and "pressure_1" in absent[0] else absent[0].split()[0]
            mend = f"name it, e.g. --set {wanted}=SIGNAL; not used: {listed(self.unused) or 'none'}"
            raise InputError(f"found no {', no '.join(absent)}", mend=mend)
        return ChannelMap(name=name, axis=axis, channels=channels)

    def map_text(self, name: str, axis: str | None, made_of: str) -> str:
        """The map as YAML, with what spoke for each channel. Raises InputError: as `channel_map`."""
        self.channel_map(name, axis)
        head = {"schema": "fdd.map/1", "name": name, **({} if axis is None else {"axis": axis})}
        lines = [f"# Channel map proposed by fdd map from {made_of}.", *(f"# {n}." for n in self.notes)]
        dump: Any = partial(yaml.safe_dump, sort_keys=False, allow_unicode=True, width=9999)
        lines += dump(head).splitlines()
        lines.append("channels:")
        for channel in (c for c in CHANNELS if c in self.rows):
            row = self.rows[channel]
            entry = row.source.model_dump(by_alias=True, exclude_defaults=True)
            flow = dump(entry, default_flow_style=True).strip()
            lines.append(f"  {channel}: {flow}  # {100 * row.confidence:.0f} %: {row.why}")
        return "\n".join(lines) + "\n"


def propose(log: LogFile, given: dict[str, Given] | None = None) -> Proposal:
    """Propose a map for a log; `given`: what the user knows, by channel (`given_of`). An InputError where
    nothing in the log can be its time, or a given signal is not there."""
    if not log.signals:
        raise InputError("no signals in it", where=log.path, mend="see fdd inspect what it holds")
    given = given or {}
    signals = {
        channel: log.find(known.signal).name if known.signal else ""
        for channel, known in given.items()
        if known.signal is not None and channel in CHANNELS
    }
    found = gather(log, signals)
    chosen = assign(found.scores, [c for c in RULES if c != "time"])
    out = Proposal()
    if found.time is not None:
        name, unit = found.time
        out.rows["time"] = Proposed(_source(log, log.signals[name], unit=unit), 1.0, "it grows evenly")
    _fill(out, log, found, chosen)
    names = {c: choice.signal for c, choice in chosen.items()}
    for channel, known in given.items():
        signal = log.find(known.signal).name if known.signal else None
        for c, row in out.rows.items():
            mine = c == channel if signal is None else names.get(c) == signal
            if mine or (signal is None and channel == "pressure" and c.startswith("pressure")):
                row.source = known.applied(row.source)
    sources = {c: out.rows[c].source for c in out.rows if c in names}
    out.questions += with_units(found, names, sources)
    for channel, source in sources.items():
        out.rows[channel].source = source
    used = {*names.values(), found.shaft and found.shaft.direction}
    out.unused = [n for n in found.signals if n not in used]
    return out


def _fill(out: Proposal, log: LogFile, found: Clues, chosen: dict[str, Choice]) -> None:
    """A row for each chosen channel that is likely or needed, its sign and scale; questions of who is who."""
    needed = {"position", "pressure_difference", "pressure_1", "pressure_2"}
    needed.add("pump_angle" if "pump_angle" in chosen else "pump_speed")
    for channel in [c for c in chosen if c not in needed and chosen[c].confidence < LIKELY]:
        name = chosen.pop(channel).signal
        out.notes.append(f"{name} may be {channel}; left out, say --set {channel}=… if it is")
    signs, told = signs_of(found, chosen)
    out.notes += told
    speed, shaft = chosen["pump_speed"].signal if "pump_speed" in chosen else None, found.shaft
    for channel in (c for c in CHANNELS if c in chosen):
        choice = chosen[channel]
        scaled = scale_of(found, speed, channel, choice.signal)
        if shaft is not None and shaft.signal == choice.signal and shaft.direction is not None:
            valve = found.signals[shaft.direction]
            scaled["sign_of"] = valve.field if valve.topic is not None else _short(log, valve)
            out.notes.append(f"the pump turns one way: {valve.name} has the sign of its direction")
        reasons = found.reasons.get((choice.signal, channel), ["nothing else fits better"])
        source = _source(log, found.signals[choice.signal], **scaled, sign=signs.get(channel, 1))
        out.rows[channel] = Proposed(source, choice.confidence, "; ".join(reasons[:3]))
        if choice.confidence < SURE and channel in needed and choice.other is not None:
            other = _source(log, found.signals[choice.other], **scale_of(found, speed, channel, choice.other))
            text = f"Which signal is {channel} ({CHANNELS[channel].meaning})?"
            options = {choice.signal: {channel: source}, choice.other: {channel: other}}
            out.questions.append(Question(channel, text, options, f"--set {channel}={choice.signal}"))


def _source(log: LogFile, signal: Signal, **more: object) -> ChannelSource:
    place = {"column": _short(log, signal)}
    if signal.topic is not None:
        place = {"topic": signal.topic, "field": str(signal.field)}
    return ChannelSource.model_validate({**place, **more})


def _short(log: LogFile, signal: Signal) -> str:
    """The last part of a signal's path where it alone ends so."""
    last = path_parts(signal.name)[1]
    alone = sum(n == last or n.endswith(f"/{last}") for n in log.signals) == 1
    return last if alone and last else signal.name


def balance_words(samples: Samples) -> list[str]:
    """Whether position, pump and pressures of a log fit together as a cylinder's do, one sentence each."""
    columns = {n: samples[n] for n in ("position", "pump_angle", "pump_speed") if n in samples}
    data, rate = Signals(samples.time, columns), "pump_speed" in columns
    pump, words = "pump_speed" if rate else "pump_angle", []
    if float(np.nanmax(columns["position"]) - np.nanmin(columns["position"])) == 0.0:
        return ["the cylinder stands still in this log: nothing shows whether the map is right"]
    if rate:
        along, ratio = data.follows("position", pump), 1e3 * data.gain("position", pump)[0]
        verdict = "as it should" if along > 0.8 else "which is not how a pump moves a cylinder"
        moves = f"the piston moves {ratio:.3g} mm a radian of the pump (correlation {along:.2f})"
        words.append(f"{moves}, {verdict}")
    turned = data.sums(pump) if rate else data.changes(pump)
    t = data.rises_with_pumping(samples["pressure_difference"], "position", turned)
    if abs(t) > 5.0:
        verdict = "as it should" if t > 0 else "so chambers or signs are the wrong way round"
        words.append(f"pumping {'raises' if t > 0 else 'lowers'} P1 - P2 (t = {t:.0f}), {verdict}")
    else:
        words.append("this log does not show which chamber the pump fills")
    return words
