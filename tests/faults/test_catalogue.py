"""The catalogue: what the contract promises, that each entry says what it means, and its signatures; and that
a new fault touches one module of the product and one line of a recipe, shown on a copy of the tree.
"""

import ast
import os
import re
import shutil
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import fdd.faults
from fdd.diagnosis.hypotheses import HealthyUnit
from fdd.faults import ADDED_BY, CATALOGUE, FAMILIES, Fault, Signature
from fdd.plant.details import Details
from fdd.plant.faults import PARAMETERS
from fdd.plant.sensors.faults import SENSOR_FAULTS
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import first_effects
from fdd.residuals.quantities import Scales
from fdd.samples import CHANNELS
from fdd.unit import Unit

# The contract's table, in its order; nothing may be renamed or moved to another family.
PROMISED = {
    "leakage": "internal_leakage external_leakage pump_wear case_drain_seal_failure shaft_seal_wear",
    "seal_wear": "seal_wear",
    "aeration": "aeration",
    "check_valve": "check_valve_stuck_open check_valve_clogged",
    "relief_valve": "relief_valve_stuck_open relief_valve_stuck_shut",
    "friction": "oil_degradation",
    "motor": "motor_degradation drive_failure coupling_wear",
    "sensor": "pressure_sensor_bias pressure_sensor_drift position_sensor_slip sensor_dropout",
    "unknown": "unknown",
}
FIGURES = {figure.name: figure.value for entry in CATALOGUE.values() for figure in entry.figures}
USED = {n for entry in CATALOGUE.values() for effect in entry.effects for n in effect.numbers}
ENTRIES = [f for f in CATALOGUE.values() if f.id != "unknown"]


def test_ids_and_families_are_the_promised_ones() -> None:
    assert tuple(FAMILIES) == ("healthy", *PROMISED)
    assert {f.family for f in CATALOGUE.values()} == set(PROMISED)
    promised = [(fault, family) for family, faults in PROMISED.items() for fault in faults.split()]
    # Others may be added.
    assert [(f.id, f.family) for f in CATALOGUE.values() if f.id in dict(promised)] == promised


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda f: f.id)
def test_each_entry_says_what_severity_one_means(entry: Fault) -> None:
    # A figure with its unit; of sensors that drop out, when.
    unit = r"(%|m³/\(s·Pa\)|m³/s|cm³/min|kPa|kPa/s|mm|degrees|s)"
    assert re.search(rf"\d {unit}(?=[\s,;.)]|$)", entry.severity), entry.severity
    fixed = entry.severity
    for amount in entry.amounts:
        assert amount.words() in fixed
        fixed = fixed.replace(amount.words(), "")
    assert " m³/" not in fixed, "a flow or leakage goes with the machine's size"
    assert entry.source, "where does that scale come from?"
    assert entry.plant and entry.title and (entry.thesis or entry.id in ADDED_BY)
    for variant in entry.variants:
        assert f"{variant}:" in entry.severity, f"severity of variant {variant}"
    for law, words in entry.laws.items():
        assert re.fullmatch(r"[a-z][a-z0-9_]*", law) and len(words.split()) >= 2, law


@pytest.mark.parametrize("entry", CATALOGUE.values(), ids=lambda f: f.id)
def test_each_entry_says_in_one_sentence_what_a_technician_does(entry: Fault) -> None:
    assert re.fullmatch(r"[A-Z][^.\n]*(\d\.\d[^.\n]*)*\.", entry.next_check), entry.next_check
    assert len(entry.next_check.split()) >= 10, "what with, and what is looked for?"


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda f: f.id)
def test_effects_name_what_there_is(entry: Fault) -> None:
    assert entry.simulated
    assert entry.in_measurement == (entry.id in SENSOR_FAULTS) == (not entry.effects)
    figures = {f.name for f in entry.figures}
    used = set()
    for effect in entry.effects:
        assert effect.parameter in PARAMETERS
        assert effect.side is None or effect.side in entry.sides
        assert set(effect.variants) <= set(entry.variants) and set(effect.laws) <= set(entry.laws)
        used |= {n for n in effect.numbers if isinstance(n, str)}
    # A figure may be another fault's: a leak by another way is as large.
    assert used <= {*FIGURES, *Details.model_fields}
    assert figures <= USED or entry.in_measurement, "a figure without effect"


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda f: f.id)
def test_each_choice_of_side_variant_and_law_differs_from_the_others(entry: Fault) -> None:
    choices = [*product(entry.sides or (None,), entry.variants or (None,), entry.laws or (None,))]
    if entry.effects:
        changes = [tuple(e for e in entry.effects if e.goes_with(*choice)) for choice in choices]
        assert all(changes) and len(set(changes)) == len(choices)
        assert len(entry.laws) != 1, "a choice of one"


