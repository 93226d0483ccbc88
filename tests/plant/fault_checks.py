"""What severity 1 of each fault is, by the catalogue's words, measured from runs by physics.

Each check takes a `Case` of either axis. Figures are those of the catalogue, not taken from the code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fault_case import Case, keeps_its_oil, lost, over_time, port_pressure
from sensor_fault_checks import SENSOR_CHECKS

from fdd.plant.details import Details
from fdd.plant.duty import Levels, Sines
from fdd.plant.faults.scales import FaultScales
from fdd.plant.load import NoLoad
from fdd.plant.oil import viscosity_ratio
from fdd.plant.scenario import Control, Recording


def sliding(case: Case, speed: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Velocity and friction (m/s, N) of faulty and healthy at a steady pump speed."""
    changes: dict[str, Any] = {
        "duration": 1.6, "duty": Levels(points=speed, offset=-np.copysign(0.07, speed)), "load": NoLoad(),
        "control": Control(mode="speed"), "details": Details(pump_ripple=0.0),
        "recording": Recording.perfect(),
    }  # fmt: skip
    found = []
    for truth in case.again(**changes):
        rows = truth.time > 1.2
        assert np.ptp(truth["velocity"][rows]) < 2e-3 * np.abs(truth["velocity"][rows]).mean()
        found.append((float(truth["velocity"][rows].mean()), float(truth["friction_force"][rows].mean())))
    return found[0], found[1]


def friction_changes(case: Case, forward: float, reverse: float, viscous: float) -> None:
    """Dry friction of each direction and the viscous part over the healthy ones, at steady sliding.

    0.073 m/s is far past the Stribeck velocity: what is not viscous there is dry friction.
    """
    branch = {1.0: case.unit.friction.forward, -1.0: case.unit.friction.reverse}
    for sign, dry in ((1.0, forward), (-1.0, reverse)):
        (v, force), (v_healthy, force_healthy) = sliding(case, 200.0 * sign)
        sigma = branch[sign].viscous
        expected = dry * (force_healthy - sigma * v_healthy) + viscous * sigma * v
        assert force == pytest.approx(expected, rel=5e-3), sign


def internal_leakage(case: Case) -> None:
    truth, drop = case.truth, case.truth["port_difference"]
    rows = case.after & (np.abs(drop) > 100e3)
    assert rows.sum() > 1000
    ratio = viscosity_ratio(case.unit.oil, truth["oil_temperature"])
    # Laminar and turbulent part by least squares; a tenth of the 12 cm³/s at 1 MPa is turbulent.
    # Above 100 kPa the orifice's smooth start takes less than 0.3 % off its square root.
    basis = np.column_stack([drop / ratio, np.sign(drop) * np.sqrt(np.abs(drop) / 1e6)])[rows]
    (laminar, turbulent), *_ = np.linalg.lstsq(basis, truth["cross_flow"][rows], rcond=None)
    assert laminar - case.unit.pump.cross_port_leakage == pytest.approx(10.8e-12, rel=1e-2)
    assert turbulent == pytest.approx(1.2e-6, rel=1e-2)
    # The truth's coefficient is the secant: times the pressure it is the flow, with the case's half of L_T.
    flow = truth["cross_flow"] + 0.5 * case.unit.pump.case_leakage * drop / ratio
    np.testing.assert_allclose((truth["leakage"] * drop)[rows], flow[rows], rtol=1e-9)


def external_leakage(case: Case) -> None:
    truth, after = case.truth, case.after
    pressure = truth[f"pressure_{case.spec.side}"]
    assert pressure[after].min() > 50e3
    # Counted at atmospheric density: compressed oil is up to 1 % denser.
    np.testing.assert_allclose((truth["outside_flow"] / pressure)[after], 6.03e-12, rtol=6e-3)
    assert lost(truth, after) == pytest.approx(6.03e-12 * over_time(truth, pressure, after), rel=6e-3)
    assert abs(lost(case.healthy.truth, after)) < 1e-12
    drained = case.healthy.truth["pressure_accumulator"][-1] - truth["pressure_accumulator"][-1]
    assert drained > 20e3, "the accumulator drains"
    keeps_its_oil(truth)


