"""An actuator sized from its duty, by the thesis's section 4.4: cylinder, pump, motor, valves, accumulator.

Each quantity is calculated first; where the duty says what was chosen from a catalogue under its data
sheet's key, that replaces it, as the thesis does. What comes out are a data sheet's answers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from fdd.data_sheet.accumulator import accumulator_volumes
from fdd.data_sheet.answers import Answers
from fdd.data_sheet.efficiency import volumetric_efficiency
from fdd.data_sheet.plausibility import Remark
from fdd.data_sheet.profile import REFERENCE_TEMPERATURE, completed
from fdd.data_sheet.questions import QUESTIONS
from fdd.errors import InputError
from fdd.measures import measure

ANSWERED = {*QUESTIONS, "leakage_flow"}
YIELD_PA, SAFETY = 963e6, 6.0
"""Annealed 15-5PH steel (thesis Table 4.3), burst pressure over operating pressure (section 4.4)."""
LEAKING = 0.15
"""Of the pump's flow at rated pressure and largest speed (thesis section 4.4)."""
PORT_M_S = 1.22
"""Largest oil speed in a pump's inlet (thesis eq. 4.9)."""
CRACKING_PA, REFEEDING_PA = 7e3, 1e4
"""Of the anti-cavitation valves: cracking, and resistance at full flow (thesis section 4.4)."""
CHARGE_PA = 4.82e5
SPEED_SHORT = 0.95
"""Of the wanted speed that the pump must reach: the thesis's own catalogue pump reaches 0.985 of it."""
BACK_EMF_V, STALL_SHARE, COPPER_SHARE, INERTIA_S2 = 308.0, 1.8, 0.01, 2e-4
"""The thesis's motors: back EMF at the largest speed (Table 4.11, 0.98 V·s/rad at 3000 rpm); stall torque
over that of the relief setting (Table 4.4: 16.1 N·m over 9.06 N·m); copper loss at stall over stall torque
times speed (Table 4.11: 25.7 of 2513 W); kg·m² of rotor per N·m of stall torque (2.1e-4 and 1.9e-4)."""
STATIC_N, STATIC_BORE_M = 476.0, 0.0508
"""Mean static friction of Table 5.1, and the bore that it was measured on."""
STEEL_KG_M3, ROD_STROKES = 7780.0, 3.0
"""Table 4.3; strokes of rod that weigh what the prototype's piston does: 3.7 kg at 0.3 m, 25.4 mm."""


@dataclass(frozen=True)
class Sized:
    """One quantity: `value` in SI, `unit` to show it in, and the equation or choice that it comes from."""

    quantity: str
    value: float
    unit: str
    source: str

    @property
    def shown(self) -> float:
        """The value in `unit`."""
        return self.value / measure(self.unit).factor


def sized(duty: Answers) -> Sizing:
    """Size one circuit of an actuator, from what `fdd.data_sheet.duty.read_duty` reads.

    Raises
    ------
    InputError : what is asked for cannot be reached with what was chosen.

    Examples
    --------
    >>> from fdd.data_sheet.duty import DUTY
    >>> text = {"name": "lift", "load": "10 kN", "loaded_speed": "0.1 m/s", "stroke": "0.2 m"}
    >>> more = {"rated_pressure": "10 MPa", "max_speed": "3000 rpm"}
    >>> found = sized(Answers.of({**text, **more}, questions=DUTY))
    >>> [f"{r.shown:.4g} {r.unit}" for r in found.rows if r.source == "thesis eq. 4.1"]
    ['10 cm^2']
    """
    d = Sizing(duty)
    _cylinder(d)
    _pump(d)
    _motor(d)
    _valves(d)
    _accumulator(d)
    return d


class Sizing:
    """What a duty asks for, as far as it is known.

    Attributes
    ----------
    answers : as a data sheet would give them, for `fdd.data_sheet.typed_unit`; of one circuit.
    rows : what was sized, in the order of the calculation. remarks : where the duty is just missed.
    """

    def __init__(self, duty: Answers) -> None:
        self.duty = duty.values
        given = [k for k in duty.values if k in ANSWERED]
        self.values = {k: duty.values[k] for k in given}
        self.written = {k: f"duty, {duty.written[k]}" for k in given}
        description = duty.description or "Sized from its duty: a base for fdd identify."
        self.answers = Answers(duty.name, description, self.values, self.written, "sizing")
        self.rows: list[Sized] = []
        self.remarks: list[Remark] = []
        self.circuits = self.duty.get("circuits", 1.0)
        if self.circuits != int(self.circuits):
            raise InputError(f"{self.circuits:g} is no whole number", where="circuits", mend="write e.g. 2")
        self.load = self.duty["load"] / self.circuits
        self.bore = 0.0

    def __getitem__(self, key: str) -> float:
        return self.values[key]

    def row(self, quantity: str, value: float, unit: str, source: str) -> float:
        """Show a quantity; gives its value."""
        self.rows.append(Sized(quantity, value, unit, source))
        return value

    def take(self, key: str, quantity: str, value: float, unit: str, source: str) -> float:
        """What was chosen, or else what was calculated; both are shown."""
        self.row(quantity, value, unit, source)
        if key in self.duty:
            return self.row(f"{quantity}, chosen", self.duty[key], unit, "duty")
        if key in ANSWERED:
            self.values[key], self.written[key] = value, source
        return value

    def short(self, problem: str, mend: str) -> None:
        """Remark what is just missed."""
        self.remarks.append(Remark((), problem, mend))