def test_figures_have_one_name_and_are_within_what_is_allowed() -> None:
    figures = [f for entry in CATALOGUE.values() for f in entry.figures]
    names = [f.name for f in figures]
    assert len(set(names)) == len(names)
    assert not set(names) & set(Details.model_fields), "an effect could not tell them apart"
    for figure in figures:
        low, high = figure.allowed
        assert low <= figure.value <= high
        if figure.usual:
            assert low <= figure.usual[0] <= figure.value <= figure.usual[1] <= high


@pytest.mark.parametrize("path", sorted(Path(fdd.faults.__file__).parent.glob("*.py")), ids=lambda p: p.stem)
def test_the_catalogue_needs_nothing_but_the_standard_library(path: Path) -> None:
    """Plant and diagnosis both read it, so it may know neither."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
        for name in names:
            ours = name in ("fdd.errors", "fdd.packages") or name.startswith("fdd.faults")
            assert ours or name.split(".")[0] in sys.stdlib_module_names, name


UNITS = ("axis_a", "axis_b")
SIGNATURES = [(entry, signature) for entry in CATALOGUE.values() for signature in entry.signatures]
WITHOUT = {
    "shaft_seal_wear": "a drip takes hours to show",
    "relief_valve_stuck_shut": "sound below the setting, where logs are taken",
    "position_sensor_slip": "what the encoder does is told by its own checks",
    "sensor_dropout": "what the sensor does is told by its own checks",
    "unknown": "is what no signature explains",
}
"""Faults without a signature, and why."""
WITHOUT_THEIR_OWN = {"wet": "thick oil of less severity, but for its vapour, which no balance has"}
"""Variants without a signature, and why."""


def typical(name: str) -> HealthyUnit:
    """One of which only the data sheet is known."""
    return HealthyUnit({n: first_effects(n) for n in BALANCES}, Scales.of(Unit.load(name)))


def test_every_fault_has_a_signature_or_a_reason() -> None:
    assert {entry.id for entry in CATALOGUE.values() if not entry.signatures} == set(WITHOUT)


@pytest.mark.parametrize(
    ("entry", "signature"), SIGNATURES, ids=lambda x: getattr(x, "id", getattr(x, "label", ""))
)
@pytest.mark.parametrize("unit", UNITS)
def test_names_exist_and_columns_are_finite(entry: Fault, signature: Signature, unit: str) -> None:
    found = signature.columns(typical(unit))
    assert found
    for balance, columns in found.items():
        assert set(columns) <= set(BALANCES[balance].columns)
        values = np.array(list(columns.values()))
        assert np.isfinite(values).all() and values.any()
    assert signature.side is None or signature.side in entry.sides
    assert signature.variant is None or signature.variant in entry.variants
    assert signature.law is None or signature.law in tuple(entry.laws)[1:]
    assert signature.channel is None or signature.channel in CHANNELS
    assert set(signature.courses) <= {"step", "ramp", "drift"} and signature.courses
    assert 0.0 < signature.commonness <= 1.0
    assert (signature.channel is not None) == entry.in_measurement


@pytest.mark.parametrize("entry", CATALOGUE.values(), ids=lambda f: f.id)
def test_labels_tell_the_signatures_apart_and_each_side_and_variant_can_be_named(entry: Fault) -> None:
    labels = [signature.label for signature in entry.signatures]
    assert len(set(labels)) == len(labels)
    if entry.signatures and not entry.in_measurement:
        assert {s.side for s in entry.signatures} >= set(entry.sides)
        assert {s.variant for s in entry.signatures} >= set(entry.variants) - set(WITHOUT_THEIR_OWN)


@pytest.mark.parametrize("name", UNITS)
def test_severity_one_is_the_same_in_the_plant_and_in_the_balances(name: str) -> None:
    """Coefficients in the units of their columns (`fdd.residuals.balances`) against the plant's figures."""
    unit = typical(name)
    scales = unit.scales

    def change(fault: str, balance: str, column: str, index: int = 0) -> float:
        return CATALOGUE[fault].signatures[index].columns(unit)[balance][column]

    def share(fault: str, balance: str, column: str, index: int = 0) -> float:
        """The coefficient over the healthy one."""
        return 1.0 + change(fault, balance, column, index) / unit.mean(balance, column)

    leak, orifice = scales.leakage, scales.orifice * np.sqrt(1e6)  # whose columns are per root of pressure
    expected = {
        "internal_leakage": leak * change("internal_leakage", "volume", "leak"),
        "case_leakage": leak * change("case_drain_seal_failure", "volume", "case"),
        "external_leakage": leak * change("external_leakage", "volume", "outside_1"),
        "internal_leakage at 1 MPa": orifice * change("internal_leakage", "volume", "relief_12", 1) / 1e6,
        "external_leakage at 1 MPa": orifice * change("external_leakage", "volume", "valve_1", 2) / 1e6,
        # The column is per full speed, the figure per 100 rad/s.
        "pump_wear_leakage": leak * change("pump_wear", "volume", "wear") * 100.0 / scales.speed,
        # A pump that displaces less leaves flow over in D Δθ - A Δx.
        "pump_wear_displacement_loss": change("pump_wear", "volume", "gain"),
        "free_air": 0.025 * change("aeration", "volume", "air"),
        "check_valve_flow": orifice * change("check_valve_stuck_open", "volume", "valve_1"),
        "relief_valve_flow": orifice * change("relief_valve_stuck_open", "volume", "relief_12"),
        "pressure_bias": scales.pressure * change("pressure_sensor_bias", "coherence", "zero"),
        # The same pressure takes 1/(1 - loss) of the current.
        "torque_loss": 1.0 - 1.0 / share("motor_degradation", "torque", "pressure"),
        "thin_viscosity": share("oil_degradation", "torque", "viscous"),
        "thick_viscosity": 1.0 / share("oil_degradation", "volume", "leak", 1),
        "loose_friction": share("seal_wear", "force", "friction_forward"),
        "tight_friction": share("seal_wear", "force", "friction_reverse", 6),
    }
    for figure, value in expected.items():
        assert value == pytest.approx(FIGURES[figure.removesuffix(" at 1 MPa")], rel=0.01), figure
    # What leaves one chamber also leaves the reservoir.
    lost = 0.5 * scales.fault_leakage * change("external_leakage", "reservoir", "outside_1")
    assert lost == pytest.approx(FIGURES["external_leakage"])


