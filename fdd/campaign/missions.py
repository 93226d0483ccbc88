"""Logs whose duty and load change on the way, and axes that mostly stand."""

from __future__ import annotations

import numpy as np

from fdd.campaign.motion import fitting_duty
from fdd.campaign.ranges import Rng, chosen
from fdd.campaign.recipe import Recipe
from fdd.campaign.sizes import Scale
from fdd.plant.duty import ConstantSpeed, Duty, Mission, OneWay
from fdd.plant.load import ChangingLoad
from fdd.plant.programme import Programme
from fdd.plant.scenario import Control
from fdd.unit import Unit

SHORTEST_S, STAGES = 15.0, (3, 6)
"""s of a stage at least, and how many a log has where there is time for them."""


def drawn_mission(
    recipe: Recipe, unit: Unit, rng: Rng, duration: float, gain: float, scale: Scale | None
) -> tuple[Mission, Control]:
    """A mission of the recipe's other duties, by position."""
    weights = {n: w for n, w in recipe.duties.items() if n not in ("mission", "constant_speed", "one_way")}
    weights = weights or {"steps": 1.0, "flight": 1.0, "resting": 1.0}
    stages: list[Duty] = []
    control = Control(mode="position", gain=gain)
    for _ in range(_count(rng, duration)):
        name = chosen(rng, weights)
        duty, control = fitting_duty(
            name, unit, rng, recipe.ranges.get(name, {}), speed=False, gain=gain, scale=scale
        )
        assert not isinstance(duty, ConstantSpeed | OneWay)
        stages.append(duty)
    amplitude = max(abs(s.offset) + s.amplitude for s in stages)
    seconds = tuple(round(float(s), 3) for s in _lengths(rng, len(stages), duration))
    return Mission.model_validate(
        {"stages": [s.model_dump() for s in stages], "seconds": seconds, "amplitude": amplitude}
    ), control


def changing(values: dict[str, float], rng: Rng, duration: float, duty: Duty, most: float) -> ChangingLoad:
    """A load of that size which changes where the duty does, or at times of its own.

    Parameters
    ----------
    values : of `ChangingLoad.usual`, drawn. most : N that the unit can carry.
    """
    lengths = duty.seconds if isinstance(duty, Mission) else _lengths(rng, _count(rng, duration), duration)
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    levels = np.clip(values["level"] * rng.uniform(-1.0, 1.0, starts.size), -0.3 * most, 0.3 * most)
    gusty = rng.random(starts.size) < 0.4
    deviations = np.where(gusty, min(values["deviation"], 0.15 * most), 0.0)
    return ChangingLoad(
        level=_held(starts, levels), deviation=_held(starts, deviations),
        bandwidth_hz=values["bandwidth_hz"],
    )  # fmt: skip


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
