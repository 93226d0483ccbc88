"""What an actuator is for: loads, speeds and limits, from which `fdd.data_sheet.sizing` sizes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fdd.data_sheet.answers import Answers, read_answers
from fdd.data_sheet.questions import QUESTIONS, Question

NEEDED = ("stroke", "rated_pressure", "max_speed")
"""Of the data sheet's keys, those that a duty has to say; it may give the others too, as chosen."""

DUTY: dict[str, Question] = {
    q.key: q
    for q in (
        Question("load", "Largest load that is moved, of all circuits", "N", 10.0, 1e7),
        Question("loaded_speed", "Largest speed at that load", "m/s", 1e-3, 5.0),
        Question(
            "no_load_speed", "Largest speed without load", "m/s", 1e-3, 5.0, assumed="what the pump gives"
        ),
        Question("stall_load", "Largest load that is held", "N", 10.0, 1e7, assumed="no more than is moved"),
        Question("circuits", "Circuits that share the load", "1", 1.0, 4.0, assumed="1"),
        Question("power", "Output power of all circuits", "W", 1.0, 1e6, assumed="load times its speed"),
        Question("bore", "Bore that is chosen", "m", 5e-3, 1.0, assumed="as sized"),
        Question("rod_diameter", "Diameter of the rod that is chosen", "m", 1e-3, 0.9, assumed="as sized"),
        Question("yield_strength", "Of the rod", "Pa", 5e7, 3e9, assumed="963 MPa, 15-5PH steel"),
        Question("safety_factor", "Yield strength over the rod's stress", "1", 1.0, 20.0, assumed="6"),
        Question("coldest", "Coldest oil", "degC", -60.0, 40.0, assumed="10 degC"),
        Question("hottest", "Hottest oil", "degC", 40.0, 150.0, assumed="70 degC"),
        *(q if q.key in NEEDED else replace(q, assumed="as sized") for q in QUESTIONS.values()),
    )
}
"""The keys of a duty file. Its oil is at 40 °C when the volumes are counted, as a data sheet's leakage is."""


def read_duty(path: str | Path) -> Answers:
    """Read a duty file: flat YAML or JSON, ``load: 62.28 kN`` and so on.

    Raises
    ------
    InputError : no such file, not flat, an unknown or missing key, or a figure that cannot be.

    Examples
    --------
    >>> read_duty("none.yaml")
    Traceback (most recent call last):
    ...
    fdd.errors.InputError: none.yaml: no such duty file; give a YAML or JSON file with one answer a line
    """
    return read_answers(path, DUTY, "duty file")
