"""Drawing: shares are exact, units and scenarios stay within what the recipe and the unit allow."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from fdd.campaign.calibration import _throttle_for, calibration_runs
from fdd.campaign.drawing import assign_faults, draw_scenario, draw_unit, stream
from fdd.campaign.motion import fitting_duty
from fdd.campaign.population import BETWEEN_UNITS
from fdd.campaign.recipe import DRAWN_DUTIES, Recipe
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.plant.duty import DUTIES, ConstantSpeed
from fdd.plant.faults.spec import SIMULATED, FaultScales
from fdd.plant.load import LOADS
from fdd.plant.simulate import prepare, simulate
from fdd.unit import Unit

FOUR = ("internal_leakage", "seal_wear", "aeration", "check_valve_stuck_open")


def recipe_with(**fields: object) -> Recipe:
    given = {"schema": "fdd.recipe/1", "faults": {f: {} for f in FOUR}, **fields}
    return Recipe(**given)


@settings(deadline=None, max_examples=40)
@given(
    units=st.integers(1, 40),
    logs=st.integers(0, 9),
    healthy=st.floats(0.0, 1.0),
    weights=st.lists(st.floats(0.01, 10.0), min_size=4, max_size=4),
    seconds=st.sampled_from([0.0, 0.5]),
)
def test_numbers_of_faults_follow_the_shares_to_within_one(
    units: int, logs: int, healthy: float, weights: list[float], seconds: float
) -> None:
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
        assert min(values) >= 0.85 - 1e-6, name
        assert max(values) <= 1.15 + 1e-6, name
        # 60 uniform draws leave the outer fifth on either side empty once in 600 000 times.
        assert min(values) < 0.91, name
        assert max(values) > 1.09, name
    table = np.array([ratios[n] for n in ratios])
    correlation = np.corrcoef(table) - np.eye(len(table))
    assert np.abs(correlation).max() < 0.6  # each on its own: 60 draws give at most about 0.5


def test_area_mismatch_moves_the_second_area_only_within_its_bound() -> None:
    recipe = recipe_with(area_mismatch=0.02)
    ratios = []
    for index in range(20):
        cylinder = draw_unit(recipe, stream(recipe, "unit", index), index).unit.cylinder
        ratios.append(cylinder.area_2 / cylinder.area_1)
    assert np.ptp(ratios) > 0.01
    assert np.abs(np.array(ratios) - 1.0).max() <= 0.02 + 1e-6


def test_counting_sensors_keep_their_gain_and_analogue_ones_do_not() -> None:
    recipe = recipe_with()
    for index in range(10):
        unit = draw_unit(recipe, stream(recipe, "unit", index), index).unit
        base = Unit.load(recipe.bases[index % 2])
        assert unit.sensors["pump_angle"].gain == unit.sensors["position"].gain == 1.0
        assert 0.0 < abs(unit.sensors["pressure_difference"].gain - 1.0) <= 0.005
        assert abs(unit.sensors["pressure_difference"].zero) <= 8e3
        ratio = unit.sensors["pressure_1"].noise / base.sensors["pressure_1"].noise
        assert 0.5 - 1e-6 <= ratio <= 2.5 + 1e-6


@pytest.mark.parametrize("duty", sorted(DRAWN_DUTIES))
@pytest.mark.parametrize("load", sorted(LOADS))
def test_every_duty_with_every_load_fits_the_unit(duty: str, load: str) -> None:
    recipe = recipe_with(duties={duty: 1.0}, loads={load: 1.0}, duration=(3.0, 4.0), speed_control_share=0.5)
    for index in range(4):
        rig = draw_unit(recipe, stream(recipe, "unit", index), index)
        scenario = draw_scenario(recipe, rig, stream(recipe, "log", index, 0, 0), ("aeration",))
        assert scenario.duty.name == duty
        assert scenario.load.name == load
        ready = prepare(rig.unit, scenario)  # raises where the duty leaves the stroke
        demand = ready.setpoints[0]
        if scenario.control.mode == "position":
            assert np.abs(demand).max() <= 0.4 * rig.unit.cylinder.stroke + 1e-9
        else:
            assert np.abs(demand).max() <= rig.unit.drive.max_speed
        extreme = 0.5 * rig.unit.cylinder.stroke
        most = rig.unit.accumulator.relief_pressure * rig.unit.cylinder.area_1
        level = getattr(scenario.load, "level", 0.0)
        level = abs(level) if isinstance(level, float) else max(-level.least, level.most)
        reach = abs(scenario.duty.offset) + scenario.duty.amplitude + abs(scenario.load.centre)
        if scenario.load.one_sided:
            reach = scenario.duty.offset + scenario.duty.amplitude - scenario.load.centre
            assert reach >= 0.0, "the rod touches it"
        assert level + scenario.load.stiffness * min(reach, extreme) < most


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
        assert 0.7 <= aeration.severity <= 0.8
        assert 0.2 <= seal.severity <= 0.3
        assert drift.profile == "step"
        variants.add(seal.variant)
        for spec in scenario.faults:
            onsets.append(spec.onset / scenario.duration)
    assert variants == {"loose", "tight_forward"}
    late = np.array([o for o in onsets if o > 0.0])
    assert 0.3 < late.size / len(onsets) < 0.7
    assert late.min() >= 0.5 - 1e-4
    assert late.max() <= 0.6 + 1e-4


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
    assert {law for (how, _), found in seen.items() if how == "unseen" for law in found} > {
        "orifice",
        "shorted",
    }


def test_faults_come_in_all_courses_but_sensors_with_neither_load_nor_heat() -> None:
    faults: dict[str, object] = {f: {} for f in ("aeration", "pressure_sensor_bias", "pressure_sensor_drift")}
    both = recipe_with(faults=faults, profiles={"load": 1, "heat": 1, "random": 1})
    rig, specs = draw_unit(both, stream(both, "unit", 0), 0), []
    for k in range(60):
        specs += draw_scenario(both, rig, stream(both, "log", 0, k, 0), tuple(faults)).faults
    courses = {name: {s.profile for s in specs if s.fault == name} for name in faults}
    assert courses == {"aeration": {"load", "heat", "random"}, "pressure_sensor_bias": {"random"},
                       "pressure_sensor_drift": {"step"}}  # fmt: skip
    times = {s.seed for s in specs if s.profile == "random"}
    assert len(times) > 60 and {s.seed for s in specs if s.profile != "random"} == {0}
    none = recipe_with(faults=faults, profiles={"load": 1})
    (spec,) = draw_scenario(none, rig, stream(none, "log", 0, 0, 0), ("pressure_sensor_bias",)).faults
    assert spec.profile == "step"


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


def test_a_stuck_valve_sits_on_the_loaded_side_if_so_wanted() -> None:
    recipe = recipe_with(
        loads={"constant": 1.0}, ranges={"constant": {"level": [800.0, 2000.0]}}, stuck_valve="loaded",
        duties={"flight": 1.0}, duration=(3.0, 3.0),
    )  # fmt: skip
    rig = draw_unit(recipe, stream(recipe, "unit", 0), 0)
    for k in range(8):
        rng = stream(recipe, "log", 0, k, 0)
        scenario = draw_scenario(recipe, rig, rng, ("check_valve_stuck_open",))
        healthy = simulate(rig.unit, scenario.model_copy(update={"faults": []})).truth
        pressed = 1 if np.median(healthy["pressure_1"]) > np.median(healthy["pressure_2"]) else 2
        assert scenario.faults[0].side == pressed


def test_the_same_indices_draw_the_same_and_others_do_not() -> None:
    recipe = recipe_with(seed=3)
    rig = draw_unit(recipe, stream(recipe, "unit", 7), 7)
    assert draw_unit(recipe, stream(recipe, "unit", 7), 7) == rig
    assert draw_unit(recipe, stream(recipe, "unit", 9), 9).unit.cylinder != rig.unit.cylinder
    first = draw_scenario(recipe, rig, stream(recipe, "log", 7, 1, 0), ("aeration",))
    assert draw_scenario(recipe, rig, stream(recipe, "log", 7, 1, 0), ("aeration",)) == first
    others = [
        draw_scenario(recipe, rig, stream(recipe, *key), ("aeration",)).seed  # type: ignore[arg-type]
        for key in (("log", 7, 2, 0), ("log", 7, 1, 1), ("log", 8, 1, 0))
    ]
    assert len({first.seed, *others}) == 4
    other_seed = recipe_with(seed=4)
    assert draw_unit(other_seed, stream(other_seed, "unit", 7), 7).unit.pump != rig.unit.pump


def test_calibration_covers_speeds_and_pressures_without_touching_the_limits() -> None:
    recipe = recipe_with()
    for index in range(2):
        rig = draw_unit(recipe, stream(recipe, "unit", index), index)
        runs = calibration_runs(recipe, rig, stream(recipe, "baseline", index))
        assert 60.0 < sum(r.duration for r in runs) < 100.0
        free, sines, throttled = (simulate(rig.unit, r).truth for r in runs)
        for truth in (free, sines, throttled):
            assert not truth["stop_force"].any()
            assert np.abs(truth["relief_flow"]).max() < 1e-6
        assert isinstance(runs[0].duty, ConstantSpeed)
        for speed in runs[0].duty.speeds:
            for sign in (1.0, -1.0):
                there = np.abs(sign * free["pump_speed"] - speed) < 0.05 * speed
                assert there.mean() > 0.05, (speed, sign)
        pressure = throttled["pressure_difference"]
        assert 1.8e6 < pressure.max() < 3.2e6
        assert -3.2e6 < pressure.min() < -1.8e6
        assert sines["pump_speed"].std() > 30.0


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("faults", {"aerations": {}}, "aerations"),
        ("faults", {"unknown": {}}, "unknown"),
        ("faults", {"seal_wear": {"variants": ["wet"]}}, "use: loose, tight"),
        ("faults", {"aeration": {"variants": ["loose"]}}, "use: none"),
        ("faults", {"seal_wear": {"laws": ["wet"]}}, "use: whole, coulomb"),
        ("faults", {"sensor_dropout": {"laws": ["wet"]}}, "use: none"),
        ("faults", {"seal_wear": {"laws": []}}, "laws: Tuple should have at least 1"),
        ("laws", "some", "laws"),
        ("population", "normal", "population"),
        ("profiles", {"parabola": 1.0}, "use: step, ramp"),
        ("structures", [{"name": "a", "profile": {"accumulator": {"gas_volume": [0.0, 0.0]}}}], "gas_volume"),
        ("fault_scales", {"free_air": [0.01, 0.5]}, "free_air"),
        ("fault_scales", {"air": [0.01, 0.02]}, "unknown 'air'"),
        ("duties", {"levels": 1.0}, "use: standstill"),
        ("faults", {}, "no fault has a weight"),
        ("duties", {"steps": 0.0}, "all weights are 0"),
        ("loads", {"anvil": 1.0}, "anvil"),
        ("severity", [0.5, 0.2], "runs backwards"),
        ("severity", [0.5, 1.2], "leaves 0 to 1"),
        ("onset", [0.5, float("nan")], "onset"),
        ("units", 0, "units"),
        ("seed", -1, "seed"),
        ("bases", [], "bases"),
        ("unit", 3, "unit"),
        ("ranges", {"spring": {"stiffness": [1.0, 2.0]}}, "stiffness"),
        ("name", "../x", "name"),
    ],
)
def test_a_wrong_recipe_is_told_in_one_line(tmp_path: Path, field: str, value: object, told: str) -> None:
    path = tmp_path / "recipe.yaml"
    plain = {"schema": "fdd.recipe/1", "faults": {"aeration": {}}, field: value}
    path.write_text(yaml.safe_dump(plain), encoding="utf-8")
    with pytest.raises(InputError) as error:
        Recipe.load(path)
    assert told in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[1, 2]", "schema: fdd.unit/1", "a: [", "\x00", "schema: fdd.recipe/2"])
def test_what_is_no_recipe_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"recipe\.yaml"):
        Recipe.load(path)
    with pytest.raises(InputError, match="no such recipe"):
        Recipe.load(tmp_path / "missing.yaml")


@pytest.mark.parametrize("pressure", [1e6, 2.4e6])
def test_a_throttle_loads_the_fastest_stroke_with_what_is_asked(pressure: float) -> None:
    """Its drop grows with the square of the flow; friction is the rest, and what leaks does not pass it."""
    unit = Unit.load("axis_a")
    drop = _throttle_for(unit, pressure)
    fastest, stated = 110.0 * unit.pump.displacement, 100.0 * unit.pump.displacement
    passes = fastest - unit.pump.total_leakage * pressure
    made = drop * (passes / stated) ** 2 + unit.friction.forward.coulomb / unit.cylinder.area_1
    assert made == pytest.approx(pressure, rel=1e-9)


@pytest.mark.parametrize("name", sorted(set(DUTIES) - {"levels"}))
def test_only_duties_that_need_no_position_loop_are_done_at_a_commanded_speed(name: str) -> None:
    unit, rng = Unit.load("axis_a"), np.random.default_rng(3)
    for speed in (True, False):
        _, control = fitting_duty(name, unit, rng, {}, speed=speed, gain=1e4)
        never, always = (
            name in ("standstill", "strokes", "flight", "resting", "mission"),
            name == "constant_speed",
        )
        assert control.mode == ("speed" if always or (speed and not never) else "position")


@pytest.mark.parametrize(("name", "parts"), [("sines", (0.5, 0.86)), ("sawtooth", (0.8, 0.86))])
def test_a_set_point_asks_no_more_than_most_of_the_drives_speed(
    name: str, parts: tuple[float, float]
) -> None:
    """By the set-point itself, after its start; amplitudes of a machine with stroke to spare."""
    unit, rng, asked = Unit.load("axis_a"), np.random.default_rng(4), []
    unit.cylinder = unit.cylinder.model_copy(update={"stroke": 20.0})
    fastest = unit.drive.max_speed * unit.pump.displacement / unit.cylinder.area_1
    for _ in range(60):
        duty, _ = fitting_duty(name, unit, rng, {"amplitude": (5.0, 9.0)}, speed=False, gain=1e4)
        time = np.arange(0.0, 60.0, 1e-3)
        speed = np.abs(np.gradient(duty.amplitude * duty.shape(time, rng), time))[1000:]
        asked.append(np.quantile(speed, 0.999) / fastest)
    assert parts[0] < max(asked) <= parts[1]
