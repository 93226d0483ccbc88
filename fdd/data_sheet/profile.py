"""What a base profile asks of a data sheet, the answers, and the profile that they make.

Answers are ``key: value with unit``, of a file or typed. What the sheet does not say is assumed, and says so.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from fdd.bounds import LONGEST_NAME, MAX_ANSWER_BYTES
from fdd.errors import InputError
from fdd.measures import MEASURES, measure
from fdd.unit import UNIT_SCHEMA, Unit
from fdd.yaml_reading import yaml_mapping, yaml_of, yaml_text

KIND, MEND = "file of answers", "give a YAML or JSON file with one answer a line"
_NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")

LINES_SHARE = 4.0 / 3.0
"""Volume with lines over what the piston sweeps from mid-stroke."""
SLIDING_SHARE, VISCOUS_SHARE = 0.6, 0.3
"""Of the static friction: Coulomb; of the Coulomb friction: viscous at the piston's largest speed."""
CASE_SHARE = 0.15
REFERENCE_TEMPERATURE = 40.0
"""°C, of leakage, viscosity and volumes."""
DRAG_SHARE = 0.03
"""Of the torque at rated pressure: the shaft's own drag at the largest speed, as in the thesis."""
PRESSURE_NOISE, ACCUMULATOR_NOISE = 5e-4, 2e-4
"""Of full scale: a tenth of the half per cent that industrial transmitters promise; less at low pressure."""
SERVO = {"delay": (1e-3, "s"), "pole_1": (517.9, "1/s"), "pole_2": (242.9, "1/s"), "zero": (1762.0, "1/s")}
WINDING_TIME = 14e-3 / 1.04
"""s, inductance over resistance of the thesis's motor (Tables 4.11 and 4.21)."""


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
    """What a data sheet says: the profile's name, a description of one line, and by the questions' keys
    `values` in SI (leakage given as a flow under ``leakage_flow``), and what was `written`."""

    name: str
    description: str = ""
    values: dict[str, float] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)

    def source(self, *keys: str) -> str | None:
        """Where the first of these that was answered comes from."""
        return next((f"data sheet: {self.written[k]}" for k in keys if k in self.written), None)

    @classmethod
    def of(cls, given: Mapping[str, Any], where: str | Path = "answers") -> Answers:
        """Check and convert answers as they are typed; `where` is named in errors. An InputError names an
        unknown or missing key, or an answer that cannot be."""
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
    """Read a flat YAML or JSON file of answers; an InputError where it is none, or one cannot be."""
    path = Path(path)
    text = yaml_text(path, KIND, MAX_ANSWER_BYTES, MEND)  # JSON is YAML too
    return Answers.of(yaml_mapping(text, path, KIND, mend=MEND), path)


