"""Which signal is which channel by all that speaks for it, which way it counts by the oil, and in which unit.

A unit that neither file nor name gives follows from physics where that tells; else the user is asked.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.logs.channel_map import ChannelSource
from fdd.logs.mapping.behaviour import correlation
from fdd.logs.mapping.concepts import taken_apart
from fdd.logs.mapping.evidence import Clues
from fdd.measures import MEASURES, find_measure, measure
from fdd.samples import CHANNELS

IMPOSSIBLE = -1e3
LEAST_SCORE = 1.5
"""nats; a signal of which less speaks for a channel is left without one."""
CLEAR_T = 5.0
"""Student's t above which the pumping tells which chamber is filled."""
PUMP, MOTION = ("pump_speed", "pump_angle", "command"), ("position", "position_setpoint")
_NAMED_SIDES = {
    "ext", "extend", "ret", "retract", "head", "rod", "bore", "cap", "kolbenseite", "stangenseite",
    "bodenseite", "ringseite", "stange", "kolben", "tige", "fond",
}  # fmt: skip
"""Words that tell which end of the cylinder a chamber is at, and not only A and B."""
USUAL = {"ratio": (3e-4, 4.0), "pressure": (5e6, 4.0), "pump_speed": (200.0, 3.0)}
"""Middle and factor within which two thirds of EHAs lie: displacement over area, m/rad (0.05 to 2 mm/rad: the
thesis 0.37, flight controls 0.1 to 0.4, lifts 1 to 2); largest pressure, Pa; largest speed, rad/s."""
_UNITS = {
    "pump_speed": ("rad/s", "rpm", "rev/s", "deg/s"),
    "position": ("m", "cm", "mm", "um", "in"),
    "pressure": ("Pa", "kPa", "bar", "MPa", "psi"),
    "motor_current": ("A", "mA"),
    "oil_temperature": ("degC", "K", "degF"),
}
_BY_SYMBOL = {"w": "rad/s", "omega": "rad/s", "n": "rpm", "rpm": "rpm", "drehzahl": "rpm"}
"""What a speed's symbol stands for in this field: omega in radians, n in revolutions a minute."""
SAME_NUMBERS = 0.1
"""A demand whose slope over what follows it is so near to 1 differs by the loop's error, and not in scale."""
CLEAR_NATS = 2.2
"""Nine to one."""
_SYMBOL_NATS = 1.5
Sources = dict[str, ChannelSource]


class Choice(NamedTuple):
    """A channel's signal, how sure that is (0 to 1), and the signal that comes next."""

    signal: str
    confidence: float
    other: str | None


def assign(scores: dict[str, dict[str, float]], channels: list[str]) -> dict[str, Choice]:
    """The assignment of the highest total score (nats), each signal and channel at most once. How sure a
    choice is follows from how much the total falls where it is forbidden."""
    from scipy.optimize import linear_sum_assignment

    signals = list(scores)
    rows = [[of.get(channel, IMPOSSIBLE) for channel in channels] for of in scores.values()]
    table = np.array(rows).reshape(len(signals), len(channels))

    def best(table: NDArray[np.float64]) -> tuple[float, list[tuple[int, int]]]:
        # As many columns that mean "no channel" as there are signals, so that nothing is forced.
        wide = np.concatenate([table, np.full((len(signals), len(signals)), LEAST_SCORE)], axis=1)
        i, j = linear_sum_assignment(wide, maximize=True)
        pairs = [(int(a), int(b)) for a, b in zip(i, j, strict=True) if b < len(channels)]
        return float(wide[i, j].sum()), pairs

    total, chosen = best(table)
    out: dict[str, Choice] = {}
    for i, j in chosen:
        without = table.copy()
        without[i, j] = IMPOSSIBLE
        less, others = best(without)
        other = next((signals[a] for a, b in others if b == j), None)
        confidence = float(1.0 / (1.0 + np.exp(-min(total - less, 50.0))))
        out[channels[j]] = Choice(signals[i], confidence, other)
    return out


