"""What each fault writes into the conditions: its own columns, by the figures of the catalogue."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdd.errors import InputError
from fdd.faults import CATALOGUE
from fdd.plant import conditions as c
from fdd.plant.details import Details
from fdd.plant.faults.injection import PLANT_FAULTS, inject
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import SIMULATED, FaultSpec, parse_fault
from fdd.plant.sensors import SENSOR_FAULTS
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
TIME = np.arange(4000) * 1e-3
ONSET = 1.5
CHOICES = [
    (name, side, variant)
    for name in PLANT_FAULTS
    for side in (CATALOGUE[name].sides or (None,))
    for variant in (CATALOGUE[name].variants or (None,))
]

# Fault, side and variant to what column becomes at severity 1 of healthy value h: written down from
# the catalogue's words, not from the code.
ADDED: dict[tuple[str, object], dict[int, float]] = {
    ("internal_leakage", None): {c.CROSS_LEAKAGE: 10.8e-12, c.CROSS_ORIFICE: 1.2e-6},
    ("external_leakage", 1): {c.OUTSIDE_1: 6e-12},
    ("external_leakage", 2): {c.OUTSIDE_2: 6e-12},
    ("pump_wear", None): {c.SPEED_LEAKAGE: 12e-14, c.DISPLACEMENT: -0.02, c.RIPPLE: 0.05},
    ("case_drain_seal_failure", None): {c.CASE_LEAKAGE: 24e-12},
    ("shaft_seal_wear", None): {c.SHAFT_LEAKAGE: 1e-6 / 60.0 / 487e3},
    ("seal_wear", "loose"): {
        c.FRICTION_FORWARD: -0.65, c.FRICTION_REVERSE: -0.65, c.VISCOUS: -0.65,
        c.OUTSIDE_1: 1e-14, c.OUTSIDE_2: 1e-14,
    },
    ("seal_wear", "tight"): {c.FRICTION_FORWARD: 1.0, c.FRICTION_REVERSE: 1.0, c.VISCOUS: 1.0},
    ("seal_wear", "loose_forward"): {
        c.FRICTION_FORWARD: -0.65, c.VISCOUS: -0.325, c.OUTSIDE_1: 1e-14, c.OUTSIDE_2: 1e-14,
    },
    ("seal_wear", "loose_reverse"): {
        c.FRICTION_REVERSE: -0.65, c.VISCOUS: -0.325, c.OUTSIDE_1: 1e-14, c.OUTSIDE_2: 1e-14,
    },
    ("seal_wear", "tight_forward"): {c.FRICTION_FORWARD: 1.0, c.VISCOUS: 0.5},
    ("seal_wear", "tight_reverse"): {c.FRICTION_REVERSE: 1.0, c.VISCOUS: 0.5},
    ("aeration", None): {c.AIR: 0.025},
    ("check_valve_stuck_open", 1): {c.OPEN_1: 1e-4},
    ("check_valve_stuck_open", 2): {c.OPEN_2: 1e-4},
    ("check_valve_clogged", 1): {c.REFEED_1: 1e-4 - 1.0},
    ("check_valve_clogged", 2): {c.REFEED_2: 1e-4 - 1.0},
    ("relief_valve_stuck_open", None): {c.RELIEF_OPEN: 1e-4},
    ("oil_degradation", "thin"): {c.VISCOSITY: -0.5},
    ("oil_degradation", "thick"): {c.VISCOSITY: 1.0},
    ("motor_degradation", None): {c.TORQUE: -0.3, c.RESISTANCE: 0.5, c.CURRENT_LIMIT: -0.2},
    ("coupling_wear", None): {c.PLAY: np.deg2rad(2.0), c.ECCENTRICITY: 0.02},
}  # fmt: skip

KNOWN = [choice for choice in CHOICES if choice[0] in {name for name, _ in ADDED}]


def by_figures(f: FaultScales, d: Details) -> dict[tuple[str, object], dict[int, float]]:
    """The same from a user's own figures: what is added, or the change as a share of what was there."""
    L, t, loose, tight = (
        f.internal_leakage,
        f.internal_leakage_orifice_share,
        f.loose_friction - 1.0,
        f.tight_friction - 1.0,
    )
    past = {
        c.SEAL_LEAKAGE: d.loose_seal_leakage,
        c.OUTSIDE_1: f.loose_rod_leakage,
        c.OUTSIDE_2: f.loose_rod_leakage,
    }
    forward, reverse = c.FRICTION_FORWARD, c.FRICTION_REVERSE
    return {
        ("internal_leakage", None): {c.CROSS_LEAKAGE: L - L * t, c.CROSS_ORIFICE: L * t * 1e6},
        ("external_leakage", 1): {c.OUTSIDE_1: f.external_leakage},
        ("external_leakage", 2): {c.OUTSIDE_2: f.external_leakage},
        ("pump_wear", None): {
            c.SPEED_LEAKAGE: f.pump_wear_leakage / 100.0, c.DISPLACEMENT: -f.pump_wear_displacement_loss,
            c.RIPPLE: f.pump_wear_ripple,
        },
        ("case_drain_seal_failure", None): {c.CASE_LEAKAGE: f.case_leakage},
        ("shaft_seal_wear", None): {c.SHAFT_LEAKAGE: f.shaft_leakage_flow / f.shaft_leakage_pressure},
        ("seal_wear", "loose"): {forward: loose, reverse: loose, c.VISCOUS: loose, **past},
        ("seal_wear", "loose_forward"): {forward: loose, c.VISCOUS: loose / 2.0, **past},
        ("seal_wear", "loose_reverse"): {reverse: loose, c.VISCOUS: loose / 2.0, **past},
        ("seal_wear", "tight"): {forward: tight, reverse: tight, c.VISCOUS: tight},
        ("seal_wear", "tight_forward"): {forward: tight, c.VISCOUS: tight / 2.0},
        ("seal_wear", "tight_reverse"): {reverse: tight, c.VISCOUS: tight / 2.0},
        ("aeration", None): {c.AIR: f.free_air},
        ("check_valve_stuck_open", 1): {c.OPEN_1: f.check_valve_flow},
        ("check_valve_stuck_open", 2): {c.OPEN_2: f.check_valve_flow},
        ("check_valve_clogged", 1): {c.REFEED_1: 10.0**-f.check_valve_clogging - 1.0},
        ("check_valve_clogged", 2): {c.REFEED_2: 10.0**-f.check_valve_clogging - 1.0},
        ("relief_valve_stuck_open", None): {c.RELIEF_OPEN: f.relief_valve_flow},
        ("oil_degradation", "thin"): {c.VISCOSITY: f.thin_viscosity - 1.0},
        ("oil_degradation", "thick"): {c.VISCOSITY: f.thick_viscosity - 1.0},
        ("motor_degradation", None): {
            c.TORQUE: -f.torque_loss, c.RESISTANCE: f.resistance_gain, c.CURRENT_LIMIT: -f.current_limit_loss,
        },
        ("coupling_wear", None): {c.PLAY: f.coupling_play, c.ECCENTRICITY: f.coupling_eccentricity},
    }  # fmt: skip


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
    assert {(name, side or variant) for name, side, variant in KNOWN} == set(ADDED)


