"""What a signal is by its name and unit: words to concepts, concepts to channels."""

from __future__ import annotations

import re
import unicodedata
from functools import cache
from importlib import resources
from typing import NamedTuple

import yaml

from fdd.logs.formats import Signal
from fdd.logs.formats.trees import bare_name, path_parts, unit_in_name
from fdd.measures import find_measure
from fdd.samples import CHANNELS

_UNIT_CONCEPTS = {
    "pressure": "pressure", "angular_speed": "speed", "angle": "angle", "length": "position",
    "current": "current", "temperature": "temperature", "force": "force", "voltage": "voltage",
    "time": "time",
}  # fmt: skip


class Rule(NamedTuple):
    """What a channel's name has to say: all of one of `needs`, none of `never`; `helps` makes it surer."""

    needs: tuple[frozenset[str], ...]
    helps: frozenset[str]
    never: frozenset[str]


def _rule(needs: str, helps: str = "", never: str = "") -> Rule:
    all_of = tuple(frozenset(one.split("+")) for one in needs.split())
    return Rule(all_of, frozenset(helps.split()), frozenset(never.split()))


_NO_CHAMBER = "command accumulator difference temperature elsewhere"
RULES: dict[str, Rule] = {
    "time": _rule("time", never="temperature oil"),
    "command": _rule(
        "command+speed command+pump command+voltage command pump+voltage",
        "speed pump voltage", "position pressure measured current temperature",
    ),
    "position_setpoint": _rule("command+position", "", "speed pump pressure current"),
    "pump_speed": _rule("speed+pump speed", "measured", "command position pressure current temperature flow"),
    "pump_angle": _rule(
        "angle+pump angle pump+position", "measured",
        "command speed pressure temperature current force flow",
    ),
    "position": _rule("position", "measured", "command speed pump pressure current temperature angle force"),
    "pressure_difference": _rule("pressure+difference", "", "command accumulator temperature flow elsewhere"),
    "pressure_1": _rule("pressure+chamber_1", "measured", _NO_CHAMBER),
    "pressure_2": _rule("pressure+chamber_2", "measured", _NO_CHAMBER),
    "pressure_accumulator": _rule("pressure+accumulator accumulator", "measured", "command speed elsewhere"),
    "motor_current": _rule("current+pump current", "measured", "command temperature pressure"),
    "oil_temperature": _rule(
        "temperature+oil temperature", "measured", "pump pressure command current elsewhere",
    ),
    "load_force": _rule("force", "measured", "command pressure temperature speed"),
}  # fmt: skip
_GREEK = {
    chr(code): f" {name.split()[-1].lower()} "
    for code in range(0x391, 0x3CA)
    if "LETTER" in (name := unicodedata.name(chr(code), ""))
}
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "ae", "Ö": "oe", "Ü": "ue", "ß": "ss"})
_SMALL = {"ai", "am", "an", "ao", "as", "at", "by", "di", "of", "on", "to", "zu"}
"""Words and kinds of inputs, which are no compounds of letters, as PA is."""
_RAW = {
    **dict.fromkeys(("v", "mv", "volt", "volts"), "voltage"),
    **dict.fromkeys(("%", "counts", "count", "lsb", "digits"), "number"),
}
"""Dimensions of a sensor's or a demand's raw signal, which a scale makes a channel of."""


@cache
def _meanings() -> dict[str, set[str]]:
    """Words, plain, and the concepts that each may stand for."""
    text = resources.files("fdd.logs.mapping").joinpath("words.yaml").read_text(encoding="utf-8")
    found: dict[str, set[str]] = {}
    for concept, words in yaml.safe_load(text).items():
        for word in words:
            found.setdefault(_plain(word), set()).add(concept)
    return found


def concepts(name: str) -> set[str]:
    """The concepts of all words in a name."""
    return {concept for word in taken_apart(name) for concept in _meanings().get(word, ())}


def taken_apart(name: str) -> list[str]:
    """The words of a name; what is in no list stays as it is.

    Examples
    --------
    >>> [taken_apart(name) for name in ("PrExt", "pumpspeed", "p_1", "Δp")]
    [['pr', 'ext'], ['pump', 'speed'], ['p', '1'], ['delta', 'p']]
    """
    name = "".join(_GREEK.get(letter, letter) for letter in name)
    spaced = re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    spaced = re.sub(r"(?<=[A-Za-z])(?=\d)|(?<=\d)(?=[A-Za-z])", " ", spaced)
    return [part for word in re.findall(r"[a-z0-9]+", _plain(spaced)) for part in _parts(word)]


