"""What a base profile asks of a data sheet, and what a duty is sized by: names, units and ranges."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

from fdd.measures import measure
from fdd.yaml_reading import yaml_mapping

FILE = "questions.yaml"


@dataclass(frozen=True)
class Question:
    """One number of a data sheet or a duty; what each field means stands in ``questions.yaml``."""

    key: str
    words: str
    unit: str
    low: float
    high: float
    spread: float | None = None
    assumed: str | None = None
    also: str | None = None
    path: str | None = None

    @property
    def dimensions(self) -> tuple[str, ...]:
        """What the answer may measure."""
        return tuple(measure(u).dimension for u in (self.unit, self.also) if u is not None)


def questions_of(part: str) -> dict[str, Question]:
    """The questions of ``data_sheet`` or of ``duty``, by key, in the order in which they are asked."""
    text = (resources.files("fdd.data_sheet") / FILE).read_text("utf-8")
    questions = {}
    for key, given in yaml_mapping(text, FILE, "questionnaire")[part].items():
        low, high = map(float, given.pop("range"))
        questions[key] = Question(key, low=low, high=high, **given)
    return questions


QUESTIONS = questions_of("data_sheet")