def pump_wear(case: Case) -> None:
    truth, after = case.truth, case.after
    speed, drop = truth["pump_speed"], truth["port_difference"]
    turning = after & (np.abs(speed) > 30.0)
    share = truth["pump_flow"][turning] / (case.unit.pump.displacement * speed[turning])
    assert np.mean(share) == pytest.approx(0.98, abs=2e-3)
    # The gear's teeth ripple as a cosine of their angle, beside the healthy ripple.
    teeth = Details().pump_teeth * truth["pump_angle"][turning]
    # By least squares: a mean over steady speeds meets the same few angles again and again.
    waves = np.column_stack([np.ones(teeth.size), np.cos(teeth), np.sin(teeth)])
    _, cosine, sine = np.linalg.lstsq(waves, share, rcond=None)[0]
    assert np.hypot(cosine, sine) == pytest.approx(0.98 * (Details().pump_ripple + 0.05), rel=0.01)
    pressed = turning & (np.abs(drop) > 100e3)
    assert pressed.sum() > 1000
    ratio = viscosity_ratio(case.unit.oil, truth["oil_temperature"])
    leaking = truth["cross_flow"][pressed] / drop[pressed] * ratio[pressed]
    leaking -= case.unit.pump.cross_port_leakage
    # 12e-12 at 100 rad/s, in proportion to speed.
    np.testing.assert_allclose(leaking, 12e-14 * np.abs(speed[pressed]), rtol=1e-6)


def case_drain_seal_failure(case: Case) -> None:
    truth, healthy = case.truth, case.healthy.truth
    # Both ports leak into the case, which its check valve holds 5 kPa above the accumulator.
    above = 0.5 * (truth["pressure_1"] + truth["pressure_2"]) - truth["pressure_case"]
    rows = case.after & (above > 20e3)
    assert rows.sum() > 200
    leakage = 0.5 * truth["drain_flow"][rows] / above[rows]
    np.testing.assert_allclose(leakage, case.unit.pump.case_leakage + 24e-12, rtol=0.015)
    cracking = case.unit.accumulator.case_cracking_pressure
    excess = (truth["pressure_case"] - truth["pressure_accumulator"])[rows]
    assert excess.min() > 0.9 * cracking and excess.max() < 2.0 * cracking
    rise = (truth["pressure_accumulator"] - healthy["pressure_accumulator"])[case.after]
    assert np.mean(rise[-1000:]) > 10e3, "its pressure rises"
    assert lost(truth, case.after) == pytest.approx(0.0, abs=1e-12), "it stays inside"
    keeps_its_oil(truth)


def shaft_seal_wear(case: Case) -> None:
    truth, after = case.truth, case.after
    minutes = np.ptp(truth.time[after]) / 60.0
    at_487_kpa = 487e3 / np.mean(truth["pressure_case"][after])
    assert lost(truth, after) / minutes * at_487_kpa == pytest.approx(1e-6, rel=1e-2), "1 cm³/min"
    assert abs(lost(case.healthy.truth, after)) < 1e-12
    keeps_its_oil(truth)


def seal_wear(case: Case) -> None:
    kind, _, direction = str(case.spec.variant).partition("_")
    full = 0.35 if kind == "loose" else 2.0
    # Worn in one direction, half of the change goes into the viscous part, which both have in common.
    friction_changes(
        case,
        forward=1.0 if direction == "reverse" else full,
        reverse=1.0 if direction == "forward" else full,
        viscous=0.5 * (1.0 + full) if direction else full,
    )
    truth, after = case.truth, case.after
    pressed = sum(over_time(truth, truth[f"pressure_{k}"], after) for k in (1, 2))
    each_rod = 1e-14 if kind == "loose" else 0.0
    # What the integrator makes of 4 litres is 1e-14 m³; the rods lose 3e-8.
    assert lost(truth, after) == pytest.approx(each_rod * pressed, rel=1e-2, abs=1e-12)
    np.testing.assert_allclose(truth["leakage"], case.healthy.truth["leakage"], rtol=1e-3)