def _cylinder(d: Sizing) -> None:
    duty, rated = d.duty, d["rated_pressure"]
    for key in ("bore", "rod_diameter"):
        if key in duty and "piston_area_1" in duty:
            raise InputError(f"{key} and piston_area_1 are both given", mend="give one of them")
    d.row("load of one circuit", d.load, "kN", "duty")
    relief = d.take(
        "relief_pressure", "relief setting", rated, "MPa", "thesis section 4.6: the rated pressure"
    )
    needed = d.row("piston area needed", d.load / rated, "cm^2", "thesis eq. 4.1")
    stress = duty.get("yield_strength", YIELD_PA) / duty.get("safety_factor", SAFETY)
    # The circuits' pistons sit on one rod: it carries the whole load.
    thinnest = math.sqrt(4.0 * duty["load"] / stress / math.pi)
    rod = d.take("rod_diameter", "rod diameter", thinnest, "mm", "thesis eqs 4.1 and 4.3")
    if rod < 0.999 * thinnest:
        raise InputError(
            f"{1e3 * rod:.3g} mm is too thin, the load needs {1e3 * thinnest:.3g} mm",
            where="rod_diameter",
            mend="choose a thicker rod, or another yield_strength or safety_factor",
        )
    d.bore = math.sqrt(4.0 * duty.get("piston_area_1", needed) / math.pi + rod**2)
    d.bore = d.take("bore", "bore", d.bore, "mm", "thesis eq. 4.5")
    if d.bore <= rod:
        raise InputError(
            f"{1e3 * d.bore:.3g} mm is not more than the rod's {1e3 * rod:.3g} mm",
            where="bore",
            mend="choose a larger bore",
        )
    area = 0.25 * math.pi * (d.bore**2 - rod**2)
    area = d.take("piston_area_1", "piston area", area, "cm^2", "thesis eq. 4.4")
    smaller = min(area, duty.get("piston_area_2", area))
    d.take("piston_area_2", "piston area, side 2", area, "cm^2", "thesis eq. 4.4: rods on both sides")
    for key in ("load", "stall_load"):
        wanted, carried = duty.get(key, 0.0) / d.circuits, relief * smaller
        if wanted > 1.001 * carried:
            raise InputError(
                f"out of reach: the relief setting carries {1e-3 * carried:.4g} kN of the "
                f"{1e-3 * wanted:.4g} kN of one circuit",
                where=key,
                mend="raise rated_pressure, relief_pressure or the bore",
            )
    mass = STEEL_KG_M3 * 0.25 * math.pi * rod**2 * ROD_STROKES * d["stroke"]
    d.take("moving_mass", "moving mass", mass, "kg", "assumption: piston and rod alone")
    static = STATIC_N * d.bore / STATIC_BORE_M
    why = "thesis Table 5.1, in proportion to the bore"
    mean = 0.5 * (d["piston_area_1"] + d["piston_area_2"])
    d.take("breakaway_pressure", "breakaway pressure", static / mean, "kPa", why)


def _pump(d: Sizing) -> None:
    duty, speed, rated = d.duty, d["max_speed"], d["rated_pressure"]
    area = max(d["piston_area_1"], d["piston_area_2"])
    flow = d.row("flow needed", duty["loaded_speed"] * area, "L/min", "thesis eq. 4.6")
    displacement = d.take(
        "pump_displacement", "pump displacement", flow / speed, "cm^3/rev", "thesis eq. 4.7"
    )
    pumped = displacement * speed
    if "leakage" in duty:
        leaks = d.row("leakage at the rated pressure", duty["leakage"] * rated, "L/min", "duty")
    else:
        leaks = d.take(
            "leakage_flow", "leakage at the rated pressure", LEAKING * pumped, "L/min",
            "thesis section 4.4: 15 % of the pump's flow",
        )  # fmt: skip
    leakage = leaks / rated
    share = volumetric_efficiency(displacement, speed, leakage, rated)
    d.row("volumetric efficiency at the rated pressure", share, "%", "thesis eq. 5.4")
    port = math.sqrt(4.0 * pumped / (math.pi * PORT_M_S))
    d.row("port diameter, at least", port, "mm", "thesis eq. 4.9, 1.22 m/s")
    free = d.row("speed without load", pumped / area, "m/s", "thesis eq. 4.6")
    pressure = d.load / min(d["piston_area_1"], d["piston_area_2"])
    reached = (pumped - leakage * pressure) / area
    d.row("speed at the load, leakage counted", reached, "m/s", "thesis eq. 5.3")
    larger = f"choose more than {1e6 * math.tau * displacement:.3g} cm^3/rev as pump_displacement"
    if free < SPEED_SHORT * duty["loaded_speed"]:
        raise InputError(
            f"out of reach: the pump gives {free:.3g} of {duty['loaded_speed']:.3g} m/s without leakage",
            where="loaded_speed",
            mend="choose a larger pump_displacement or max_speed",
        )
    if reached < 0.999 * duty["loaded_speed"]:
        lost = f"at the load the piston reaches {reached:.3g} of {duty['loaded_speed']:.3g} m/s with leakage"
        d.short(lost, f"thesis eq. 4.7 leaves that out: {larger}")
    if free < 0.999 * duty.get("no_load_speed", 0.0):
        d.short(f"without load the piston reaches {free:.3g} of {duty['no_load_speed']:.3g} m/s",
                f"thesis eq. 4.7 goes by the loaded speed: {larger}")  # fmt: skip


