"""What each fault writes into the conditions: its own columns, by the figures of the catalogue."""

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
from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults.injection import PLANT_FAULTS, inject
from fdd.plant.faults.spec import SIMULATED, FaultScales, FaultSpec, parse_fault
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
COURSES = ("step", "ramp", "intermittent", "exponential", "random")
Changes = dict[int, float]


def rubbing(law: str | None, change: float, way: str, *, loose: bool) -> Changes:
    """A worn seal; what both directions have in common takes half where one is worn."""
    forward = [c.FRICTION_FORWARD, c.COULOMB_FORWARD, c.STRIBECK_FORWARD]
    reverse = [c.FRICTION_REVERSE, c.COULOMB_REVERSE, c.STRIBECK_REVERSE]
    whole, level, rest = zip(*([forward] * (way != "reverse") + [reverse] * (way != "forward")), strict=True)
    common = 0.5 if way else 1.0
    if law == "track":
        return {c.MIDDLE: common * change, **(dict.fromkeys(whole, 0.5 * change) if way else {})}
    if law == "viscous":
        steeper = -1.0 if loose else 3.0 * change
        return {c.VISCOUS: common * steeper, **dict.fromkeys(level, 0.5 * change)}
    if law == "whole":
        return {c.VISCOUS: common * change, **dict.fromkeys(whole, change)}
    return dict.fromkeys(level if law == "coulomb" else rest, change)