def aeration(case: Case) -> None:
    truth, after = case.truth, case.after
    ratio = (truth["bulk_modulus"] / case.healthy.truth["bulk_modulus"])[after]
    assert np.all((ratio > 0.3) & (ratio < 0.5)), "halves to thirds at charge pressure"
    # By the polytropic law itself: 0.025 more air at atmospheric pressure.
    p = case.unit.oil.reference_pressure + 101_325.0
    softer = 0.025 * (101_325.0 / p) ** (1.0 / 1.4) / (1.4 * p)
    np.testing.assert_allclose(1.0 / truth["bulk_modulus"][after], 1.0 / case.unit.oil.bulk_modulus + softer)
    # And as the chamber shows it: what flows in and is not made room for, over the pressure's rise.
    quiet: dict[str, Any] = {
        "duration": 3.0, "duty": Sines(amplitude=0.01, low_hz=3.0, high_hz=8.0, count=4), "seed": 3,
        "details": Details(pump_ripple=0.0), "recording": Recording.perfect(),
    }  # fmt: skip
    for shaken, air in zip(case.again(**quiet), (0.025, 0.0), strict=True):
        cylinder, p1 = case.unit.cylinder, shaken["pressure_1"]
        leak = case.unit.pump.case_leakage * (port_pressure(shaken, 1) - shaken["pressure_case"])
        inflow = (
            shaken["pump_flow"] - shaken["cross_flow"] - shaken["bypass_flow"] - leak
            + shaken["refeed_flow_1"] - cylinder.area_1 * shaken["velocity"]
        )  # fmt: skip
        absolute = p1 + 101_325.0
        gas = (101_325.0 / absolute) ** (1.0 / 1.4) / (1.4 * absolute)
        at_reference = (101_325.0 / p) ** (1.0 / 1.4) / (1.4 * p)
        own = case.unit.oil.air_fraction
        compliance = 1.0 / case.unit.oil.bulk_modulus - own * at_reference + (own + air) * gas
        volume = cylinder.volume_1 + cylinder.area_1 * shaken["position"]
        taken = (volume * compliance * np.gradient(p1, shaken.time))[50:-1]
        assert (taken @ inflow[50:-1]) / (taken @ taken) == pytest.approx(1.0, abs=0.03)


def check_valve_stuck_open(case: Case) -> None:
    side = case.spec.side or 1
    truth, healthy = case.again(**case.pressed(side))
    over = port_pressure(truth, side) - truth["pressure_accumulator"]
    rows = over > 50e3
    assert rows.sum() > 200
    # Counted at atmospheric density, under 1 %; so small a drop is turbulent to within 1 %.
    np.testing.assert_allclose(
        -truth[f"refeed_flow_{side}"][rows], 1e-4 * np.sqrt(over[rows] / 1e6), rtol=0.015
    )
    assert healthy[f"refeed_flow_{side}"].min() >= 0.0
    assert truth[f"refeed_flow_{3 - side}"].min() >= 0.0
    # The chamber keeps only what the pump gives beside the valve's flow.
    sign = 1.0 if side == 1 else -1.0
    inward = sign * (truth["pump_flow"] - truth["cross_flow"]) - 0.5 * truth["drain_flow"]
    area = case.unit.cylinder.area_1 if side == 1 else case.unit.cylinder.area_2
    passed = float(np.mean(truth[f"refeed_flow_{side}"]))
    assert passed < -1e-6
    moved = sign * area * np.mean(truth["velocity"])
    assert np.mean(inward) + passed == pytest.approx(moved, abs=0.05 * abs(passed))
    keeps_its_oil(truth)


