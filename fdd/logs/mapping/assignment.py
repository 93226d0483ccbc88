"""Which signal is which channel by all that speaks for it, and which way it counts, by the oil."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.logs.mapping.behaviour import correlation
from fdd.logs.mapping.evidence import Clues

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


class Choice(NamedTuple):
    """A channel's signal, how sure that is (0 to 1), and the signal that comes next."""

    signal: str
    confidence: float
    other: str | None


def assign(scores: dict[str, dict[str, float]], channels: list[str]) -> dict[str, Choice]:
    """The assignment of the highest total score (nats), each signal and channel at most once.

    How sure a choice is follows from how much the total falls where it is forbidden. A channel that a signal
    has no score of is impossible.
    """
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
    told = {word for signal in (one, two) if signal for word in found.words.taken_apart(signal)}
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