def _motor(d: Sizing) -> None:
    duty, speed = d.duty, d["max_speed"]
    moving = d.load * duty["loaded_speed"]
    power = d.row("power of one motor", duty.get("power", moving * d.circuits) / d.circuits, "kW",
                  "duty" if "power" in duty else "load times loaded_speed")  # fmt: skip
    if power < 0.999 * moving:
        problem = (
            f"a circuit's power is {1e-3 * power:.3g} kW, load times loaded_speed {1e-3 * moving:.3g} kW"
        )
        d.short(problem, "thesis eq. 4.8 goes by the power: check power, load and loaded_speed")
    d.row("nominal torque", power / speed, "N*m", "thesis eq. 4.8")
    held = d["pump_displacement"] * d["relief_pressure"]
    d.row("torque at the relief setting", held, "N*m", "displacement times relief setting")
    constant = d.take("torque_constant", "torque constant", BACK_EMF_V / speed, "N*m/A",
                      "assumption: back EMF of 308 V, as in thesis Table 4.11")  # fmt: skip
    limit = d.take("current_limit", "current limit", STALL_SHARE * held / constant, "A",
                   "assumption: 1.8 times the relief setting's torque, as in thesis Table 4.4")  # fmt: skip
    stall = constant * limit
    needed = d["pump_displacement"] * d.load / min(d["piston_area_1"], d["piston_area_2"])
    if stall < needed:
        raise InputError(
            f"out of reach: the load needs {needed:.3g} N*m of the motor, which gives {stall:.3g}",
            where="current_limit",
            mend="choose a larger current_limit or torque_constant",
        )
    d.take("winding_resistance", "winding resistance", COPPER_SHARE * stall * speed / limit**2, "ohm",
           "assumption: 1 % copper loss at stall, as in thesis Table 4.11")  # fmt: skip
    d.take("inertia", "inertia of motor and pump", INERTIA_S2 * stall, "kg*m^2",
           "assumption: 2e-4 kg*m^2 per N*m of stall torque, thesis Tables 4.4 and 4.11")  # fmt: skip


def _valves(d: Sizing) -> None:
    pumped = d["pump_displacement"] * d["max_speed"]
    valves = "thesis section 4.4"
    d.take("cracking_pressure", "cracking pressure of the refeeding valves", CRACKING_PA, "kPa", valves)
    d.take("refeed_flow_gain", "refeeding flow per pressure", pumped / REFEEDING_PA, "m^3/(s*Pa)",
           f"{valves}: the pump's flow at 10 kPa")  # fmt: skip
    above = 0.1 * d["relief_pressure"]
    d.take("relief_flow_gain", "relief flow per pressure", pumped / above, "m^3/(s*Pa)",
           "assumption: the pump's flow a tenth above the setting")  # fmt: skip


def _accumulator(d: Sizing) -> None:
    duty = d.duty
    d.take(
        "charge_pressure", "charge pressure", CHARGE_PA, "kPa", "assumption: as the prototype, 275 to 689 kPa"
    )
    d.values.setdefault("viscosity_40", 32e-6)
    d.written.setdefault("viscosity_40", "assumption: ISO VG 32, the thesis's AW32")
    v = completed(d.values)
    volumes = v["chamber_volume_1"], v["chamber_volume_2"]
    shifted = 0.5 * (d["piston_area_1"] - d["piston_area_2"]) * d["stroke"]
    gas, oil = accumulator_volumes(
        sum(volumes), max(volumes), d["relief_pressure"], v["bulk_modulus"], shifted,
        REFERENCE_TEMPERATURE - duty.get("coldest", 10.0), duty.get("hottest", 70.0) - REFERENCE_TEMPERATURE,
    )  # fmt: skip
    rule = "accumulator rule: 0.6 to 1.6 times its pressure at rest"
    chosen = d.take("gas_volume", "accumulator's gas at rest", gas, "cm^3", rule)
    takes = "accumulator rule: 1.1 times what the circuit takes"
    d.take("oil_volume", "accumulator's oil at rest", oil, "cm^3", takes)
    if chosen < 0.999 * gas:
        d.short(
            f"gas_volume, {1e6 * chosen:.3g} cm^3, is less than the {1e6 * gas:.3g} cm^3 that cold, heat and "
            "load ask for",
            "choose a larger accumulator or a narrower range of temperature",
        )
