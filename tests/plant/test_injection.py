"""What each fault writes into the conditions: from its onset on, with its severity, on its axis."""

from __future__ import annotations

import math
import re
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.campaign.sizes import Scale, Size, sized_unit
from fdd.faults import CATALOGUE
from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults.injection import PLANT_FAULTS, inject
from fdd.plant.faults.spec import SIMULATED, FaultScales, FaultSpec
from fdd.plant.rows import axis_conditions
from fdd.plant.scenario import Scenario
from fdd.plant.sensors import SENSOR_FAULTS
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
TIME = np.arange(4000) * 1e-3
ONSET = 1.5
CHOICES = [
    (entry.id, *choice)
    for entry in (CATALOGUE[name] for name in PLANT_FAULTS)
    for choice in product(entry.sides or (None,), entry.variants or (None,), entry.laws or (None,))
]


def healthy(time: np.ndarray = TIME) -> np.ndarray:
    return c.healthy_conditions(UNIT, np.zeros(time.size), np.zeros(time.size))


def faulty(*specs: FaultSpec, time: np.ndarray = TIME, axis: int = 1, **scales: float) -> np.ndarray:
    rows = healthy(time)
    inject(rows, time, specs, FaultScales(**scales), Details(), axis=axis)
    return rows


def test_every_simulated_fault_acts_on_plant_or_sensor() -> None:
    assert set(PLANT_FAULTS) == {f.id for f in CATALOGUE.values() if f.family not in ("sensor", "unknown")}, (
        "all of the contract's plant faults"
    )
    assert set(PLANT_FAULTS) <= set(SIMULATED) <= {*PLANT_FAULTS, *SENSOR_FAULTS}


def spec_of(name: str, side: int | None, variant: str | None, law: str | None, **more: Any) -> FaultSpec:
    return FaultSpec(fault=name, side=side, variant=variant, law=law, **{"severity": 1.0, **more})


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_severity_zero_leaves_every_number_bit_for_bit(choice) -> None:
    assert faulty(spec_of(*choice, severity=0.0)).tobytes() == healthy().tobytes()


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_a_fault_begins_at_its_onset_and_goes_with_its_severity(choice) -> None:
    """How large it is at severity 1 `test_plant_faults` measures."""
    before, time = healthy(TIME[::100]), TIME[::100]
    part, full = (faulty(spec_of(*choice, severity=k, onset=ONSET), time=time) for k in (0.4, 1.0))
    early = time < ONSET
    assert np.array_equal(full[early], before[early]) and not np.array_equal(full[~early], before[~early])
    if choice[-1] != "conductance":  # of which severity is the exponent
        np.testing.assert_allclose(part - before, 0.4 * (full - before), rtol=1e-9, atol=1e-26)


@pytest.mark.parametrize("fault", ["internal_leakage", "external_leakage"])
@pytest.mark.parametrize("machine", [None, 1, 2, 3])
def test_a_leak_passes_the_same_flow_at_the_leakage_pressure_by_whatever_law(fault, machine) -> None:
    """Of axis A and of machines of other sizes."""
    scales = {}
    if machine:
        scales = Scale(sized_unit(Size(), np.random.default_rng(machine))).fault_scales({})
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
    for field, info in FaultScales.model_fields.items():
        if field in measured:
            continue
        value = {"tight_friction": 3.0, "thick_viscosity": 4.0}.get(field, 0.9 * info.default)
        changed = [
            not np.array_equal(faulty(spec_of(*choice), time=time, **{field: value}), rows)
            for choice, rows in standard.items()
        ]
        assert any(changed), field


def test_what_the_catalogue_calls_severity_one_is_not_drawn_by_campaigns() -> None:
    """Or the same severity would mean another leakage in another log."""
    named = {"internal_leakage", "external_leakage", "pump_wear_leakage", "case_leakage", "free_air",
             "check_valve_flow", "relief_valve_flow", "loose_friction", "tight_friction", "torque_loss",
             "thin_viscosity", "thick_viscosity", "coupling_play", "shaft_leakage_flow", "leakage_pressure",
             "wet_viscosity", "wet_vapour", "pump_wear_worn_out", "check_valve_clogging", "open_phase",
             "check_valve_cracking", "check_valve_sticking", "relief_setting_loss", "relief_setting_gain",
             "relief_flow_loss", "shorted_braking", "drive_current_loss"}  # fmt: skip
    assert not named & set(FaultScales.usual)


