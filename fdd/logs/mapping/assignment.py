"""Which signal is which channel by all that speaks for it, and which way it counts, by the oil."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.logs.mapping.behaviour import correlation, follows, rises_with_pumping
from fdd.logs.mapping.evidence import Clues

IMPOSSIBLE = -1e3
LEAST_SCORE = 1.5
"""nats; a signal of which less speaks for a channel is left without one."""
CLEAR_T = 5.0
"""Student's t above which the pumping tells which chamber is filled."""
_NAMED_SIDES = {
    "ext", "extend", "ret", "retract", "head", "rod", "bore", "cap", "kolbenseite", "stangenseite",
    "bodenseite", "ringseite", "stange", "kolben", "tige", "fond",
}  # fmt: skip
"""Words that tell which end of the cylinder a chamber is at, and not only A and B."""


@dataclass(frozen=True)
class Choice:
    """A channel's signal, how sure that is (0 to 1), and the signal that comes next."""

    signal: str
    confidence: float
    other: str | None


def assign(scores: dict[str, dict[str, float]], channels: list[str]) -> dict[str, Choice]:
    """The assignment of the highest total score, each signal and channel at most once.

    How sure a choice is follows from how much the total falls where it is forbidden.

    Parameters
    ----------
    scores : signal to channel to nats; a channel that is not there is impossible.
    channels : to be filled.
    """
    signals = list(scores)
    rows = [[of.get(channel, IMPOSSIBLE) for channel in channels] for of in scores.values()]
    table = np.array(rows).reshape(len(signals), len(channels))
    total, chosen = _best(table)
    out: dict[str, Choice] = {}
    for i, j in chosen:
        without = table.copy()
        without[i, j] = IMPOSSIBLE
        less, others = _best(without)
        other = next((signals[a] for a, b in others if b == j), None)
        confidence = float(1.0 / (1.0 + np.exp(-min(total - less, 50.0))))
        out[channels[j]] = Choice(signals[i], confidence, other)
    return out


def _best(table: NDArray[np.float64]) -> tuple[float, list[tuple[int, int]]]:
    from scipy.optimize import linear_sum_assignment

    rows, columns = table.shape
    # As many columns that mean "no channel" as there are signals, so that nothing is forced.
    wide = np.concatenate([table, np.full((rows, rows), LEAST_SCORE)], axis=1)
    i, j = linear_sum_assignment(wide, maximize=True)
    chosen = [(int(a), int(b)) for a, b in zip(i, j, strict=True) if b < columns]
    return float(wide[i, j].sum()), chosen


def signs_of(found: Clues, chosen: dict[str, Choice]) -> tuple[dict[str, int], list[str]]:
    """Signs by physics: a positive pump motion extends the cylinder and raises the pressure of chamber 1.

    Chambers that turn out the wrong way round are swapped in `chosen`.

    Returns
    -------
    Sign by channel, and what was found out, one line each.
    """
    notes: list[str] = []
    data = found.data
    signs: dict[str, int] = dict.fromkeys(chosen, 1)
    pump = next((c for c in ("pump_speed", "pump_angle", "command") if c in chosen), None)
    if pump is None or "position" not in chosen:
        return signs, notes
    name = {c: choice.signal for c, choice in chosen.items()}
    one, two, drop = (name.get(c) for c in ("pressure_1", "pressure_2", "pressure_difference"))
    if one and two and drop:
        between = correlation(data.means(drop), data.means(one) - data.means(two))
        if between < -0.5:
            signs["pressure_difference"] = -1
    rate = pump != "pump_angle"
    along = (
        follows(data, name["position"], name[pump])
        if rate
        else correlation(data.changes(name["position"]), data.changes(name[pump]))
    )
    if one and two:
        difference = data.columns[one] - data.columns[two]
    elif drop:
        difference = data.columns[drop]
    else:
        return signs, notes
    t = rises_with_pumping(data, difference, name["position"], name[pump], rate=rate)
    motion, pressures = 1 if along > 0 else -1, 1 if t > 0 else -1
    if abs(along) < 0.5:
        notes.append("the position does not follow the pump in this log: signs are taken as they are")
        return signs, notes
    if abs(t) < CLEAR_T:
        notes.append("this log does not tell which chamber the pump fills: chambers are taken as named")
        pressures = 1
    pumped: list[str] = [c for c in ("pump_speed", "pump_angle", "command") if c in chosen]
    moved: list[str] = [c for c in ("position", "position_setpoint") if c in chosen]
    flip: list[str] = []
    if (motion, pressures) == (-1, 1):
        flip = moved
        notes.append("the position counts against the pump: its sign is turned")
    elif (motion, pressures) == (-1, -1):
        flip = pumped
        notes.append("the pump counts against position and pressures: its sign is turned")
    elif (motion, pressures) == (1, -1):
        told = {word for name in (one, two) if name for word in found.words.taken_apart(name)}
        if one and two and not _NAMED_SIDES & told:
            chosen["pressure_1"], chosen["pressure_2"] = chosen["pressure_2"], chosen["pressure_1"]
            signs["pressure_difference"] = -signs.get("pressure_difference", 1)
            notes.append(f"a positive pump motion raises {two}: it is chamber 1")
        elif one and two:
            flip = [*pumped, *moved]
            notes.append(f"a positive pump motion raises {two}: retracting counts as positive, turned")
        else:
            signs["pressure_difference"] = -1
            notes.append(f"a positive pump motion lowers {drop}: its sign is turned")
    for channel in flip:
        signs[channel] = -1
    _like(found, chosen, signs, "command", pump)
    if "pump_angle" in chosen and pump == "pump_speed":
        alike = follows(data, name["pump_angle"], name[pump])
        signs["pump_angle"] = signs[pump] * (-1 if alike < -0.5 else 1)
    _like(found, chosen, signs, "position_setpoint", "position")
    if "motor_current" in chosen and drop:
        torque = correlation(data.means(name["motor_current"]), data.means(drop))
        sense = signs["pressure_difference"] * (1 if torque > 0 else -1)
        if abs(torque) > 0.5 and sense < 0:
            signs["motor_current"] = -1
            notes.append("the current is negative where the pump works against pressure: its sign is turned")
    return signs, notes


def _like(found: Clues, chosen: dict[str, Choice], signs: dict[str, int], demand: str, measured: str) -> None:
    """Give a demand the sign of what follows it."""
    if demand not in chosen or measured in (demand, "pump_angle"):
        return
    both = (found.data.means(chosen[c].signal) for c in (demand, measured))
    alike = correlation(*both)
    if abs(alike) > 0.5:
        signs[demand] = signs[measured] * (1 if alike > 0 else -1)
