"""Logs whose duty and load change on the way."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.campaign.drawing import draw_scenario, draw_unit, stream
from fdd.campaign.recipe import Recipe
from fdd.errors import InputError
from fdd.plant.duty import Mission, Resting, Standstill, Steps
from fdd.plant.load import ChangingLoad, GustLoad


def recipe() -> Recipe:
    return Recipe(
        schema="fdd.recipe/1", healthy_share=1.0, duration=(120.0, 120.0),
        duties={"mission": 1.0, "steps": 1.0, "resting": 1.0}, loads={"changing": 1.0},
    )  # fmt: skip


def test_a_mission_is_its_duties_one_after_another() -> None:
    stages = (Steps(amplitude=0.02, offset=0.01), Standstill(offset=-0.03))
    mission = Mission(stages=stages, seconds=(2.0, 1.0))
    path = mission.setpoint(4000, True, np.random.default_rng(5))
    np.testing.assert_array_equal(path[:2000], stages[0].setpoint(2000, True, np.random.default_rng(5)))
    assert np.all(path[2000:] == -0.03), "the last one goes on"
    assert mission.setpoint(500, True, np.random.default_rng(5)).size == 500, "a log may end before"


def test_each_stage_has_its_time() -> None:
    with pytest.raises(InputError, match="give each stage its seconds"):
        Mission(stages=(Standstill(),), seconds=(1.0, 2.0))


def test_an_axis_at_rest_moves_by_hundredths() -> None:
    path = Resting(amplitude=0.05, hold=30.0).setpoint(20_000, True, np.random.default_rng(2))
    steps = np.abs(np.diff(path[5000:]))
    assert np.quantile(steps, 0.9) < 1e-5 and np.ptp(path) > 0.0


def test_a_changing_load_has_its_level_and_its_gusts() -> None:
    load = ChangingLoad(
        level=[[0, 100.0], [10, 100.0], [11, -300.0]], deviation=[[0, 0.0], [20, 0.0], [20, 50.0]]
    )
    force = load.force(60_000, np.random.default_rng(3))
    assert np.all(force[:10_000] == 100.0) and np.all(force[11_000:20_000] == -300.0)
    assert np.std(force[20_000:]) == pytest.approx(50.0, rel=0.25), "as a gust's"
    gust = GustLoad(deviation=50.0).force(60_000, np.random.default_rng(3))
    np.testing.assert_allclose(force[20_000:] + 300.0, gust[20_000:], rtol=1e-9)


def test_a_drawn_mission_keeps_to_what_the_unit_can_do() -> None:
    """Test: missions of 40 units. Expected: within the stroke; a load changes where the duty does."""
    seen = 0
    for index in range(40):
        rig = draw_unit(recipe(), stream(recipe(), "unit", index), index)
        scenario = draw_scenario(recipe(), rig, stream(recipe(), "log", index, 0, 0))
        most = rig.unit.accumulator.relief_pressure * rig.unit.cylinder.area_1
        assert isinstance(scenario.load, ChangingLoad)
        assert max(-scenario.load.level.least, scenario.load.level.most) < most
        if not isinstance(scenario.duty, Mission):
            continue
        seen += 1
        assert sum(scenario.duty.seconds) == pytest.approx(120.0, abs=0.01)
        assert len(scenario.duty.stages) >= 3 and scenario.control.mode == "position"
        path = scenario.duty.setpoint(120_000, True, np.random.default_rng(1))
        assert np.abs(path).max() < 0.5 * rig.unit.cylinder.stroke
        turns = np.cumsum(scenario.duty.seconds)[:-1]
        changes = [t for t, _ in scenario.load.level.points[1:-1:2]]
        np.testing.assert_allclose(np.array(changes)[: turns.size], turns - 0.5, atol=0.01)
    assert seen > 5
