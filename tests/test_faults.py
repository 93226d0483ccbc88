"""The catalogue: what the contract promises, and that each entry says what it means."""

from __future__ import annotations

import re

import pytest

from fdd.errors import InputError
from fdd.faults import CATALOGUE, FAMILIES, Fault, fault, faults_of

# The contract's table, in its order; nothing may be renamed or moved to another family.
PROMISED = {
    "internal_leakage": "leakage",
    "external_leakage": "leakage",
    "pump_wear": "leakage",
    "case_drain_seal_failure": "leakage",
    "shaft_seal_wear": "leakage",
    "seal_wear": "seal_wear",
    "aeration": "aeration",
    "check_valve_stuck_open": "check_valve",
    "check_valve_clogged": "check_valve",
    "relief_valve_stuck_open": "relief_valve",
    "oil_degradation": "friction",
    "motor_degradation": "motor",
    "coupling_wear": "motor",
    "pressure_sensor_bias": "sensor",
    "pressure_sensor_drift": "sensor",
    "position_sensor_slip": "sensor",
    "sensor_dropout": "sensor",
    "unknown": "unknown",
}
ENTRIES = [f for f in CATALOGUE.values() if f.id != "unknown"]


def test_ids_and_families_are_the_promised_ones() -> None:
    assert {f.id: f.family for f in CATALOGUE.values()} == PROMISED
    assert list(CATALOGUE) == list(PROMISED)


def test_families_are_the_keys_of_an_answers_probabilities() -> None:
    assert FAMILIES == (
        "healthy", "leakage", "seal_wear", "aeration", "check_valve", "relief_valve", "friction", "motor",
        "sensor", "unknown",
    )  # fmt: skip
    assert {f.family for f in CATALOGUE.values()} == set(FAMILIES) - {"healthy"}


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda f: f.id)
def test_each_entry_says_what_severity_one_means(entry: Fault) -> None:
    # In physical units: a figure, or what is left of something that was there.
    assert re.search(r"\d|half", entry.severity), entry.severity
    assert entry.source, "where does that scale come from?"
    assert entry.plant and entry.thesis and entry.title
    for variant in entry.variants:
        assert f"{variant}:" in entry.severity, f"severity of variant {variant}"


@pytest.mark.parametrize("entry", CATALOGUE.values(), ids=lambda f: f.id)
def test_key_is_the_id(entry: Fault) -> None:
    assert fault(entry.id) is entry
    assert entry.id in faults_of(entry.family)


def test_every_family_lists_its_faults_once() -> None:
    listed = [name for family in FAMILIES for name in faults_of(family)]
    assert sorted(listed) == sorted(PROMISED)


def test_unknown_id_lists_the_catalogue() -> None:
    with pytest.raises(InputError) as caught:
        fault("leek")
    line = str(caught.value)
    assert line.startswith("unknown fault 'leek'; the catalogue has: internal_leakage, ")
    assert all(name in line for name in PROMISED)
