"""Duties that a unit can do, within its stroke and its drive; missions of several, and loads that change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fdd.campaign.ranges import Rng, chosen, spread, uniform
from fdd.campaign.recipe import Recipe
from fdd.campaign.sizes import NEUTRAL, Scale
from fdd.plant import Programme
from fdd.plant.duty import DUTIES, Duty, Mission
from fdd.plant.rig import ChangingLoad
from fdd.plant.scenario import Control
from fdd.unit import Unit

POSITION_ONLY = ("standstill", "strokes", "flight", "resting", "mission")
"""Duties that make no sense without a position loop: at a commanded speed they would drift away."""
USED_STROKE = 0.8
"""Of half the stroke: most of it that a set-point uses; the rest is for overshoot and drift."""
USED_SPEED = 0.85
"""Of the drive's largest speed that a set-point may ask for, before load and leakage."""
ONE_WAY_S: dict[str, Callable[[dict[str, Any]], float]] = {
    "sines": lambda drawn: 1.0 / (np.pi * drawn["low_hz"]),
    "sweep": lambda drawn: 1.0 / (np.pi * 0.1),
    "sawtooth": lambda drawn: 0.25 * drawn["period"],
    "one_way": lambda drawn: 0.5 * drawn["out"],  # the strokes run to both sides of the offset alike
    "prbs": lambda drawn: 4.0 * drawn["bit"],
}
"""Duty to the seconds of full speed that it spends in one direction, in speed control; else as it holds."""
SHORTEST_S, STAGES = 15.0, (3, 6)
"""s of a stage of a mission at least, and how many a log has where there is time for them."""


def fitting_duty(
    name: str,
    unit: Unit,
    rng: Rng,
    ranges: Mapping[str, tuple[float, float]],
    *,
    speed: bool,
    gain: float,
    scale: Scale = NEUTRAL,
) -> tuple[Duty, Control]:
    """Draw a duty of that kind which the unit's stroke, areas, displacement and drive allow, and its control.

    Parameters
    ----------
    ranges : parameter to range, where the duty's usual ones are not wanted.
    speed : speed control is wanted; ignored where the duty leaves no choice.
    gain : of the position loop, (rad/s)/m.
    scale : of a machine of another size than the ranges are made for.
    """
    kind = DUTIES[name]
    drawn: dict[str, Any] = {}
    for key, (low, high) in scale.duty_ranges({**kind.usual, **ranges}).items():
        # Rigs use their stroke and speed: only times and frequencies spread over decades.
        drawn[key] = (uniform if key in ("amplitude", "speed") else spread)(rng, (low, high))
    drawn["lead_in"] = float(rng.uniform(0.3, 2.0))
    room = USED_STROKE * 0.5 * unit.cylinder.stroke
    per_rad = unit.pump.displacement / unit.cylinder.area_1
    fastest = USED_SPEED * unit.drive.max_speed * per_rad
    if name == "constant_speed":
        speeds = np.exp(rng.uniform(np.log(30.0), np.log(240.0), 3))
        drawn["speeds"] = tuple(min(float(s), USED_SPEED * unit.drive.max_speed) for s in speeds)
        drawn["turn"] = float(rng.uniform(5.0, 15.0))
    if name == "sines":
        drawn["count"] = int(rng.integers(2, 7))
        drawn["tilt"] = float(rng.uniform(0.8, 2.0))
    by_speed = name == "constant_speed" or (speed and name not in POSITION_ONLY)
    if "amplitude" in drawn:
        most = room if by_speed else min(room, _reachable(name, drawn, fastest, gain, unit.drive.max_speed))
        drawn["amplitude"] = min(drawn["amplitude"], most)
    if by_speed and "speed" in drawn:
        # Half the room: a sine of speed starts at its end, and steps walk.
        seconds = ONE_WAY_S[name](drawn) if name in ONE_WAY_S else drawn.get("hold", 1.0)
        drawn["speed"] = min(drawn["speed"], 0.5 * room / (per_rad * seconds))
    spare = room - drawn.get("amplitude", 0.0) if not by_speed or name == "constant_speed" else 0.3 * room
    drawn["offset"] = float(rng.uniform(-1.0, 1.0)) * min(spare, 0.06)
    control = Control(mode="speed") if by_speed else Control(mode="position", gain=gain)
    return kind(**drawn), control


