"""What a base profile asks of a data sheet, and the answers: ``key: value with unit``, of a file or typed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from fdd.bounds import LONGEST_NAME, MAX_ANSWER_BYTES
from fdd.errors import InputError
from fdd.measures import MEASURES, measure
from fdd.yaml_reading import yaml_mapping, yaml_text

KIND, MEND = "file of answers", "give a YAML or JSON file with one answer a line"
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")


@dataclass(frozen=True)
class Question:
    """One number of a data sheet; what each field means stands in ``questions.yaml``."""

    key: str
    words: str
    unit: str
    low: float
    high: float
    spread: float | None = None
    assumed: str | None = None
    also: str | None = None
    path: str | None = None


def _questions() -> dict[str, Question]:
    file = resources.files("fdd.data_sheet") / "questions.yaml"
    questions = {}
    for key, given in yaml_mapping(file.read_text("utf-8"), file.name, "questionnaire")["data_sheet"].items():
        low, high = map(float, given.pop("range"))
        questions[key] = Question(key, low=low, high=high, **given)
    return questions


QUESTIONS = _questions()
"""By key, in the order in which they are asked."""


@dataclass(frozen=True)
class Answers:
    """What a data sheet says.

    Attributes
    ----------
    name : of the profile. description : one line, may be empty.
    values : question's key to its value in SI. Leakage given as a flow stands under ``leakage_flow``.
    written : the same as it was typed, for the profile's sources.
    """

    name: str
    description: str = ""
    values: dict[str, float] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)

    def source(self, *keys: str) -> str | None:
        """Where the first of these that was answered comes from."""
        return next((f"data sheet: {self.written[k]}" for k in keys if k in self.written), None)

    @classmethod
    def of(cls, given: Mapping[str, Any], where: str | Path = "answers") -> Answers:
        """Check and convert answers as they are typed; `where` is named in errors.

        Raises InputError: an unknown or missing key, or an answer that cannot be; one line names it.

        Examples
        --------
        >>> Answers.of({"name": "rig", "stroke": "64 mm"})
        Traceback (most recent call last):
        ...
        fdd.errors.InputError: answers: missing: piston_area_1 (m^2); write e.g. 'piston_area_1: 1 m^2'
        """
        known = ("name", "description", *QUESTIONS)
        for key in given:
            if key not in known:
                mend = f"the keys are: {', '.join(known)}"
                raise InputError(f"unknown key {key!r}", where=where, mend=mend)
        if not isinstance(given.get("name"), str) or not given["name"].strip():
            raise InputError("missing: name", where=where, mend="write e.g. 'name: press 3'")
        out = cls(given["name"].strip(), str(given.get("description") or ""))
        for question in QUESTIONS.values():
            answer = given.get(question.key)
            if answer is not None:
                try:
                    key, value = parsed(question, answer)
                except InputError as error:
                    raise error.at(where) from None
                out.values[key], out.written[key] = value, str(answer).strip()
            elif question.assumed is None:
                mend = f"write e.g. '{question.key}: 1 {question.unit}'"
                raise InputError(f"missing: {question.key} ({question.unit})", where=where, mend=mend)
        return out


def read_answers(path: str | Path) -> Answers:
    """Read a flat YAML or JSON file of answers.

    Raises InputError: no such file, not flat, or an answer that cannot be.

    Examples
    --------
    >>> read_answers("none.yaml")
    Traceback (most recent call last):
    ...
    fdd.errors.InputError: none.yaml: no such file of answers; give a YAML or JSON file with one answer a line
    """
    path = Path(path)
    text = yaml_text(path, KIND, MAX_ANSWER_BYTES, MEND)  # JSON is YAML too
    return Answers.of(yaml_mapping(text, path, KIND, mend=MEND), path)


def parsed(question: Question, answer: object) -> tuple[str, float]:
    """Key (``leakage_flow`` of leakage given as a flow) and value, SI, of an answer as ``"26 MPa"``; a plain
    number is in the SI unit.

    Raises InputError: no number, a unit that measures something else, or outside the question's range.

    Examples
    --------
    >>> parsed(QUESTIONS["rated_pressure"], "26 MPa")
    ('rated_pressure', 26000000.0)
    >>> parsed(QUESTIONS["stroke"], 64)
    Traceback (most recent call last):
    ...
    fdd.errors.InputError: stroke: 64 m is not between 0.005 and 5 m; did you mean 64 cm or 64 mm or 64 in?
    """
    text = str(answer)
    found = None if isinstance(answer, bool) or len(text) > LONGEST_NAME else _NUMBER.match(text)
    if found is None:
        mend = f"write e.g. '1.5 {question.unit}', with a decimal point"
        raise InputError(f"{text[:40]!r} is no number with a unit", where=question.key, mend=mend)
    number, unit = float(found[1]), found[2] or question.unit
    allowed = [measure(u).dimension for u in (question.unit, question.also) if u is not None]
    measured = MEASURES.get(unit)
    if measured is None or measured.dimension not in allowed:
        try:  # units that the table lacks, as N/mm^2
            measured = measure(unit, allowed[0])
        except InputError as error:
            raise error.at(question.key) from None
    value = measured.factor * number + measured.offset
    if measured.dimension != allowed[0]:
        return f"{question.key}_flow", value
    low, high = question.low, question.high
    if low <= value <= high:
        return question.key, value
    fitting: dict[float, str] = {}  # units in which the number would do: bar given as Pa, and the like
    for name, m in MEASURES.items():
        other = m.dimension == allowed[0] and name not in ("", unit)
        if other and low <= m.factor * number + m.offset <= high:
            fitting.setdefault(m.factor, f"{number:g} {name}")
    mend = f"did you mean {' or '.join(fitting.values())}?" if fitting else "correct it"
    problem = f"{number:g} {unit} is not between {low:g} and {high:g} {question.unit}"
    raise InputError(problem, where=question.key, mend=mend)