def check_valve_clogged(case: Case) -> None:
    side = case.spec.side or 1
    # Only the chamber that the load leaves low is refed at all.
    truth, healthy = case.again(**case.pressed(3 - side))
    assert truth[f"refeed_flow_{side}"].max() < 0.05 * healthy[f"refeed_flow_{side}"].max()
    assert healthy[f"refeed_flow_{side}"].max() > 1e-6
    low, usual = truth[f"pressure_{side}"].min(), healthy[f"pressure_{side}"].min()
    # Below the accumulator less cracking as never when healthy, yet never below vacuum.
    assert -101_325.0 < low < usual - 30e3
    keeps_its_oil(truth)


def relief_valve_stuck_open(case: Case) -> None:
    truth, after, drop = case.truth, case.after, case.truth["port_difference"]
    rows = after & (np.abs(drop) > 50e3)
    assert rows.sum() > 200
    flow = truth["stuck_relief_flow"]
    expected = 1e-4 * np.sign(drop) * np.sqrt(np.abs(drop) / 1e6)
    np.testing.assert_allclose(flow[rows], expected[rows], rtol=0.012)
    assert np.all(np.abs(flow[after]) <= np.abs(expected[after]) + 1e-12)
    assert not case.healthy.truth["stuck_relief_flow"].any()
    assert np.abs(truth["relief_flow"]).max() < 1e-9, "the other valve stays shut"
    keeps_its_oil(truth)
    # Against what pump and piston leave over: what chamber 1 gets, on average, is what the piston makes room
    # for, but for the case's leakage and its own compression.
    got = np.mean((truth["pump_flow"] - flow - truth["cross_flow"] - 0.5 * truth["drain_flow"])[after])
    moved = case.unit.cylinder.area_1 * np.mean(truth["velocity"][after])
    assert got == pytest.approx(moved, abs=0.05 * np.mean(np.abs(flow[after])))
    np.testing.assert_allclose(truth["leakage"], case.healthy.truth["leakage"], rtol=1e-3)


def oil_degradation(case: Case) -> None:
    factor = 0.5 if case.spec.variant == "thin" else 2.0
    truth, healthy, after = case.truth, case.healthy.truth, case.after
    # Other friction heats the oil otherwise, by some mK; 1 mK is 5e-5 of viscosity.
    for name, by in (
        ("viscous_friction", factor), ("leakage", 1.0 / factor), ("coulomb_friction", 1.0),
        ("bulk_modulus", 1.0),
    ):  # fmt: skip
        np.testing.assert_allclose(truth[name][after] / healthy[name][after], by, rtol=1e-3, err_msg=name)
    ratio = viscosity_ratio(case.unit.oil, truth["oil_temperature"]) * factor
    leaking = case.unit.pump.cross_port_leakage / ratio * truth["port_difference"]
    np.testing.assert_allclose(truth["cross_flow"][after], leaking[after], rtol=1e-9)
    friction_changes(case, forward=1.0, reverse=1.0, viscous=factor)


