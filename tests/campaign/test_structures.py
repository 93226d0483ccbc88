"""Structures: machines of other sizes hold together, logs show what their instruments can, labels say so."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdd.campaign.drawing import draw_scenario, draw_unit, stream, structure_of
from fdd.campaign.recipe import Recipe
from fdd.campaign.sizes import RELIEF, Scale, Size, sized_unit
from fdd.errors import InputError
from fdd.faults import PROFILES
from fdd.plant.details import Details
from fdd.plant.faults.spec import SIMULATED, FaultScales
from fdd.plant.load import LOADS
from fdd.plant.scenario import Scenario
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import prepare, simulate
from fdd.unit import Unit

RECIPES = Path(__file__).parents[2] / "datasets"
SEEDS = range(25)
MINIMUM = ["position", "pump_speed", "pressure_difference"]


def recipe_with(**fields: Any) -> Recipe:
    given = {"schema": "fdd.recipe/1", "healthy_share": 1.0, "units": 4, "logs_per_unit": 1, **fields}
    return Recipe(**given)


@pytest.mark.parametrize("name", ["structures", "healthy", "laws"])
def test_shipped_recipes_read_back_and_all_their_units_can_be_drawn(name: str) -> None:
    recipe = Recipe.load(RECIPES / f"{name}.yaml")
    assert Recipe.from_yaml(recipe.to_yaml()) == recipe
    kinds = Counter(getattr(structure_of(recipe, k), "name", "") for k in range(recipe.units))
    assert set(kinds) == {each.name for each in recipe.structures}
    for index in range(recipe.units):
        rig = draw_unit(recipe, stream(recipe, "unit", index), index)
        scenario = draw_scenario(recipe, rig, stream(recipe, "log", index, 0, 0))
        prepare(rig.unit, scenario)  # refuses what does not fit together
    if name == "structures":
        assert set(recipe.faults) == set(SIMULATED) - {"relief_valve_stuck_shut", "drive_failure"}
    if name == "laws":
        assert set(recipe.faults) == set(SIMULATED) and set(recipe.loads) == set(LOADS) - {"changing"}
        assert set(recipe.profiles) == set(PROFILES)
        assert recipe.structures == Recipe.load(RECIPES / "structures.yaml").structures


def test_machines_of_all_sizes_hold_together() -> None:
    """Each by what its designer would check, from the profile alone."""
    pressures, displacements = [], []
    for seed in SEEDS:
        unit = sized_unit(Size(area_ratio=(0.5, 1.0)), np.random.default_rng(seed))
        cylinder, drive = unit.cylinder, unit.drive
        rated = unit.accumulator.relief_pressure / RELIEF
        flow = unit.pump.displacement * drive.max_speed
        pressures.append(rated)
        displacements.append(unit.pump.displacement)
        assert 0.5 <= cylinder.area_2 / cylinder.area_1 <= 1.0
        # The motor turns the pump against the relief valve, its voltage lets it reach its speed.
        assert drive.current_limit * drive.torque_constant > unit.pump.displacement * rated * RELIEF
        assert drive.back_emf_constant * drive.max_speed < drive.voltage_limit
        assert 0.01 <= unit.pump.total_leakage * rated / flow <= 0.05 + 1e-9
        for branch in (unit.friction.forward, unit.friction.reverse):
            share = branch.static / (rated * 0.5 * (cylinder.area_1 + cylinder.area_2))
            assert 0.85 * 0.005 <= share <= 1.15 * 0.02
            assert branch.coulomb < branch.static
        # The transducer reads beyond the relief valve's setting.
        assert unit.sensors["pressure_1"].high == pytest.approx(1.5 * unit.accumulator.relief_pressure)
        # The accumulator survives the piston's whole travel and all oil from 10 to 70 °C, under load.
        store, shifted = unit.accumulator, (cylinder.area_1 - cylinder.area_2) * 0.5 * cylinder.stroke
        oil = cylinder.volume_1 + cylinder.volume_2
        assert store.gas_volume > 2.0 * shifted + 7e-4 * 30.0 * oil
        pressed = max(cylinder.volume_1, cylinder.volume_2) * store.relief_pressure / unit.oil.bulk_modulus
        assert store.oil_at_rest > shifted + 7e-4 * 30.0 * oil + pressed
    for values, low, high in ((pressures, 2e6, 30e6), (displacements, 0.2e-6, 7e-6)):
        assert low <= min(values) < 2.0 * low
        assert 0.5 * high < max(values) <= high


def test_the_axis_is_of_its_own_size() -> None:
    scale = Scale(Unit.load("axis_a"))
    assert scale.force == scale.velocity == scale.leakage == scale.position_gain == 1.0
    assert scale.details({}) == Details().model_dump()
    ranges = {"level": (-2500.0, 2500.0)}
    assert scale.load_ranges("constant", ranges) == ranges
    # Of air, 2.5 % bring the bulk modulus to 35 %.
    figures = scale.fault_scales({})
    assert figures["free_air"] == pytest.approx(FaultScales().free_air, rel=0.03)
    for name in ("check_valve_cracking", "shorted_braking", "leakage_pressure", "check_valve_sticking"):
        assert figures[name] == getattr(FaultScales(), name)


def test_a_log_has_the_channels_rate_and_noise_of_its_instruments() -> None:
    scenario = {"duration": 6.0, "seed": 3, "duty": {"name": "sines"}}
    whole = simulate(Unit.load("axis_a"), Scenario(recording=Recording.perfect(), **scenario))
    few = Recording(
        **{**Recording.perfect().model_dump(), "rate": 200, "speed": "sampled", "channels": MINIMUM}
    )
    part = simulate(Unit.load("axis_a"), Scenario(recording=few, **scenario))
    assert set(part.samples.channels) == set(MINIMUM)
    np.testing.assert_array_equal(part.samples.time, whole.samples.time[::5])
    np.testing.assert_array_equal(part.samples["position"], whole.samples["position"][::5])
    np.testing.assert_allclose(part.samples["pump_speed"], whole.truth["pump_speed"][::5], atol=0.06)
    assert len(part.truth) == len(part.samples)


def test_two_kilohertz_shows_what_one_does_and_what_lies_between() -> None:
    scenario = {"duration": 4.0, "seed": 3, "duty": {"name": "sines"}}
    fault = {"fault": "position_sensor_slip", "severity": 1.0, "onset": 0.5}
    records = (Recording(**{**Recording.perfect().model_dump(), "rate": rate}) for rate in (1000, 2000))
    usual, quick = (
        simulate(Unit.load("axis_a"), Scenario(recording=r, faults=[fault], **scenario)) for r in records
    )
    np.testing.assert_allclose(quick.samples.time, np.arange(8000) * 5e-4, atol=1e-12)
    # Between two rows lie steps of the integrator's own error.
    np.testing.assert_allclose(quick.samples["position"][::2], usual.samples["position"], atol=2.1e-6)
    np.testing.assert_allclose(quick.truth["pressure_1"][::2], usual.truth["pressure_1"], atol=500.0)
    middle = 0.5 * (usual.truth["position"][1:] + usual.truth["position"][:-1])
    np.testing.assert_allclose(quick.truth["position"][1:-1:2], middle, atol=1e-5)
    speed = np.diff(quick.samples["pump_angle"]) / 5e-4
    np.testing.assert_allclose(quick.samples["pump_speed"][1:], speed, atol=1e-3)


@pytest.mark.parametrize(
    ("structure", "told"),
    [
        ({"size": {"area_ratio": [0.6, 0.8]}}, "piloted"),
        ({"size": {}, "base": "axis_a"}, "base and size"),
        ({"channels": ["position", "pump_speed"]}, "pressure_difference"),
        ({"rate": 300}, "rate"),
        ({"profile": {"oil": {"taste": [0, 1]}}}, "taste"),
    ],
)
def test_what_no_machine_can_be_is_refused_in_one_line(structure: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError, match=told) as error:
        recipe_with(structures=[{"name": "odd", **structure}])
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="twice"):
        recipe_with(structures=[{"name": "odd"}, {"name": "odd"}])