def test_the_catalogues_figures_are_the_scales_defaults() -> None:
    scales = FaultScales()

    def figures(name: str) -> list[float]:
        text = CATALOGUE[name].severity
        return [float(f) for f in re.findall(r"(?<![\w^])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?", text)]

    at_first = {  # the words go on with other figures
        "internal_leakage": scales.internal_leakage, "external_leakage": scales.external_leakage,
        "case_drain_seal_failure": scales.case_leakage, "aeration": 100.0 * scales.free_air,
        "check_valve_stuck_open": scales.check_valve_flow,
        "relief_valve_stuck_open": scales.relief_valve_flow,
    }  # fmt: skip
    assert {name: figures(name)[0] for name in at_first} == at_first
    for name, expected in {
        "pump_wear": [scales.pump_wear_leakage, 100.0, -100.0 * scales.pump_wear_displacement_loss,
                      100.0 * scales.pump_wear_ripple],
        "shaft_seal_wear": [scales.shaft_leakage_flow * 60e6, scales.shaft_leakage_pressure / 1e3],
        "seal_wear": [100.0 * scales.loose_friction, scales.loose_rod_leakage, 100.0 * scales.tight_friction],
        "oil_degradation": [100.0 * scales.thin_viscosity, 100.0 * scales.thick_viscosity, scales.wet_vapour,
                            100.0 * scales.wet_viscosity],
        "check_valve_clogged": [100.0 * 10.0**-scales.check_valve_clogging],
        "relief_valve_stuck_shut": [100.0 * scales.relief_flow_loss],
        "drive_failure": [100.0 * scales.drive_current_loss, -50.0 * scales.drive_current_loss],
        "motor_degradation": [-100.0 * scales.torque_loss, 100.0 * scales.resistance_gain,
                              -100.0 * scales.current_limit_loss],
        "coupling_wear": [np.rad2deg(scales.coupling_play), 100.0 * scales.coupling_eccentricity],
    }.items():  # fmt: skip
        assert figures(name) == pytest.approx(expected, rel=1e-3 if name == "coupling_wear" else 1e-9), name
    # Those that the words of a law give.
    assert (
        "three times" in CATALOGUE["relief_valve_stuck_shut"].severity and scales.relief_setting_gain == 2.0
    )
    assert scales.leakage_pressure == 1e6 and scales.pump_wear_worn_out == 0.1 and scales.open_phase == 1.0
    assert scales.check_valve_cracking == pytest.approx(UNIT.accumulator.charge_pressure, rel=0.01)
    assert scales.check_valve_sticking == 8e5 and scales.relief_setting_loss == 0.9
    assert 100.0 * scales.shorted_braking == pytest.approx(0.2), "N·m at 100 rad/s"


# Together, on two axes, and in stretches.


@given(
    st.lists(st.sampled_from(CHOICES), min_size=1, max_size=5, unique_by=lambda choice: choice[0]),
    st.data(),
)
def test_the_order_in_which_faults_are_given_does_not_matter(chosen, data) -> None:
    specs = [spec_of(*choice, severity=data.draw(st.floats(0.0, 1.0))) for choice in chosen]
    time = np.array([0.0, 1.0])
    first = faulty(*specs, time=time)
    assert np.array_equal(first, faulty(*data.draw(st.permutations(specs)), time=time))


def test_a_fault_stays_on_its_axis() -> None:
    specs = [
        FaultSpec(fault="aeration", severity=1.0),
        FaultSpec(fault="aeration", severity=0.2, axis=2),
        FaultSpec(fault="coupling_wear", severity=1.0, axis=2),
    ]
    one, two = faulty(*specs), faulty(*specs, axis=2)
    air = UNIT.oil.air_fraction
    assert one[0, c.AIR_1] == pytest.approx(air + 0.025) and not one[:, c.PLAY].any()
    assert two[0, c.AIR_2] == pytest.approx(air + 0.005) and two[0, c.PLAY] > 0.03


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_what_comes_with_load_or_heat_is_kept_apart_at_its_full(choice) -> None:
    time, nothing = TIME[::500], np.zeros(8)
    always = FaultSpec(fault="coupling_wear", severity=0.3)
    for profile, other in (("load", "by_heat"), ("heat", "by_load")):
        faults = [always, spec_of(*choice, onset=ONSET, profile=profile)][choice[0] == "coupling_wear" :]
        found = axis_conditions(UNIT, Scenario(faults=faults), time, nothing, nothing)
        alone = axis_conditions(UNIT, Scenario(faults=faults[:-1]), time, nothing, nothing).rows
        stepped = faults[-1].model_copy(update={"profile": "step"})
        both = axis_conditions(UNIT, Scenario(faults=[*faults[:-1], stepped]), time, nothing, nothing).rows
        assert np.array_equal(found.rows, alone) and getattr(found, other) is None
        np.testing.assert_allclose(alone + getattr(found, f"by_{profile}"), both, rtol=1e-12, atol=1e-26)