def motor_degradation(case: Case) -> None:
    """The shaft's balance J dω/dt = k·K·i - D·Δp - friction holds with k = 0.7, by least squares."""
    drive, details = case.unit.drive, Details(pump_ripple=0.0)
    faulty, healthy = case.again(details=details, recording=Recording.perfect())
    for truth, share, limit in ((healthy, 1.0, 10.0), (faulty, 0.7, 8.0)):
        speed = truth["pump_speed"]
        dry = details.pump_coulomb_torque * speed / np.hypot(1.0, speed)
        # Where the speed is steady for a while, so that its slope over 2 ms is exact.
        slope = np.gradient(speed, truth.time)
        steady = np.abs(slope) < 300.0
        assert steady.sum() > 1000
        torque = drive.inertia * slope + case.unit.pump.displacement * truth["port_difference"]
        torque += drive.viscous_friction * speed + dry
        electric = drive.torque_constant * truth["motor_current"]
        fitted = (torque[steady] @ electric[steady]) / (electric[steady] @ electric[steady])
        assert fitted == pytest.approx(share, rel=0.02)
        # The steps ask for all the current that there is.
        assert np.abs(truth["motor_current"]).max() == pytest.approx(limit, rel=1e-6)
    if case.axis == 2:  # the other axis would drag a motor that falls behind
        return
    # A winding of much resistance on little voltage: V = R·i + K_e·ω at steady speed.
    volts, ohms = 40.0, 100.0
    weak = case.unit.model_copy(
        update={"drive": drive.model_copy(update={"voltage_limit": volts, "winding_resistance": ohms})}
    )
    starved = case.again(
        unit=weak, duration=3.0, duty=Levels(points=200.0, offset=-0.05), control=Control(mode="speed"),
        load=NoLoad(), details=details, recording=Recording.perfect(),
    )  # fmt: skip
    for truth, share, resistance in zip(starved, (0.7, 1.0), (1.5, 1.0), strict=True):
        speed, current = truth["pump_speed"][-300:], truth["motor_current"][-300:]
        assert np.ptp(current) < 0.01 * current.mean()
        found = (volts - share * drive.back_emf_constant * speed.mean()) / current.mean()
        assert found == pytest.approx(resistance * ohms, rel=0.01)


def coupling_wear(case: Case) -> None:
    """The pump's angle, from the flow that it gives, lags the motor's by the play, whichever way it turns."""
    changes: dict[str, Any] = {
        "duration": 3.0, "duty": Levels(points="0:100/1:-100/2:100"), "control": Control(mode="speed"),
        "details": Details(pump_ripple=0.0), "recording": Recording.perfect(), "load": NoLoad(),
    }  # fmt: skip
    truth, healthy = case.again(**changes, fault_scales=FaultScales(coupling_eccentricity=0.0))
    displacement = case.unit.pump.displacement
    for each, play in ((healthy, 0.0), (truth, np.deg2rad(2.0))):
        turned = each["pump_flow"] / displacement
        pump = np.concatenate([[0.0], np.cumsum(0.5 * (turned[1:] + turned[:-1]) * np.diff(each.time))])
        behind = each["pump_angle"] - pump
        ends = [behind[each.time.searchsorted(t) - 1] for t in (0.98, 1.98, 2.98)]
        assert each["port_difference"][[980, 2980]].min() > 0.0 > each["port_difference"][1980]
        # The flanks give 500 N·m/rad under the pump's torque, friction and leakage on both sides of zero.
        torque = displacement * np.abs(each["port_difference"][[980, 1980, 2980]])
        bent = (torque[0] + torque[1]) / 500.0 if play else 0.0
        bent_back = (torque[1] + torque[2]) / 500.0 if play else 0.0
        assert ends[0] - ends[1] == pytest.approx(play + bent, abs=4e-4)
        assert ends[2] - ends[1] == pytest.approx(play + bent_back, abs=4e-4)
    # Out of line, the pump's speed swings once a turn; twice the first harmonic over the motor's angle.
    # Without the play, through which the pump's own pressure pulses would drive it to and fro.
    swinging, steady = case.again(**changes, fault_scales=FaultScales(coupling_play=0.0))
    for each, swing in ((swinging, 0.02), (steady, 0.0)):
        rows = (each.time > 0.4) & (each.time < 0.98)
        share = each["pump_flow"][rows] / (displacement * each["pump_speed"][rows]) - 1.0
        found = 2.0 * abs(np.mean(share * np.exp(-1j * each["pump_angle"][rows])))
        assert found == pytest.approx(swing, abs=1e-3)


CHECKS: dict[str, Callable[[Case], None]] = {
    check.__name__: check
    for check in (
        internal_leakage, external_leakage, pump_wear, case_drain_seal_failure, shaft_seal_wear, seal_wear,
        aeration, check_valve_stuck_open, check_valve_clogged, relief_valve_stuck_open, oil_degradation,
        motor_degradation, coupling_wear,
    )
} | SENSOR_CHECKS  # fmt: skip