def by_figures(f: FaultScales, d: Details) -> dict[tuple[str, object, str | None], Changes]:
    """Fault, side or variant, and law to what severity 1 adds to each column, or by what share it changes.

    Written down from the catalogue's words, not from the code.
    """
    leak, orifice = f.internal_leakage, f.internal_leakage_orifice_share
    # The same flow at that pressure, whether by its root or by its square.
    root, square = math.sqrt(f.leakage_pressure * 1e6), 1.0 / f.leakage_pressure
    drip, winding = f.shaft_leakage_flow / f.shaft_leakage_pressure, f.torque_loss
    past = {
        c.SEAL_LEAKAGE: d.loose_seal_leakage,
        c.OUTSIDE_1: f.loose_rod_leakage,
        c.OUTSIDE_2: f.loose_rod_leakage,
    }
    expected: dict[tuple[str, object, str | None], Changes] = {
        ("internal_leakage", None, "mixed"): {
            c.CROSS_LEAKAGE: leak - leak * orifice, c.CROSS_ORIFICE: leak * orifice * 1e6,
        },
        ("internal_leakage", None, "laminar"): {c.CROSS_LEAKAGE: leak},
        ("internal_leakage", None, "orifice"): {c.CROSS_ORIFICE: leak * root},
        ("internal_leakage", None, "opening"): {c.CROSS_OPENING: leak * square},
        ("internal_leakage", None, "piston"): {c.SEAL_LEAKAGE: leak},
        ("pump_wear", None, "mixed"): {
            c.SPEED_LEAKAGE: f.pump_wear_leakage / 100.0, c.DISPLACEMENT: -f.pump_wear_displacement_loss,
            c.RIPPLE: f.pump_wear_ripple,
        },
        ("pump_wear", None, "displacement"): {
            c.DISPLACEMENT: -f.pump_wear_worn_out, c.RIPPLE: f.pump_wear_ripple,
        },
        ("pump_wear", None, "gap"): {
            c.CROSS_LEAKAGE: 0.7 * leak, c.CASE_LEAKAGE_1: 0.3 * leak, c.CASE_LEAKAGE_2: 0.3 * leak,
            c.RIPPLE: f.pump_wear_ripple,
        },
        ("pump_wear", None, "speed"): {c.SPEED_LEAKAGE: f.pump_wear_leakage / 100.0},
        ("case_drain_seal_failure", None, "both"): {
            c.CASE_LEAKAGE_1: f.case_leakage, c.CASE_LEAKAGE_2: f.case_leakage,
        },
        ("case_drain_seal_failure", None, "one"): {c.CASE_LEAKAGE_1: 2.0 * f.case_leakage},
        ("shaft_seal_wear", None, "steady"): {c.SHAFT_LEAKAGE: drip},
        ("shaft_seal_wear", None, "running"): {c.SHAFT_LEAKAGE: drip / 4, c.SHAFT_SPEED: 0.0075 * drip},
        ("aeration", None, "exchange"): {c.AIR_1: f.free_air, c.AIR_2: f.free_air},
        ("aeration", None, "chamber_1"): {c.AIR_1: f.free_air},
        ("aeration", None, "chamber_2"): {c.AIR_2: f.free_air},
        ("aeration", None, "ingress"): {c.INGRESS: f.free_air},
        ("relief_valve_stuck_open", None, "orifice"): {c.RELIEF_OPEN: f.relief_valve_flow},
        ("relief_valve_stuck_open", None, "setting"): {c.RELIEF_SETTING: -f.relief_setting_loss},
        ("relief_valve_stuck_shut", None, "shut"): {c.RELIEF_GAIN: -f.relief_flow_loss},
        ("relief_valve_stuck_shut", None, "setting"): {c.RELIEF_SETTING: f.relief_setting_gain},
        ("oil_degradation", "thin", None): {c.VISCOSITY: f.thin_viscosity - 1.0},
        ("oil_degradation", "thick", None): {c.VISCOSITY: f.thick_viscosity - 1.0},
        ("oil_degradation", "wet", None): {
            c.VISCOSITY: f.wet_viscosity - 1.0, c.VAPOUR: f.wet_vapour - 1.0,
        },
        ("motor_degradation", None, "winding"): {
            c.TORQUE: -winding, c.RESISTANCE: f.resistance_gain, c.CURRENT_LIMIT: -f.current_limit_loss,
        },
        ("motor_degradation", None, "magnets"): {c.TORQUE: -winding},
        ("motor_degradation", None, "shorted"): {
            c.TORQUE: -winding / 2.0, c.RESISTANCE: -winding, c.BRAKING: f.shorted_braking,
        },
        ("motor_degradation", None, "phase"): {c.PHASE: 2.0 * winding},
        ("drive_failure", None, "dead"): {c.CURRENT_LIMIT: -f.drive_current_loss},
        ("drive_failure", None, "phase"): {
            c.PHASE: f.open_phase, c.CURRENT_LIMIT: -f.drive_current_loss / 2.0,
        },
        ("coupling_wear", None, "both"): {
            c.PLAY: f.coupling_play, c.ECCENTRICITY: f.coupling_eccentricity,
        },
        ("coupling_wear", None, "play"): {c.PLAY: f.coupling_play},
        ("coupling_wear", None, "bent"): {c.ECCENTRICITY: f.coupling_eccentricity},
    }  # fmt: skip
    for side, outside, hole, joint, ajar, sticking, refeed, cracking in (
        (1, c.OUTSIDE_1, c.OUTSIDE_ORIFICE_1, c.OUTSIDE_OPENING_1, c.OPEN_1, c.STICKING_1, c.REFEED_1,
         c.CRACKING_1),
        (2, c.OUTSIDE_2, c.OUTSIDE_ORIFICE_2, c.OUTSIDE_OPENING_2, c.OPEN_2, c.STICKING_2, c.REFEED_2,
         c.CRACKING_2),
    ):  # fmt: skip
        expected |= {
            ("external_leakage", side, "laminar"): {outside: f.external_leakage},
            ("external_leakage", side, "orifice"): {hole: f.external_leakage * root},
            ("external_leakage", side, "opening"): {joint: f.external_leakage * square},
            ("check_valve_stuck_open", side, "gap"): {ajar: f.check_valve_flow},
            ("check_valve_stuck_open", side, "sticking"): {sticking: f.check_valve_sticking},
            ("check_valve_clogged", side, "conductance"): {refeed: -f.check_valve_clogging},
            ("check_valve_clogged", side, "cracking"): {cracking: f.check_valve_cracking},
            ("check_valve_clogged", side, "starved"): {refeed: -1.0},
        }
    for law in ("whole", "coulomb", "stribeck", "viscous", "track"):
        for way in ("", "forward", "reverse"):
            loose = rubbing(law, f.loose_friction - 1.0, way, loose=True)
            tight = rubbing(law, f.tight_friction - 1.0, way, loose=False)
            expected["seal_wear", "_".join(filter(None, ("loose", way))), law] = loose | past
            expected["seal_wear", "_".join(filter(None, ("tight", way))), law] = tight
    return expected