def signs_of(found: Clues, chosen: dict[str, Choice]) -> tuple[dict[str, int], list[str]]:
    """Signs by channel, and what was found out: a positive pump motion extends and raises chamber 1.

    Chambers that turn out the wrong way round are swapped in `chosen`.
    """
    data, signs = found.data, dict.fromkeys(chosen, 1)
    name = {channel: choice.signal for channel, choice in chosen.items()}
    one, two, drop = (name.get(c) for c in ("pressure_1", "pressure_2", "pressure_difference"))
    pump = next((c for c in PUMP if c in chosen), None)
    if pump is None or "position" not in chosen:
        return signs, []
    if one and two and drop and correlation(data.means(drop), data.means(one) - data.means(two)) < -0.5:
        signs["pressure_difference"] = -1
    if one and two:
        difference = data.columns[one] - data.columns[two]
    elif drop:
        difference = data.columns[drop]
    else:
        return signs, []
    turned_by = data.changes(name[pump]) if pump == "pump_angle" else data.sums(name[pump])
    along = correlation(data.changes(name["position"]), turned_by)
    t = data.rises_with_pumping(difference, name["position"], turned_by)
    if abs(along) < 0.5:
        return signs, ["the position does not follow the pump in this log: signs are taken as they are"]
    notes: list[str] = []
    if abs(t) < CLEAR_T:
        notes.append("this log does not tell which chamber the pump fills: chambers are taken as named")
    forwards, raises = along > 0.0, t > 0.0 or abs(t) < CLEAR_T
    told = {word for signal in (one, two) if signal for word in taken_apart(signal)}
    turned: tuple[str, ...] = ()
    if not forwards and raises:
        turned = MOTION
        notes.append("the position counts against the pump: its sign is turned")
    elif not forwards:
        turned = PUMP
        notes.append("the pump counts against position and pressures: its sign is turned")
    elif not raises and not (one and two):
        signs["pressure_difference"] = -1
        notes.append(f"a positive pump motion lowers {drop}: its sign is turned")
    elif not raises and _NAMED_SIDES & told:
        turned = PUMP + MOTION
        notes.append(f"a positive pump motion raises {two}: retracting counts as positive, turned")
    elif not raises:
        chosen["pressure_1"], chosen["pressure_2"] = chosen["pressure_2"], chosen["pressure_1"]
        signs["pressure_difference"] = -signs.get("pressure_difference", 1)
        notes.append(f"a positive pump motion raises {two}: it is chamber 1")
    signs |= {channel: -1 for channel in turned if channel in chosen}
    for demand, measured in (("command", pump), ("position_setpoint", "position")):
        if demand in chosen and measured not in (demand, "pump_angle"):
            alike = data.alike(name[demand], name[measured])
            if abs(alike) > 0.5:  # a demand has the sign of what follows it
                signs[demand] = signs[measured] * (1 if alike > 0 else -1)
    if "pump_angle" in chosen and pump == "pump_speed":
        backwards = data.follows(name["pump_angle"], name[pump]) < -0.5
        signs["pump_angle"] = signs[pump] * (-1 if backwards else 1)
    if "motor_current" in chosen and drop:
        torque = data.alike(name["motor_current"], drop)
        if abs(torque) > 0.5 and signs["pressure_difference"] * torque < 0:
            signs["motor_current"] = -1
            notes.append("the current is negative where the pump works against pressure: its sign is turned")
    return signs, notes


@dataclass(frozen=True)
class Question:
    """What the log does not tell, in one sentence.

    `options`: answer to the sources that it sets, the likeliest first. `hint`: options of the command.
    """

    channel: str
    text: str
    options: dict[str, Sources]
    hint: str


def scale_of(found: Clues, speed: str | None, channel: str, name: str) -> dict[str, object]:
    """Unit of a signal as a channel; a scale where it is in volts or counts, by what it has to be like. A
    demand in volts is held against the signal `speed` of the pump."""
    unit, shaft, data = found.units[name], found.shaft, found.data
    if unit is not None and find_measure(unit, CHANNELS[channel].dimension) is not None:
        return {"unit": unit}
    if channel == "pump_angle" and shaft is not None and shaft.signal == name:
        return {"wrap": shaft.wrap, "scale": 1.0 / shaft.wrap, "unit": "rev"}
    if channel in ("pump_speed", "command") and shaft is not None:
        slope, spread = data.gain(shaft.signal, name)
        if speed is not None:
            measured = data.gain(shaft.signal, speed)[0]
            ratios = (data.slope(speed, name)[0], slope / measured)
            slope = measured if min(abs(r - 1.0) for r in ratios) < SAME_NUMBERS else slope
        if abs(slope) > 20.0 * spread:
            per = abs(slope) * 2.0 * np.pi / shaft.wrap
            near = (u for u in _UNITS["pump_speed"] if abs(per / MEASURES[u].factor - 1.0) < 0.015)
            known = next(near, None)
            return {"unit": known} if known else {"scale": float(f"{per * 30.0 / np.pi:.4g}"), "unit": "rpm"}
    if channel == "command" and speed is not None:
        unit_of_speed = find_measure(found.units[speed] or "rad/s", "angular_speed")
        slope, spread = data.slope(speed, name)
        if unit_of_speed is not None and abs(slope) > 20.0 * spread:
            per_volt = abs(slope) * unit_of_speed.factor
            # A drive has a multiple of 500 rpm at 10 V; within 1.5 % of one, it is that.
            at_ten_volts = 10.0 * per_volt * 30.0 / np.pi
            whole = 500.0 * round(at_ten_volts / 500.0)
            usual = whole >= 500.0 and abs(at_ten_volts / whole - 1.0) < 0.015
            scale = float(whole * np.pi / 300.0) if usual else float(f"{per_volt:.5g}")
            return {"scale": scale, "unit": "rad/s"}
    return {}


