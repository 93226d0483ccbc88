"""Drawing: shares are exact; units of all sizes, scenarios and missions are what recipe and unit allow."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from fdd import Scenario, Unit
from fdd.campaign.drawing import assign_faults, calibration_runs, draw_unit, stream, structure_of
from fdd.campaign.population import BETWEEN_UNITS
from fdd.campaign.recipe import DRAWN_DUTIES, Recipe
from fdd.campaign.scenarios import draw_scenario
from fdd.campaign.sizes import RELIEF, Scale, Size, sized_unit
from fdd.faults import CATALOGUE, PROFILES
from fdd.plant.details import Details
from fdd.plant.duty import ConstantSpeed, Mission
from fdd.plant.faults import SIMULATED, FaultScales
from fdd.plant.rig import LOADS, ChangingLoad, GustLoad
from fdd.plant.sensors.recording import Recording
from fdd.plant.simulate import prepare, simulate
from tests.refusal import refused

FOUR = ("internal_leakage", "seal_wear", "aeration", "check_valve_stuck_open")


def recipe_with(**fields: object) -> Recipe:
    given = {"schema": "fdd.recipe/1", "faults": {f: {} for f in FOUR}, **fields}
    return Recipe(**given)


@given(
    units=st.integers(1, 40),
    logs=st.integers(0, 9),
    healthy=st.floats(0.0, 1.0),
    weights=st.lists(st.floats(0.01, 10.0), min_size=4, max_size=4),
    seconds=st.sampled_from([0.0, 0.5]),
)
def test_numbers_of_faults_follow_the_shares_to_within_one(units, logs, healthy, weights, seconds):
    faults = {f: {"weight": w} for f, w in zip(FOUR, weights, strict=True)}
    recipe = recipe_with(
        units=units, logs_per_unit=logs, healthy_share=healthy, faults=faults, second_fault_share=seconds
    )
    assigned = assign_faults(recipe)
    assert len(assigned) == units * logs
    firsts = Counter(a[0] if a else "" for a in assigned)
    assert abs(firsts[""] - healthy * len(assigned)) < 1.0 + 1e-6
    for fault, weight in zip(FOUR, weights, strict=True):
        share = (1.0 - healthy) * weight / sum(weights)
        assert abs(firsts[fault] - share * len(assigned)) < 1.0 + 1e-6
    assert all(len(set(a)) == len(a) for a in assigned)


def test_every_varied_parameter_stays_in_its_band_and_fills_it() -> None:
    recipe = recipe_with(variation=0.15)
    ratios: dict[str, list[float]] = {}
    for index in range(60):
        rig = draw_unit(recipe, stream(recipe, "unit", index), index)
        base = Unit.load(rig.base)
        assert rig.base == recipe.bases[index % 2]
        assert rig.unit.cylinder.area_1 == rig.unit.cylinder.area_2
        for part, names in BETWEEN_UNITS.items():
            for name in names:
                ratio = getattr(getattr(rig.unit, part), name) / getattr(getattr(base, part), name)
                ratios.setdefault(f"{part}.{name}", []).append(ratio)
        for side in ("forward", "reverse"):
            ratio = getattr(rig.unit.friction, side).static / getattr(base.friction, side).static
            ratios.setdefault(f"friction.{side}", []).append(ratio)
    for name, values in ratios.items():
        # 60 uniform draws leave the outer fifth on either side empty once in 600 000 times.
        assert 0.85 - 1e-6 <= min(values) < 0.91 and 1.09 < max(values) <= 1.15 + 1e-6, name
    table = np.array([ratios[n] for n in ratios])
    correlation = np.corrcoef(table) - np.eye(len(table))
    assert np.abs(correlation).max() < 0.6  # each on its own: 60 draws give at most about 0.5


@pytest.mark.parametrize("duty", sorted(DRAWN_DUTIES))
@pytest.mark.parametrize("load", sorted(LOADS))
def test_every_duty_with_every_load_fits_the_unit(duty: str, load: str) -> None:
    recipe = recipe_with(duties={duty: 1.0}, loads={load: 1.0}, duration=(3.0, 4.0), speed_control_share=0.5)
    for index in range(2):  # one of each base
        rig = draw_unit(recipe, stream(recipe, "unit", index), index)
        scenario = draw_scenario(recipe, rig, stream(recipe, "log", index, 0, 0), ("aeration",))
        assert (scenario.duty.name, scenario.load.name) == (duty, load)
        demand = prepare(rig.unit, scenario).setpoints[0]  # raises where the duty leaves the stroke
        by_position = scenario.control.mode == "position"
        most = 0.4 * rig.unit.cylinder.stroke + 1e-9 if by_position else rig.unit.drive.max_speed
        assert np.abs(demand).max() <= most
        extreme = 0.5 * rig.unit.cylinder.stroke
        most = rig.unit.accumulator.relief_pressure * rig.unit.cylinder.area_1
        rate, slack, level = (getattr(scenario.load, name, 0.0) for name in ("rate", "slack", "level"))
        level = abs(level) if isinstance(level, float) else max(-level.least, level.most)
        reach = abs(scenario.duty.offset) + scenario.duty.amplitude + abs(slack)
        if load == "press":
            reach = scenario.duty.offset + scenario.duty.amplitude - slack
            assert reach >= 0.0, "the rod touches it"
        assert level + rate * min(reach, extreme) < most


def test_faults_keep_to_the_recipe() -> None:
    recipe = recipe_with(
        faults={
            "aeration": {"severity": [0.7, 0.8]}, "seal_wear": {"variants": ["loose", "tight_forward"]},
            "pressure_sensor_drift": {},
        },
        severity=(0.2, 0.3), onset=(0.5, 0.6), at_start_share=0.5,
    )  # fmt: skip
    rig = draw_unit(recipe, stream(recipe, "unit", 0), 0)
    onsets, variants = [], set()
    for k in range(60):
        faults = ("aeration", "seal_wear", "pressure_sensor_drift")
        scenario = draw_scenario(recipe, rig, stream(recipe, "log", 0, k, 0), faults)
        aeration, seal, drift = scenario.faults
        assert 0.7 <= aeration.severity <= 0.8 and 0.2 <= seal.severity <= 0.3
        assert drift.profile == "step"
        variants.add(seal.variant)
        onsets += [spec.onset / scenario.duration for spec in scenario.faults]
    assert variants == {"loose", "tight_forward"}
    late = np.array([o for o in onsets if o > 0.0])
    assert 0.3 < late.size / len(onsets) < 0.7
    assert late.min() >= 0.5 - 1e-4 and late.max() <= 0.6 + 1e-4


def test_a_law_is_drawn_last_and_old_recipes_draw_the_first() -> None:
    faults = {f: {} for f in SIMULATED} | {"aeration": {"laws": ["chamber_2"]}}
    plain = recipe_with(faults=faults)
    assert plain.laws == "first" and "laws: first" not in plain.to_yaml()
    rig = draw_unit(plain, stream(plain, "unit", 0), 0)
    seen: dict[tuple[str, str], set[str | None]] = {}
    for how in ("first", "all", "unseen"):
        recipe = recipe_with(faults=faults, laws=how)
        for k, name in enumerate(SIMULATED * 8):
            first = draw_scenario(plain, rig, stream(plain, "log", 0, k, 0), (name,))
            drawn = draw_scenario(recipe, rig, stream(recipe, "log", 0, k, 0), (name,))
            seen.setdefault((how, name), set()).add(drawn.faults[0].law)
            alike = [drawn.faults[0].model_copy(update={"law": first.faults[0].law})]
            assert drawn.model_copy(update={"faults": alike}) == first, "nothing else moves"
    for name in SIMULATED:
        laws = tuple(CATALOGUE[name].laws)
        expected = {"first": set(laws[:1]) or {None}, "all": set(laws) or {None},
                    "unseen": set(laws[1:]) or set(laws) or {None}}  # fmt: skip
        for how, wanted in expected.items():
            wanted = {"chamber_2"} if name == "aeration" else wanted
            found = seen[how, name]
            # Eight draws of five laws miss some; of two or less hardly ever both.
            assert found <= wanted and (found == wanted or len(wanted) > 2), (how, name)
    unseen = {law for (how, _), found in seen.items() if how == "unseen" for law in found}
    assert unseen > {"orifice", "shorted"}


def test_every_log_has_its_own_figures_of_what_comes_along_with_a_fault() -> None:
    recipe = recipe_with(fault_scales={**FaultScales.usual, "free_air": [0.02, 0.03]})
    rig = draw_unit(recipe, stream(recipe, "unit", 0), 0)
    drawn = [draw_scenario(recipe, rig, stream(recipe, "log", 0, k, 0)) for k in range(40)]
    for name, (low, high) in recipe.fault_scales.items():
        values = np.array([getattr(s.fault_scales, name) for s in drawn])
        assert values.min() >= low and values.max() <= high and np.ptp(values) > 0.5 * (high - low), name
    assert {s.fault_scales.internal_leakage for s in drawn} == {FaultScales().internal_leakage}
    plain = recipe_with(fault_scales={})
    again = [draw_scenario(plain, rig, stream(plain, "log", 0, k, 0)) for k in range(3)]
    for one, other in zip(again, drawn, strict=False):
        assert one.fault_scales == FaultScales()
        assert one == other.model_copy(update={"fault_scales": FaultScales()}), "nothing else moves"


def test_calibration_covers_speeds_and_pressures_without_touching_the_limits() -> None:
    recipe = recipe_with()
    rig = draw_unit(recipe, stream(recipe, "unit", 1), 1)
    runs = calibration_runs(recipe, rig, stream(recipe, "baseline", 1))
    assert 60.0 < sum(r.duration for r in runs) < 100.0
    free, sines, throttled = (simulate(rig.unit, r).truth for r in runs)
    for truth in (free, sines, throttled):
        assert not truth["stop_force"].any() and np.abs(truth["relief_flow"]).max() < 1e-6
    assert isinstance(runs[0].duty, ConstantSpeed)
    for speed in runs[0].duty.speeds:
        for sign in (1.0, -1.0):
            there = np.abs(sign * free["pump_speed"] - speed) < 0.05 * speed
            assert there.mean() > 0.05, (speed, sign)
    pressure = throttled["pressure_difference"]
    assert 1.8e6 < pressure.max() < 3.2e6 and -3.2e6 < pressure.min() < -1.8e6
    assert sines["pump_speed"].std() > 30.0


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("faults", {"unknown": {}}, "unknown"),
        ("faults", {"seal_wear": {"variants": ["wet"]}}, "use: loose, tight"),
        ("faults", {"seal_wear": {"laws": ["wet"]}}, "use: whole, coulomb"),
        ("structures", [{"name": "a", "profile": {"accumulator": {"gas_volume": [0.0, 0.0]}}}], "gas_volume"),
        ("fault_scales", {"free_air": [0.01, 0.5]}, "free_air"),
        ("duties", {"levels": 1.0}, "use: standstill"),
        ("faults", {}, "no fault has a weight"),
        ("severity", [0.5, 0.2], "runs backwards"),
        ("ranges", {"spring": {"stiffness": [1.0, 2.0]}}, "stiffness"),
        ("name", "../x", "name"),
        ("schema", "fdd.unit/1", "schema"),
        ("schema", "fdd.recipe/2", "schema"),
        ("structures", [{"name": "odd", "size": {"area_ratio": [0.6, 0.8]}}], "piloted"),
        ("structures", [{"name": "odd", "size": {}, "base": "axis_a"}], "base and size"),
        ("structures", [{"name": "odd", "channels": ["position", "pump_speed"]}], "pressure_difference"),
        ("structures", [{"name": "odd", "rate": 300}], "rate"),
        ("structures", [{"name": "odd", "profile": {"oil": {"taste": [0, 1]}}}], "taste"),
        ("structures", [{"name": "odd"}, {"name": "odd"}], "twice"),
    ],
)
def test_a_wrong_recipe_is_told_in_one_line(tmp_path: Path, field: str, value: object, told: str) -> None:
    path = tmp_path / "recipe.yaml"
    plain = {"schema": "fdd.recipe/1", "faults": {"aeration": {}}, field: value}
    path.write_text(yaml.safe_dump(plain), encoding="utf-8")
    line = refused(lambda: Recipe.load(path))
    assert told in line and str(path) in line


def test_a_changing_load_has_its_level_and_its_gusts() -> None:
    level, deviation = [[0, 100.0], [10, 100.0], [11, -300.0]], [[0, 0.0], [20, 0.0], [20, 50.0]]
    force = ChangingLoad(level=level, deviation=deviation).force(60_000, np.random.default_rng(3))
    assert np.all(force[:10_000] == 100.0) and np.all(force[11_000:20_000] == -300.0)
    assert np.std(force[20_000:]) == pytest.approx(50.0, rel=0.25), "as a gust's"
    gust = GustLoad(deviation=50.0).force(60_000, np.random.default_rng(3))
    np.testing.assert_allclose(force[20_000:] + 300.0, gust[20_000:], rtol=1e-9)


def test_a_drawn_mission_keeps_to_what_the_unit_can_do() -> None:
    """Within the stroke, and a load changes where the duty does."""
    duties = {"mission": 1.0, "steps": 1.0, "resting": 1.0}
    recipe = recipe_with(healthy_share=1.0, duration=(120.0, 120.0), duties=duties, loads={"changing": 1.0})
    seen = 0
    for index in range(40):
        rig = draw_unit(recipe, stream(recipe, "unit", index), index)
        scenario = draw_scenario(recipe, rig, stream(recipe, "log", index, 0, 0))
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


RECIPES = Path(__file__).parents[2] / "datasets"
SEEDS = range(25)
MINIMUM = ["position", "pump_speed", "pressure_difference"]


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["structures", "healthy", "laws"])
def test_shipped_recipes_read_back_and_all_their_units_can_be_drawn(name: str, step: int) -> None:
    recipe = Recipe.load(RECIPES / f"{name}.yaml")
    assert Recipe.from_yaml(recipe.to_yaml()) == recipe
    kinds = Counter(getattr(structure_of(recipe, k), "name", "") for k in range(recipe.units))
    assert set(kinds) == {each.name for each in recipe.structures}
    for index in range(0, recipe.units, step):
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
    instruments = {"rate": 200, "speed": "sampled", "channels": MINIMUM}
    few = Recording(**{**Recording.perfect().model_dump(), **instruments})
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
