"""What an actuator is for: loads, speeds and limits, from which `fdd.data_sheet.sizing` sizes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fdd.data_sheet.answers import Answers, read_answers
from fdd.data_sheet.questions import QUESTIONS, questions_of

NEEDED = ("stroke", "rated_pressure", "max_speed")
"""Of the data sheet's keys, those that a duty has to say; it may give the others too, as chosen."""

DUTY = {
    **questions_of("duty"),
    **{k: q if k in NEEDED else replace(q, assumed="as sized") for k, q in QUESTIONS.items()},
}
"""The keys of a duty file. Its oil is at 40 °C when the volumes are counted, as a data sheet's leakage is."""


def read_duty(path: str | Path) -> Answers:
    """Read a duty file: flat YAML or JSON, ``load: 62.28 kN`` and so on.

    Raises
    ------
    InputError : no such file, not flat, an unknown or missing key, or a figure that cannot be.
    """
    return read_answers(path, DUTY, "duty file")
