"""What each fault writes into the conditions: from its onset on, with its severity, on its axis."""

import math
from typing import Any

import numpy as np
import pytest
from fault_case import choices
from hypothesis import given
from hypothesis import strategies as st

from fdd.campaign.sizes import Scale, Size, sized_unit
from fdd.faults import CATALOGUE
from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults import PLANT_FAULTS, FaultScales, FaultSpec, inject
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
TIME = np.arange(4000) * 1e-3
ONSET = 1.5
CHOICES = choices(PLANT_FAULTS)


def healthy(time: np.ndarray = TIME) -> np.ndarray:
    return c.healthy_conditions(UNIT, np.zeros(time.size), np.zeros(time.size))


def faulty(*specs: FaultSpec, time: np.ndarray = TIME, axis: int = 1, **scales: float) -> np.ndarray:
    rows = healthy(time)
    inject(rows, time, specs, FaultScales(**scales), Details(), axis=axis)
    return rows


def spec_of(name: str, side: int | None, variant: str | None, law: str | None, **more: Any) -> FaultSpec:
    return FaultSpec(fault=name, side=side, variant=variant, law=law, **{"severity": 1.0, **more})


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_a_fault_begins_at_its_onset_and_goes_with_its_severity(choice) -> None:
    """How large it is at severity 1 `test_plant_faults` measures."""
    before, time = healthy(TIME[::100]), TIME[::100]
    none, part, full = (faulty(spec_of(*choice, severity=k, onset=ONSET), time=time) for k in (0.0, 0.4, 1.0))
    assert none.tobytes() == before.tobytes()
    early = time < ONSET
    assert np.array_equal(full[early], before[early]) and not np.array_equal(full[~early], before[~early])
    if choice[-1] != "conductance":  # of which severity is the exponent
        np.testing.assert_allclose(part - before, 0.4 * (full - before), rtol=1e-9, atol=1e-26)


@pytest.mark.parametrize("fault", ["internal_leakage", "external_leakage"])
@pytest.mark.parametrize("machine", [None, 1, 2, 3])
def test_a_leak_passes_the_same_flow_at_the_leakage_pressure_by_whatever_law(fault, machine) -> None:
    other = machine and Scale(sized_unit(Size(), np.random.default_rng(machine)))
    scales = other.fault_scales({}) if other else {}
    pressure = FaultScales(**scales).leakage_pressure
    flows = []
    for law in CATALOGUE[fault].laws:
        row = (faulty(spec_of(fault, None, None, law), time=TIME[:1], **scales) - healthy(TIME[:1]))[0]
        laminar = row[[c.CROSS_LEAKAGE, c.SEAL_LEAKAGE, c.OUTSIDE_1]].sum() * pressure
        turbulent = row[[c.CROSS_ORIFICE, c.OUTSIDE_ORIFICE_1]].sum() * math.sqrt(pressure / 1e6)
        flows.append(laminar + turbulent + row[[c.CROSS_OPENING, c.OUTSIDE_OPENING_1]].sum() * pressure**2)
    if fault == "internal_leakage" and machine:
        flows.pop(0)  # its mixed law is given at 1 MPa, of every machine
    np.testing.assert_allclose(flows, flows[-1], rtol=1e-12)
    assert len(flows) >= 3 and flows[0] > 1e-6


def test_each_scale_can_be_overridden_and_is_used() -> None:
    """A scale that no fault reads would be a parameter without effect."""
    time = TIME[:1]
    standard = {choice: faulty(spec_of(*choice), time=time) for choice in CHOICES}
    # Not in the plant, see test_sensor_faults.
    measured = {f.name for entry in CATALOGUE.values() if entry.in_measurement for f in entry.figures}
    for field in FaultScales.model_fields.keys() - measured:
        usual = FaultScales.model_fields[field].default
        value = {"tight_friction": 3.0, "thick_viscosity": 4.0}.get(field, 0.9 * usual)
        assert any(
            not np.array_equal(faulty(spec_of(*choice), time=time, **{field: value}), rows)
            for choice, rows in standard.items()
        ), field


@given(
    st.lists(st.sampled_from(CHOICES), min_size=1, max_size=5, unique_by=lambda choice: choice[0]), st.data()
)
def test_the_order_in_which_faults_are_given_does_not_matter(chosen, data) -> None:
    specs = [spec_of(*choice, severity=data.draw(st.floats(0.0, 1.0))) for choice in chosen]
    time = np.array([0.0, 1.0])
    first = faulty(*specs, time=time)
    assert np.array_equal(first, faulty(*data.draw(st.permutations(specs)), time=time))