def put_by_hand(rows: np.ndarray, spec: FaultSpec, time: np.ndarray, changes: Changes) -> None:
    """What a fault of those changes makes of rows, in place."""
    severity = spec.over(time)
    for column, value in changes.items():
        if spec.law == "conductance":
            rows[:, column] *= 10.0 ** (severity * value)
        elif column in c.WHOLE:
            rows[:, column] *= 1.0 + severity * value
        else:
            rows[:, column] += severity * value


STANDARD = by_figures(FaultScales(), Details())
KNOWN = [choice for choice in CHOICES if choice[0] in {name for name, *_ in STANDARD}]


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
    assert {(name, side or variant, law) for name, side, variant, law in KNOWN} == set(STANDARD)


def spec_of(name: str, side: int | None, variant: str | None, law: str | None, **more: Any) -> FaultSpec:
    return FaultSpec(fault=name, side=side, variant=variant, law=law, **{"severity": 1.0, **more})


@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_severity_zero_leaves_every_number_bit_for_bit(choice) -> None:
    assert faulty(spec_of(*choice, severity=0.0)).tobytes() == healthy().tobytes()


@pytest.mark.parametrize("severity", [1.0, 0.4])
@pytest.mark.parametrize("choice", KNOWN, ids=str)
def test_a_fault_changes_its_columns_from_its_onset_on_as_the_catalogue_says(choice, severity) -> None:
    name, side, variant, law = choice
    spec = spec_of(*choice, severity=severity, onset=ONSET)
    changes = {column: value for column, value in STANDARD[name, side or variant, law].items() if value}
    rows, before, expected = faulty(spec), healthy(), healthy()
    assert np.array_equal(rows[TIME < ONSET], before[TIME < ONSET])
    assert set(np.flatnonzero(rows[-1] != before[-1])) == set(changes)
    put_by_hand(expected, spec, TIME, changes)
    np.testing.assert_allclose(rows, expected, rtol=1e-13, atol=1e-26)


@pytest.mark.parametrize("name", sorted({name for name, *_ in KNOWN}))
def test_no_two_choices_do_the_same(name) -> None:
    found = {faulty(spec_of(*choice), time=TIME[:1]).tobytes() for choice in CHOICES if choice[0] == name}
    assert len(found) == sum(choice[0] == name for choice in CHOICES)


@pytest.mark.parametrize("fault", ["internal_leakage", "external_leakage"])
@pytest.mark.parametrize("machine", [None, 1, 2, 3])
def test_a_leak_passes_the_same_flow_at_the_leakage_pressure_by_whatever_law(fault, machine) -> None:
    """Of axis A and of machines of other sizes."""
    scales = {}
    if machine:
        scales = Scale.of(sized_unit(Size(), np.random.default_rng(machine))).fault_scales({})
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


def test_usual_ranges_hold_the_default_and_are_allowed() -> None:
    for field, (low, high) in FaultScales.usual.items():
        assert low <= FaultScales.model_fields[field].default <= high, field
        FaultScales(**{field: low})
        FaultScales(**{field: high})


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

    assert figures("internal_leakage")[:1] == [scales.internal_leakage]
    assert figures("external_leakage")[:1] == [scales.external_leakage]
    loss, ripple = scales.pump_wear_displacement_loss, scales.pump_wear_ripple
    assert figures("pump_wear") == [scales.pump_wear_leakage, 100.0, -100.0 * loss, 100.0 * ripple]
    assert figures("case_drain_seal_failure")[:1] == [scales.case_leakage]
    flow = scales.shaft_leakage_flow * 60e6
    assert figures("shaft_seal_wear") == pytest.approx([flow, scales.shaft_leakage_pressure / 1e3])
    loose, tight = 100.0 * scales.loose_friction, 100.0 * scales.tight_friction
    assert figures("seal_wear") == [loose, scales.loose_rod_leakage, tight]
    assert figures("aeration")[:1] == [100.0 * scales.free_air]
    assert figures("check_valve_stuck_open")[:1] == [scales.check_valve_flow]
    assert figures("relief_valve_stuck_open")[:1] == [scales.relief_valve_flow]
    thin, thick = 100.0 * scales.thin_viscosity, 100.0 * scales.thick_viscosity
    wet = [scales.wet_vapour, 100.0 * scales.wet_viscosity]
    assert figures("oil_degradation") == [thin, thick, *wet]
    assert figures("check_valve_clogged") == pytest.approx([100.0 * 10.0**-scales.check_valve_clogging])
    assert figures("relief_valve_stuck_shut") == [100.0 * scales.relief_flow_loss]
    assert (
        "three times" in CATALOGUE["relief_valve_stuck_shut"].severity and scales.relief_setting_gain == 2.0
    )
    assert figures("drive_failure") == [100.0 * scales.drive_current_loss, -50.0 * scales.drive_current_loss]
    # Those that the words of a law give.
    assert scales.leakage_pressure == 1e6 and scales.pump_wear_worn_out == 0.1 and scales.open_phase == 1.0
    assert scales.check_valve_cracking == pytest.approx(UNIT.accumulator.charge_pressure, rel=0.01)
    assert scales.check_valve_sticking == 8e5 and scales.relief_setting_loss == 0.9
    assert 100.0 * scales.shorted_braking == pytest.approx(0.2), "N·m at 100 rad/s"
    assert figures("motor_degradation") == [
        -100.0 * scales.torque_loss, 100.0 * scales.resistance_gain, -100.0 * scales.current_limit_loss,
    ]  # fmt: skip
    play, swing = np.rad2deg(scales.coupling_play), 100.0 * scales.coupling_eccentricity
    assert figures("coupling_wear") == pytest.approx([play, swing], rel=1e-3)


