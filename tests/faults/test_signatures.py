"""Signatures: every name exists, and severity 1 means the same as by the plant's figures."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.diagnosis.hypotheses import HealthyUnit
from fdd.faults import CATALOGUE, Fault, Signature
from fdd.residuals.balances import BALANCES
from fdd.residuals.effects import first_effects
from fdd.residuals.quantities import Scales
from fdd.samples import CHANNELS
from fdd.unit import Unit

UNITS = ("axis_a", "axis_b")
SIGNATURES = [(entry, signature) for entry in CATALOGUE.values() for signature in entry.signatures]
FIGURES = {figure.name: figure.value for entry in CATALOGUE.values() for figure in entry.figures}
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