def _parts(word: str) -> list[str]:
    """A word, or the fewest known words that make it up, none inside of fewer than three letters."""
    known = _meanings()
    if word in known or word in _SMALL:
        return [word]
    best: list[list[str] | None] = [[]]
    for end in range(1, len(word) + 1):
        ways = (
            [*before, word[start:end]]
            for start in range(max(0, end - 20), end)
            if (before := best[start]) is not None
            and word[start:end] in known
            and (start == 0 or end == len(word) or end - start >= 3)
        )
        best.append(min(ways, key=len, default=None))
    whole = best[-1]
    return whole if whole is not None and len(whole) <= max(2, len(word) // 3) else [word]


def _plain(text: str) -> str:
    """Small letters without accents; German's umlauts as two letters."""
    text = text.translate(_UMLAUTS)
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()


def dimension_of(unit: str | None) -> str | None:
    """What a unit measures, of the dimensions that channels have; None where it says nothing."""
    if unit is None or not unit.strip("-? []()"):
        return None
    if (dimension := _RAW.get(unit.strip().lower())) is not None:
        return dimension
    return next((d for d in _UNIT_CONCEPTS if find_measure(unit, d) is not None), None)


def said_and_unit(signal: Signal) -> tuple[set[str], str | None]:
    """The concepts of a signal's own words, and its unit: the file's, or else the one that ends its name.

    One letter behind a name is a unit only where the name does not measure something else: ``i_A`` is in
    ampere, ``p_A`` is the pressure at port A.

    Examples
    --------
    >>> said_and_unit(Signal("i_A")), said_and_unit(Signal("p_A"))[1]
    (({'current'}, 'A'), None)
    """
    before, own = path_parts(signal.name)
    own = signal.field if signal.field is not None else own
    context = path_parts(signal.topic or before)[1]
    file_unit = signal.unit if dimension_of(signal.unit) is not None else None
    bare, unit, last = bare_name(own), unit_in_name(own), own.rsplit(".", 1)[-1]
    rest = own[: len(bare)] if own.lower().startswith(bare) else bare
    # A unit stands behind something: pA by itself, in any letters, is a port's pressure.
    behind = (bool(context) or last != own) and not concepts(last) & {"chamber_1", "chamber_2"}
    if behind and file_unit is None and unit is None and len(last) > 1 and dimension_of(last) is not None:
        rest, unit = context, last
    if unit is not None:
        measured = concepts(rest) & set(_UNIT_CONCEPTS.values())
        means = _UNIT_CONCEPTS.get(dimension_of(unit) or "")
        letter = len(unit) == 1 and not own.rstrip().endswith(("]", ")"))
        if means is None or (letter and measured and means not in measured and means != "voltage"):
            rest, unit = own, None
    said = concepts(rest)
    means = _UNIT_CONCEPTS.get(dimension_of(file_unit or unit) or "")
    heard = said | ({means} if means else set())
    if len(rest) == 1 or not said or not any(n <= heard for rule in RULES.values() for n in rule.needs):
        said |= concepts(context) - {"command"}  # e.g. the pressure of the folder accumulator
    return said, file_unit or unit


def name_scores(signal: Signal) -> dict[str, float]:
    """Evidence in nats that the signal is each of the channels that its name and unit allow, by channel."""
    said, unit = said_and_unit(signal)
    own, dimension = signal.field or path_parts(signal.name)[1], dimension_of(unit)
    if own in CHANNELS and dimension in (None, CHANNELS[own].dimension):
        return {own: 10.0}
    heard = said | ({_UNIT_CONCEPTS[dimension]} if dimension in _UNIT_CONCEPTS else set())
    out: dict[str, float] = {}
    for channel, rule in RULES.items():
        raw = dimension in _RAW.values() and channel != "time"
        if dimension not in (None, CHANNELS[channel].dimension) and not raw:
            continue
        score = 0.0 if dimension is None or raw else 1.0
        if met := [len(need & said) for need in rule.needs if need <= heard]:
            # The thing and whose it is, e.g. the oil's temperature, are worth more than each by itself.
            score += 2.0 + max(met) + (max(met) > 1) + 0.5 * len(rule.helps & said)
        out[channel] = score - 2.0 * len(rule.never & said) - (1.0 if raw and channel != "command" else 0.0)
    return out