# Together, on two axes, and in stretches.


@pytest.mark.parametrize("seed", range(40))
def test_any_faults_with_any_figures_change_any_conditions_as_by_hand(seed) -> None:
    rng = np.random.default_rng(seed)
    allowed = {figure.name: figure.allowed for entry in CATALOGUE.values() for figure in entry.figures}
    scales = FaultScales(**{name: float(rng.uniform(*ends)) for name, ends in allowed.items()})
    details = Details(loose_seal_leakage=float(rng.uniform(0.0, 1e-12)))
    chosen = [KNOWN[i] for i in rng.integers(len(KNOWN), size=6)]
    specs = [
        spec_of(
            *choice,
            severity=float(rng.uniform()),
            onset=float(rng.uniform(0.0, 3.0)),
            profile=str(rng.choice(COURSES)),
            ramp=1.7,
            period=0.6,
            seed=seed,
        )
        for choice in chosen
    ]
    before = healthy() * rng.uniform(0.5, 2.0, c.COLUMNS)
    rows, expected = before.copy(), before.copy()
    inject(rows, TIME, specs, scales, details)
    known = by_figures(scales, details)
    for spec in sorted(specs, key=lambda spec: list(CATALOGUE).index(spec.fault)):
        put_by_hand(expected, spec, TIME, known[spec.fault, spec.side or spec.variant, spec.law])
    assert not np.array_equal(rows, before)
    np.testing.assert_allclose(rows, expected, rtol=1e-12, atol=1e-26)


@given(
    st.lists(st.sampled_from(CHOICES), min_size=1, max_size=5, unique_by=lambda choice: choice[0]),
    st.data(),
)
def test_the_order_in_which_faults_are_given_does_not_matter(chosen, data) -> None:
    specs = [spec_of(*choice, severity=data.draw(st.floats(0.0, 1.0))) for choice in chosen]
    time = np.array([0.0, 1.0])
    first = faulty(*specs, time=time)
    assert np.array_equal(first, faulty(*data.draw(st.permutations(specs)), time=time))


@given(cut=st.integers(1, 3999), profile=st.sampled_from(COURSES))
def test_rows_do_not_depend_on_how_the_run_is_cut(cut, profile) -> None:
    specs = [
        FaultSpec(fault="pump_wear", severity=0.7, onset=0.9, profile=profile, ramp=1.7, period=0.6),
        FaultSpec(fault="external_leakage", severity=0.3, onset=0.1, side=2, profile=profile),
    ]
    parts = [faulty(*specs, time=part) for part in (TIME[:cut], TIME[cut:])]
    assert np.array_equal(np.concatenate(parts), faulty(*specs))


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


def test_the_axis_is_read_and_told() -> None:
    spec = parse_fault("aeration:severity=0.4,axis=2")
    assert spec.axis == 2 and spec.label()["axis"] == 2
    assert FaultSpec(fault="aeration", severity=0.4).label()["axis"] == 1
    for text in ("aeration:severity=0.4,axis=3", "aeration:severity=0.4,axis=b"):
        with pytest.raises(InputError, match="axis") as caught:
            parse_fault(text)
        assert "\n" not in str(caught.value)