def _reachable(name: str, drawn: Mapping[str, Any], fastest: float, gain: float, max_speed: float) -> float:
    """Largest amplitude (m) at which the drive is not saturated most of the time."""
    if name == "sines":
        f = np.geomspace(drawn["low_hz"], max(drawn["high_hz"], drawn["low_hz"]), drawn["count"])
        w = f ** -drawn["tilt"]
        return float(fastest / (2.0 * np.pi * np.sum(w * f) / np.sum(w)))
    if name == "sawtooth":
        return 0.5 * fastest * drawn["period"] * min(drawn["rise"], 1.0 - drawn["rise"])
    if name == "one_way":
        return 0.5 * fastest * min(drawn["out"], drawn["back"])
    if name in ("prbs", "sweep"):
        # The loop cannot follow; its command is about gain times the set-point.
        return 0.8 * max_speed / gain
    return float("inf")


def drawn_mission(
    recipe: Recipe, unit: Unit, rng: Rng, duration: float, gain: float, scale: Scale
) -> tuple[Mission, Control]:
    """A mission of the recipe's other duties, by position."""
    weights = {n: w for n, w in recipe.duties.items() if n not in ("mission", "constant_speed", "one_way")}
    weights = weights or {"steps": 1.0, "flight": 1.0, "resting": 1.0}
    stages: list[Duty] = []
    for _ in range(_count(rng, duration)):
        name = chosen(rng, weights)
        ranges = recipe.ranges.get(name, {})
        stages.append(fitting_duty(name, unit, rng, ranges, speed=False, gain=gain, scale=scale)[0])
    amplitude = max(abs(s.offset) + s.amplitude for s in stages)
    seconds = tuple(round(float(s), 3) for s in _lengths(rng, len(stages), duration))
    made = {"stages": [s.model_dump() for s in stages], "seconds": seconds, "amplitude": amplitude}
    return Mission.model_validate(made), Control(mode="position", gain=gain)


def changing(values: dict[str, float], rng: Rng, duration: float, duty: Duty, most: float) -> ChangingLoad:
    """A load of that size which changes where the duty does, or at times of its own.

    `values` : of `ChangingLoad.usual`, drawn. `most` : N that the unit can carry.
    """
    lengths = duty.seconds if isinstance(duty, Mission) else _lengths(rng, _count(rng, duration), duration)
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    levels = np.clip(values["level"] * rng.uniform(-1.0, 1.0, starts.size), -0.3 * most, 0.3 * most)
    gusty = rng.random(starts.size) < 0.4
    deviations = np.where(gusty, min(values["deviation"], 0.15 * most), 0.0)
    level, deviation = _held(starts, levels), _held(starts, deviations)
    return ChangingLoad(level=level, deviation=deviation, bandwidth_hz=values["bandwidth_hz"])


def _count(rng: Rng, duration: float) -> int:
    wanted = int(rng.integers(STAGES[0], STAGES[1] + 1))
    return max(min(wanted, int(duration // SHORTEST_S)), 1)


def _lengths(rng: Rng, count: int, duration: float) -> np.ndarray:
    """s of stages that fill a log, none much shorter than another."""
    shares = rng.uniform(0.5, 1.5, count)
    return np.asarray(duration * shares / shares.sum())


def _held(starts: np.ndarray, values: np.ndarray) -> Programme:
    """A value that is held, and moves to the next one within a second."""
    times = [t for start in starts[1:].tolist() for t in (start - 0.5, start + 0.5)]
    held = np.repeat(values, 2)[1:-1] if values.size > 1 else np.array([])
    points = [(0.0, float(values[0])), *zip(times, held.tolist(), strict=True)]
    return Programme(points=tuple((round(t, 3), round(v, 3)) for t, v in points))
