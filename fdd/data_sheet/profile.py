"""From a data sheet's answers to a base profile; what the sheet does not say is assumed, and says so."""

from __future__ import annotations

from typing import Any

from fdd.data_sheet.answers import Answers
from fdd.data_sheet.questions import QUESTIONS
from fdd.unit import UNIT_SCHEMA, Unit
from fdd.yaml_reading import yaml_of

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
SERVO = {"delay": 1e-3, "pole_1": 517.9, "pole_2": 242.9, "zero": 1762.0}
WINDING_TIME = 14e-3 / 1.04
"""s, inductance over resistance of the thesis's motor (Tables 4.11 and 4.21)."""


def typed_unit(answers: Answers) -> Unit:
    """The base profile that a data sheet's answers make; for `fdd identify` to start from.

    Parameters
    ----------
    answers : with every needed key, SI.

    Returns
    -------
    Unit : each number with its source, and the usual error of such sheets as its standard deviation.

    Raises
    ------
    InputError : the name is none.
    """
    v = completed(answers.values)
    sections = {
        "cylinder": _cylinder, "pump": _pump, "oil": _oil, "accumulator": _circuit,
        "friction": _friction, "drive": _drive, "sensors": _sensors,
    }  # fmt: skip
    profile: dict[str, Any] = {"schema": UNIT_SCHEMA, "name": answers.name, "axis": "axis"}
    profile["description"] = answers.description or "Typed from a data sheet: a base for fdd identify."
    sheet = _Sheet(v, answers)
    for name, make in sections.items():
        profile[name] = make(sheet)
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


class _Sheet:
    """The completed numbers, each written as a profile wants it."""

    def __init__(self, values: dict[str, float], answers: Answers) -> None:
        self.values = values
        self.answers = answers

    def __getitem__(self, key: str) -> float:
        return self.values[key]

    def of(self, key: str, unit: str | None = None) -> dict[str, Any]:
        """What the sheet says, or what is assumed in its place."""
        question = QUESTIONS[key]
        source = self.answers.source(key) or f"assumption: {question.assumed}"
        return _number(self.values[key], unit or question.unit, source, question.spread)


def _number(value: float, unit: str, source: str, spread: float | None = None) -> dict[str, Any]:
    out: dict[str, Any] = {"value": value, "unit": unit, "source": source}
    return out if spread is None else {**out, "std": spread * value}


def _assumed(value: float, unit: str, why: str, spread: float | None = None) -> dict[str, Any]:
    return _number(value, unit, f"assumption: {why}", spread)


def _cylinder(s: _Sheet) -> dict[str, Any]:
    return {
        "area_1": s.of("piston_area_1"),
        "area_2": s.of("piston_area_2"),
        "stroke": s.of("stroke"),
        "moving_mass": s.of("moving_mass"),
        "volume_1": s.of("chamber_volume_1"),
        "volume_2": s.of("chamber_volume_2"),
        "position_compliance": _assumed(1.0, "1", "hoses and walls do not give"),
    }


def _pump(s: _Sheet) -> dict[str, Any]:
    total, spread = s["leakage"], QUESTIONS["leakage"].spread
    source = s.answers.source("leakage", "leakage_flow") or f"assumption: {QUESTIONS['leakage'].assumed}"
    case = CASE_SHARE * total
    return {
        "displacement": s.of("pump_displacement"),
        "cross_port_leakage": _number(
            total - 0.5 * case, "m^3/(s*Pa)", f"{source}, less half the case leakage", spread
        ),
        "case_leakage": _assumed(
            case, "m^3/(s*Pa)", "15 % of the leakage leaves through the case drain", 0.6
        ),
    }


def _oil(s: _Sheet) -> dict[str, Any]:
    return {
        "bulk_modulus": s.of("bulk_modulus"),
        "air_fraction": _assumed(0.003, "1", "a well bled circuit; free air at atmospheric pressure", 1.0),
        "polytropic_index": _assumed(1.4, "1", "adiabatic"),
        # A sheet's modulus is that of the oil alone, which air hardly softens at such a pressure.
        "reference_pressure": _assumed(0.5 * s["rated_pressure"], "Pa", "half the rated pressure"),
        "density": s.of("density"),
        "viscosity_40": s.of("viscosity_40"),
        "viscosity_100": s.of("viscosity_100"),
        "reference_temperature": _assumed(
            REFERENCE_TEMPERATURE, "degC", "the sheet's leakage holds at 40 °C"
        ),
        "thermal_expansion": _assumed(7e-4, "1/K", "mineral oil"),
    }