ROOT = Path(__file__).parents[2]
DIFF = Path(__file__).parent / "adding_a_fault.diff"
NEW = "bypass_valve_ajar"
USE = f"""
from pathlib import Path
import numpy as np
from fdd import Scenario, Unit
import fdd
assert Path(fdd.__file__).is_relative_to(Path.cwd()), fdd.__file__

from fdd.faults import CATALOGUE
assert "{NEW}" in [f.id for f in CATALOGUE.values() if f.family == "leakage"][5:]
assert CATALOGUE["{NEW}"].signatures

from fdd.campaign.recipe import Recipe
assert Recipe.load("datasets/wide.yaml").faults["{NEW}"].weight == 0.3

from fdd.campaign.sizes import Scale, Size, sized_unit
larger = Scale(sized_unit(Size(), np.random.default_rng(1))).fault_scales({{}})
assert np.isclose(larger["bypass_valve_flow"], 0.5 * larger["relief_valve_flow"], rtol=1e-12)

from fdd.plant import conditions as c
from fdd.plant.faults import parse_fault
from fdd.plant.prepare import axis_conditions
for scales, flow in (({{}}, 5e-5), ({{"bypass_valve_flow": 2e-5}}, 2e-5)):
    faults = [parse_fault("{NEW}:severity=0.4,onset=1")]
    scenario = Scenario(faults=faults, fault_scales=scales)
    time = np.array([0.0, 1.0, 2.0])
    rows = axis_conditions(Unit.load("axis_a"), scenario, time, np.zeros(3), np.zeros(3))[0]
    np.testing.assert_allclose(rows[:, c.BYPASS], [0.0, 0.4 * flow, 0.4 * flow])
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tree with the diff applied."""
    folder = tmp_path_factory.mktemp("tree")
    for name in ("fdd", "estimators", "datasets"):
        # With the compiled code, which holds no fault.
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc", "*.mcap"))
    alone = {"GIT_CEILING_DIRECTORIES": str(folder.parent)}  # or a repository around it would be meant
    subprocess.run(["git", "apply", str(DIFF)], cwd=folder, env={**os.environ, **alone}, check=True)
    return folder


def test_the_diff_is_one_new_module_and_one_recipe_line() -> None:
    parts = re.split(r"^diff --git .*\n", DIFF.read_text("utf-8"), flags=re.MULTILINE)[1:]
    recipes = [p for p in parts if "+++ b/datasets/" in p]
    modules = [p for p in parts if f"--- /dev/null\n+++ b/fdd/faults/{NEW}.py" in p]
    assert (len(parts), len(recipes), len(modules)) == (2, 1, 1)
    changed = [line for line in recipes[0].splitlines() if re.match(r"[+-](?![+-]{2} )", line)]
    assert changed == [f"+  {NEW}: {{weight: 0.3}}"]


@pytest.mark.slow
def test_it_is_in_the_catalogue_in_the_recipe_and_in_the_plant(copy: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    command = [sys.executable, "-c", USE]
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