def with_units(found: Clues, names: dict[str, str], known: Sources) -> list[Question]:
    """Give channels in `known`, of the signals in `names`, the likeliest unit; ask where it is not clear."""
    asked = []
    for kind, units in _UNITS.items():
        members = [c for c in known if c.startswith(kind) and c != "position_setpoint"]
        unknown = [c for c in members if known[c].unit is None]
        if not unknown:
            known |= _demand_like(found, names, known, {}) if kind == "position" else {}
            continue
        told = next((known[c].unit for c in members if known[c].unit is not None), None)
        nats = _nats(found, names, known, kind, units)
        likely = sorted(units, key=lambda u: -nats[u])
        clear = told is not None or nats[likely[0]] - nats[likely[1]] > CLEAR_NATS
        likely = likely if told is None else [told, *(u for u in likely if u != told)]
        options = {u: {c: known[c].model_copy(update={"unit": u}) for c in unknown} for u in likely}
        if kind == "position":
            options = {u: _demand_like(found, names, known, one) for u, one in options.items()}
        known |= options[likely[0]]
        signals, several = ", ".join(names[c] for c in unknown), len(unknown) > 1
        # Whole numbers without a unit are a converter's, and no physics knows its scale.
        raw = (found.data.columns[names[c]] for c in unknown if names[c] in found.unnamed)
        if any(bool(np.all(v == np.round(v))) for v in (v[np.isfinite(v)] for v in raw)):
            which = f"Which scale {'have' if several else 'has'} {signals}"
            text = f"{which} ({kind}, raw counts by the look of it)?"
            hint = " ".join(f"--set {c}={names[c]}*SCALE+OFFSET:{likely[0]}" for c in unknown)
            asked.append(Question(kind, text, options, hint))
        elif not clear:
            text = f"In which unit {'are' if several else 'is'} {signals}?"
            asked.append(Question(kind, text, options, f"--set {kind}=:{likely[0]}"))
    return asked


def _demand_like(found: Clues, names: dict[str, str], known: Sources, sources: Sources) -> Sources:
    """The sources, and with them the demanded position, which is in the measured one's numbers."""
    measured, demand = sources.get("position", known.get("position")), known.get("position_setpoint")
    if measured is None or demand is None or demand.unit or names["position_setpoint"] not in found.unnamed:
        return sources
    same = measured.model_dump(include={"unit", "scale", "offset"})
    return {**sources, "position_setpoint": demand.model_copy(update=same)}


def _nats(
    found: Clues, names: dict[str, str], known: Sources, kind: str, units: tuple[str, ...]
) -> dict[str, float]:
    """How likely each unit is, by what actuators usually are."""
    columns = found.data.columns

    def top(channels: list[str]) -> float:
        return max(float(np.nanpercentile(np.abs(columns[names[c]]), 99.0)) for c in channels)

    def factor(unit: str | None, dimension: str) -> float:
        return 1.0 if unit is None else measure(unit, dimension).factor

    if kind == "motor_current":
        return {"A": 0.0, "mA": -5.0 if top([kind]) < 300.0 else 3.0}
    if kind == "oil_temperature":
        middle = float(np.nanmedian(columns[names[kind]]))
        return {
            "degC": 0.0 if -50.0 < middle < 140.0 else -9.0,
            "K": 0.0 if 220.0 < middle < 420.0 else -9.0,
            "degF": -2.5 if -60.0 < middle < 280.0 else -9.0,
        }
    if kind == "pressure":
        highest = top([c for c in known if c.startswith("pressure")])
        return {u: _nearness("pressure", highest * factor(u, "pressure")) for u in units}
    both = {"pump_speed", "position"} <= known.keys()
    per = abs(found.data.gain(names["position"], names["pump_speed"])[0]) if both else 0.0
    if kind == "position":
        speed = factor(known["pump_speed"].unit, "angular_speed") * known["pump_speed"].scale if per else 1.0
        return {u: _nearness("ratio", per * factor(u, "length") / speed) if per else 0.0 for u in units}
    parts = names[kind].lower().replace(".", "/").split("/")
    symbol = next((s for w, s in _BY_SYMBOL.items() if w in parts), None)
    out = {}
    for unit in units:
        out[unit] = _nearness("pump_speed", top([kind]) * factor(unit, "angular_speed"))
        if per and known["position"].unit is not None:
            length = factor(known["position"].unit, "length")
            out[unit] += _nearness("ratio", per * length / factor(unit, "angular_speed"))
        out[unit] += _SYMBOL_NATS if unit == symbol else 0.0
    return out


def _nearness(kind: str, value: float) -> float:
    """Log density of a quantity among actuators, less a constant."""
    middle, spread = USUAL[kind]
    return float(-0.5 * (np.log(max(value, 1e-300) / middle) / np.log(spread)) ** 2)