@pytest.mark.parametrize(("name", "side", "variant"), CHOICES)
def test_severity_zero_leaves_every_number_bit_for_bit(name, side, variant) -> None:
    spec = FaultSpec(fault=name, severity=0.0, side=side, variant=variant)
    assert faulty(spec).tobytes() == healthy().tobytes()


@pytest.mark.parametrize("severity", [1.0, 0.4])
@pytest.mark.parametrize(("name", "side", "variant"), KNOWN)
def test_a_fault_changes_its_columns_from_its_onset_on_as_the_catalogue_says(
    name, side, variant, severity
) -> None:
    spec = FaultSpec(fault=name, severity=severity, onset=ONSET, side=side, variant=variant)
    rows, before = faulty(spec), healthy()
    change = rows - before
    acting = TIME >= ONSET
    assert not change[~acting].any()
    expected = np.zeros(c.COLUMNS)
    for column, value in ADDED[name, side or variant].items():
        by_decades = column in (c.REFEED_1, c.REFEED_2)
        expected[column] = (1.0 + value) ** severity - 1.0 if by_decades else severity * value
    np.testing.assert_allclose(change[acting], np.tile(expected, (acting.sum(), 1)), rtol=2e-4, atol=1e-18)
    moved = {c.MEANING[k].split(" (")[0] for k in range(c.COLUMNS) if change[:, k].any()}
    assert len(moved) == len(ADDED[name, side or variant])


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_internal_leakage_at_one_megapascal_does_not_depend_on_the_orifices_share(share) -> None:
    rows = faulty(FaultSpec(fault="internal_leakage", severity=1.0), internal_leakage_orifice_share=share)
    before = healthy()
    laminar = (rows - before)[0, c.CROSS_LEAKAGE] * 1e6
    assert laminar + rows[0, c.CROSS_ORIFICE] == pytest.approx(12e-6, rel=1e-9)
    assert rows[0, c.CROSS_ORIFICE] == pytest.approx(share * 12e-6, rel=1e-9)