def parsed(question: Question, answer: object) -> tuple[str, float]:
    """Key (``leakage_flow`` of leakage given as a flow) and value, SI, of an answer as ``"26 MPa"``; a plain
    number is in the SI unit.

    Raises InputError: no number, a unit that measures something else, or outside the question's range.
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


def typed_unit(answers: Answers) -> Unit:
    """The base profile that a data sheet's answers make; for `fdd identify` to start from. Each number has
    its source, and the usual error of such sheets as its standard deviation. Raises InputError: no name."""
    v = completed(answers.values)
    profile: dict[str, Any] = {
        "schema": UNIT_SCHEMA, "name": answers.name, "axis": "axis",
        "description": answers.description or "Typed from a data sheet: a base for fdd identify.",
        "sensors": _sensors(v, answers),
    }  # fmt: skip

    def put(path: str, value: float, unit: str, source: str, spread: float | None = None) -> None:
        *sections, name = path.split(".")
        place = profile
        for section in sections:
            place = place.setdefault(section, {})
        std = {} if spread is None else {"std": spread * value}
        place[name] = {"value": value, "unit": unit, "source": source, **std}

    for q in QUESTIONS.values():
        if q.path is not None:
            put(q.path, v[q.key], q.unit, answers.source(q.key) or f"assumption: {q.assumed}", q.spread)
    leaks, breaks = QUESTIONS["leakage"], QUESTIONS["breakaway_pressure"]
    case, source = _case(v), answers.source("leakage", "leakage_flow") or f"assumption: {leaks.assumed}"
    put("pump.cross_port_leakage", v["leakage"] - 0.5 * case, leaks.unit,
        f"{source}, less half the case leakage", leaks.spread)  # fmt: skip
    for branch in ("forward", "reverse"):
        source = f"{answers.source(breaks.key)} times the mean area"
        put(f"friction.{branch}.static", v[breaks.key] * _area(v), "N", source, breaks.spread)
    for path, value, unit, why, *spread in _assumptions(v):
        put(path, value, unit, f"assumption: {why}", *spread)
    return Unit.from_yaml(yaml_of(profile), where=f"answers of {answers.name[:40]}")


def completed(values: dict[str, float]) -> dict[str, float]:
    """The answers with what they leave open, as the questions say that it is assumed (SI)."""
    v = dict(values)
    for side in ("1", "2"):
        v.setdefault(f"chamber_volume_{side}", LINES_SHARE * 0.5 * v["stroke"] * v[f"piston_area_{side}"])
    v.setdefault("relief_pressure", 1.1 * v["rated_pressure"])
    v.setdefault("rated_flow", v["pump_displacement"] * v["max_speed"])
    if "gas_volume" in v:
        v.setdefault("oil_volume", 0.5 * v["gas_volume"])
    v.setdefault("cracking_pressure", 3e4)
    v.setdefault("refeed_flow_gain", v["rated_flow"] / max(v["cracking_pressure"], 1e4))
    v.setdefault("relief_flow_gain", v["rated_flow"] / (0.1 * v["relief_pressure"]))
    v.setdefault("bulk_modulus", 1.4e9)
    v.setdefault("density", 860.0)
    # ISO 3448 grades 10 to 100 at viscosity index 100 lie on this power law within 3 % (VG 32: 5.4 mm²/s).
    v.setdefault("viscosity_100", 5.4e-6 * (v["viscosity_40"] / 32e-6) ** 0.632)
    v.setdefault("position_noise", 1e-5)
    v.setdefault("pressure_full_scale", 1.5 * v["rated_pressure"])
    if "leakage" not in v:
        v["leakage"] = v.get("leakage_flow", 0.05 * v["rated_flow"]) / v["rated_pressure"]
    return v


def _area(v: dict[str, float]) -> float:
    return 0.5 * (v["piston_area_1"] + v["piston_area_2"])


def _case(v: dict[str, float]) -> float:
    return CASE_SHARE * v["leakage"]


def _assumptions(v: dict[str, float]) -> Iterator[tuple[Any, ...]]:
    """What no sheet says: path in the profile, value, unit, why, and a relative std where one is known."""
    coulomb = SLIDING_SHARE * v["breakaway_pressure"] * _area(v)
    fastest = v["pump_displacement"] * v["max_speed"] / _area(v)
    constant, winding = v["torque_constant"], v["winding_resistance"]
    voltage = 1.2 * constant * v["max_speed"] + winding * v["current_limit"]
    drag = DRAG_SHARE * v["pump_displacement"] * v["rated_pressure"] / v["max_speed"]
    yield "cylinder.position_compliance", 1.0, "1", "hoses and walls do not give"
    yield ("pump.case_leakage", _case(v), "m^3/(s*Pa)", "15 % of the leakage leaves through the case drain",
           0.6)  # fmt: skip
    yield "oil.air_fraction", 0.003, "1", "a well bled circuit; free air at atmospheric pressure", 1.0
    yield "oil.polytropic_index", 1.4, "1", "adiabatic"
    # A sheet's modulus is that of the oil alone, which air hardly softens at such a pressure.
    yield "oil.reference_pressure", 0.5 * v["rated_pressure"], "Pa", "half the rated pressure"
    yield "oil.reference_temperature", REFERENCE_TEMPERATURE, "degC", "the sheet's leakage holds at 40 °C"
    yield "oil.thermal_expansion", 7e-4, "1/K", "mineral oil"
    yield "accumulator.case_cracking_pressure", v["cracking_pressure"], "Pa", "as the refeeding valves"
    for branch in ("friction.forward", "friction.reverse"):
        yield f"{branch}.coulomb", coulomb, "N", f"{SLIDING_SHARE:g} of the static friction", 0.4
        yield (f"{branch}.stribeck_velocity", 0.02, "m/s",
               "between the thesis's curves, 0.007 to 0.026 m/s")  # fmt: skip
        yield f"{branch}.stribeck_exponent", 1.0, "1", "a plain exponential"
        yield (f"{branch}.viscous", VISCOUS_SHARE * coulomb / fastest, "N*s/m",
               f"{VISCOUS_SHARE:g} of the Coulomb friction at the largest speed", 1.0)  # fmt: skip
    yield "friction.trial_spread", 0.09, "1", "thesis Table 5.1"
    for name, (value, unit) in SERVO.items():
        yield f"drive.{name}", value, unit, "the thesis's velocity loop, eq. 6.11"
    yield ("drive.winding_inductance", WINDING_TIME * winding, "H",
           "the electrical time constant of the thesis's motor")  # fmt: skip
    yield "drive.back_emf_constant", constant, "V*s/rad", "equal to the torque constant"
    yield "drive.voltage_limit", voltage, "V", "reaches the largest speed with a fifth to spare"
    yield ("drive.viscous_friction", drag, "N*m*s/rad",
           f"{DRAG_SHARE:.0%} of the torque at rated pressure at the largest speed")  # fmt: skip


def _sensors(v: dict[str, float], answers: Answers) -> dict[str, Any]:
    full = v["pressure_full_scale"]
    noise = "noise assumed to be a twentieth of a per cent of full scale"
    pressure = {"noise": PRESSURE_NOISE * full, "low": -101325.0, "high": full, "source": noise}
    position = answers.source("position_noise") or "assumption: 10 µm"
    return {
        "motor_current": {"noise": 2e-3 * v["current_limit"], "source": "assumption: 0.2 % of the limit"},
        "oil_temperature": {"noise": 0.1, "resolution": 0.1, "source": "assumption"},
        "position": {"noise": v["position_noise"], "source": position},
        "pressure_1": pressure,
        "pressure_2": pressure,
        "pressure_accumulator": {"noise": ACCUMULATOR_NOISE * full, "source": "assumption"},
        "pressure_difference": {**pressure, "low": -full},
    }
