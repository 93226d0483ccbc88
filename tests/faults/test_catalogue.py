"""The catalogue: what the contract promises, and that each entry says what it means."""

from __future__ import annotations

import ast
import re
import sys
from itertools import product
from pathlib import Path

import pytest

import fdd.faults
from fdd.faults import ADDED_BY, CATALOGUE, FAMILIES, Fault
from fdd.plant.details import Details
from fdd.plant.faults.injection import PARAMETERS
from fdd.plant.sensors import SENSOR_FAULTS

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
FIGURES = {figure.name for entry in CATALOGUE.values() for figure in entry.figures}
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
    assert used <= FIGURES | set(Details.model_fields)
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