def test_a_loose_seal_lets_oil_past_the_piston_where_the_details_say_so() -> None:
    rows = healthy()
    details = Details(loose_seal_leakage=8e-13)
    inject(rows, TIME, [FaultSpec(fault="seal_wear", severity=0.5)], FaultScales(), details)
    np.testing.assert_allclose(rows[:, c.SEAL_LEAKAGE], 4e-13)


def test_each_scale_can_be_overridden_and_is_used() -> None:
    """A scale that no fault reads would be a parameter without effect."""
    standard = {
        (name, side, variant): faulty(FaultSpec(fault=name, severity=1.0, side=side, variant=variant))
        for name, side, variant in CHOICES
    }
    # Not in the plant, see test_sensor_faults.
    measured = {f.name for entry in CATALOGUE.values() if entry.in_measurement for f in entry.figures}
    for field, info in FaultScales.model_fields.items():
        if field in measured:
            continue
        value = 0.9 * info.default if field != "tight_friction" else 3.0
        value = 4.0 if field == "thick_viscosity" else value
        changed = [
            not np.array_equal(
                faulty(FaultSpec(fault=name, severity=1.0, side=side, variant=variant), **{field: value}),
                standard[name, side, variant],
            )
            for name, side, variant in CHOICES
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
             "thin_viscosity", "thick_viscosity", "coupling_play", "shaft_leakage_flow"}  # fmt: skip
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
    assert figures("oil_degradation") == [thin, thick]
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
        FaultSpec(
            fault=name,
            side=side,
            variant=variant,
            severity=float(rng.uniform()),
            onset=float(rng.uniform(0.0, 3.0)),
            profile=str(rng.choice(["step", "ramp", "intermittent"])),
            ramp=1.7,
            period=0.6,
        )
        for name, side, variant in chosen
    ]
    before = healthy() * rng.uniform(0.5, 2.0, c.COLUMNS)
    rows, expected = before.copy(), before.copy()
    inject(rows, TIME, specs, scales, details)
    is_share = healthy()[0] == 1.0
    for spec in sorted(specs, key=lambda spec: list(CATALOGUE).index(spec.fault)):
        for column, value in by_figures(scales, details)[spec.fault, spec.side or spec.variant].items():
            change = spec.over(TIME) * value
            if spec.fault == "check_valve_clogged":
                expected[:, column] *= 10.0 ** (-scales.check_valve_clogging * spec.over(TIME))
                continue
            expected[:, column] += change * expected[:, column] if is_share[column] else change
    assert not np.array_equal(rows, before)
    np.testing.assert_allclose(rows, expected, rtol=1e-13, atol=1e-26)


@given(
    st.lists(st.sampled_from(CHOICES), min_size=1, max_size=5, unique_by=lambda choice: choice[0]),
    st.data(),
)
def test_the_order_in_which_faults_are_given_does_not_matter(chosen, data) -> None:
    specs = [
        FaultSpec(fault=name, severity=data.draw(st.floats(0.0, 1.0)), side=side, variant=variant)
        for name, side, variant in chosen
    ]
    time = np.array([0.0, 1.0])
    first = faulty(*specs, time=time)
    assert np.array_equal(first, faulty(*data.draw(st.permutations(specs)), time=time))


@given(cut=st.integers(1, 3999), profile=st.sampled_from(["step", "ramp", "intermittent"]))
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
    assert one[0, c.AIR] == pytest.approx(air + 0.025) and not one[:, c.PLAY].any()
    assert two[0, c.AIR] == pytest.approx(air + 0.005) and two[0, c.PLAY] > 0.03


def test_the_axis_is_read_and_told() -> None:
    spec = parse_fault("aeration:severity=0.4,axis=2")
    assert spec.axis == 2 and spec.label()["axis"] == 2
    assert FaultSpec(fault="aeration", severity=0.4).label()["axis"] == 1
    for text in ("aeration:severity=0.4,axis=3", "aeration:severity=0.4,axis=b"):
        with pytest.raises(InputError, match="axis") as caught:
            parse_fault(text)
        assert "\n" not in str(caught.value)


def test_a_wrong_scale_is_told_in_one_line() -> None:
    for arguments, told in (
        ({"free_air": -0.1}, "free_air"),
        ({"tight_friction": 0.5}, "tight_friction"),
        ({"leak": 1.0}, "the parameters are: internal_leakage"),
    ):
        with pytest.raises(InputError, match=told) as caught:
            FaultScales(**arguments)
        assert "\n" not in str(caught.value)