def _circuit(s: _Sheet) -> dict[str, Any]:
    return {
        "charge_pressure": s.of("charge_pressure"),
        "gas_volume": s.of("gas_volume"),
        "oil_volume": s.of("oil_volume"),
        "refeed_cracking_pressure": s.of("cracking_pressure"),
        "refeed_flow_gain": s.of("refeed_flow_gain"),
        "case_cracking_pressure": _assumed(s["cracking_pressure"], "Pa", "as the refeeding valves"),
        "relief_pressure": s.of("relief_pressure"),
        "relief_flow_gain": s.of("relief_flow_gain"),
    }


def _friction(s: _Sheet) -> dict[str, Any]:
    area = 0.5 * (s["piston_area_1"] + s["piston_area_2"])
    static = s["breakaway_pressure"] * area
    coulomb = SLIDING_SHARE * static
    fastest = s["pump_displacement"] * s["max_speed"] / area
    source = s.answers.source("breakaway_pressure")
    branch = {
        "coulomb": _assumed(coulomb, "N", f"{SLIDING_SHARE:g} of the static friction", 0.4),
        "static": _number(
            static, "N", f"{source} times the mean area", QUESTIONS["breakaway_pressure"].spread
        ),
        "stribeck_velocity": _assumed(0.02, "m/s", "between the thesis's curves, 0.007 to 0.026 m/s"),
        "stribeck_exponent": _assumed(1.0, "1", "a plain exponential"),
        "viscous": _assumed(
            VISCOUS_SHARE * coulomb / fastest,
            "N*s/m",
            f"{VISCOUS_SHARE:g} of the Coulomb friction at the largest speed",
            1.0,
        ),
    }
    spread = _assumed(0.09, "1", "thesis Table 5.1")
    return {"forward": branch, "reverse": dict(branch), "trial_spread": spread}


def _drive(s: _Sheet) -> dict[str, Any]:
    voltage = 1.2 * s["torque_constant"] * s["max_speed"] + s["winding_resistance"] * s["current_limit"]
    drag = DRAG_SHARE * s["pump_displacement"] * s["rated_pressure"] / s["max_speed"]
    servo = "the thesis's velocity loop, eq. 6.11"
    return {
        "max_speed": s.of("max_speed"),
        "delay": _assumed(SERVO["delay"], "s", servo),
        **{name: _assumed(SERVO[name], "1/s", servo) for name in ("pole_1", "pole_2", "zero")},
        "torque_constant": s.of("torque_constant"),
        "winding_resistance": s.of("winding_resistance"),
        "winding_inductance": _assumed(
            WINDING_TIME * s["winding_resistance"], "H", "the electrical time constant of the thesis's motor"
        ),
        "back_emf_constant": _assumed(s["torque_constant"], "V*s/rad", "equal to the torque constant"),
        "voltage_limit": _assumed(voltage, "V", "reaches the largest speed with a fifth to spare"),
        "inertia": s.of("inertia"),
        "viscous_friction": _assumed(
            drag, "N*m*s/rad", f"{DRAG_SHARE:.0%} of the torque at rated pressure at the largest speed"
        ),
        "current_limit": s.of("current_limit"),
    }


def _sensors(s: _Sheet) -> dict[str, Any]:
    full = s["pressure_full_scale"]
    noise = "noise assumed to be a twentieth of a per cent of full scale"
    pressure = {"noise": PRESSURE_NOISE * full, "low": -101325.0, "high": full, "source": noise}
    return {
        "motor_current": {"noise": 2e-3 * s["current_limit"], "source": "assumption: 0.2 % of the limit"},
        "oil_temperature": {"noise": 0.1, "resolution": 0.1, "source": "assumption"},
        "position": {
            "noise": s["position_noise"],
            "source": s.answers.source("position_noise") or "assumption: 10 µm",
        },
        "pressure_1": pressure,
        "pressure_2": pressure,
        "pressure_accumulator": {"noise": ACCUMULATOR_NOISE * full, "source": "assumption"},
        "pressure_difference": {**pressure, "low": -full},
    }
