"""What severity 1 of each fault is, by the catalogue's words, measured from runs by physics.

Each check takes a `Case` of either axis. Figures are written down from the catalogue, not taken from the code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from fdd.plant.details import Details
from fdd.plant.duty import Levels, Sines, Steps
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.load import ConstantLoad, NoLoad
from fdd.plant.oil import viscosity_ratio
from fdd.plant.scenario import Control, Recording, Scenario
from fdd.plant.simulate import Simulation, simulate
from fdd.plant.truth import Truth
from fdd.unit import Unit

ONSET = 2.0
UNITS = {1: Unit.load("axis_a"), 2: Unit.load("axis_b")}
Array = np.ndarray


def run(*faults: FaultSpec, axis: int = 1, unit: Unit | None = None, **changes: Any) -> Simulation:
    """The axis's part of a run; axis 2 is the second of a dual rig, both driven alike.

    A circuit goes to both axes.
    """
    given: dict[str, Any] = dict(
        duration=5.0,
        duty=Steps(amplitude=0.04, hold=0.8),
        load=ConstantLoad(level=600.0 * axis),
        seed=5,
        oil_temperature=UNITS[1].oil.reference_temperature,
        faults=list(faults),
    )
    given |= changes
    if axis == 1:
        return simulate(unit or UNITS[1], Scenario(**given))
    given["partner"] = {"circuit": given["circuit"]} if "circuit" in given else {}
    out = simulate(UNITS[1], Scenario(**given), partner=unit or UNITS[2]).partner
    assert out is not None
    return out


@dataclass(frozen=True)
class Case:
    """A faulty run, the healthy one beside it, and which rows come after the onset."""

    spec: FaultSpec
    faulty: Simulation
    healthy: Simulation

    @property
    def axis(self) -> int:
        return self.spec.axis

    @property
    def unit(self) -> Unit:
        return UNITS[self.spec.axis]

    @property
    def truth(self) -> Truth:
        return self.faulty.truth

    @property
    def after(self) -> Array:
        # A late row at the onset may lie on either side of its millisecond.
        return self.truth.time > ONSET + 2e-3

    def again(self, **changes: Any) -> tuple[Truth, Truth]:
        """Truths of faulty and healthy in another run, the fault there from the start."""
        spec = self.spec.model_copy(update={"onset": 0.0})
        return (run(spec, axis=self.axis, **changes).truth, run(axis=self.axis, **changes).truth)

    def pressed(self, side: int) -> dict[str, Any]:
        """The load that presses on a chamber."""
        return {"load": ConstantLoad(level=600.0 * self.axis * (1.0 if side == 1 else -1.0))}


def over_time(truth: Truth, values: Array, rows: Array) -> float:
    return float(np.trapezoid(values[rows], truth.time[rows]))


def lost(truth: Truth, rows: Array) -> float:
    """Oil (m³ at atmospheric pressure) that went outside, from what is still inside."""
    inside = (truth["oil_mass"] - truth["oil_lost"])[rows]
    return float(inside[0] - inside[-1])


def keeps_its_oil(truth: Truth) -> None:
    assert np.abs(truth["oil_mass"] / truth["oil_mass"][0] - 1.0).max() < 1e-9


def port_pressure(truth: Truth, side: int) -> Array:
    """Pa at the pump's port; half of the line losses lie on each side."""
    loss = 0.5 * (truth["port_difference"] - truth["pressure_difference"])
    return np.asarray(truth[f"pressure_{side}"] + (loss if side == 1 else -loss))


def sliding(case: Case, speed: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Velocity and friction (m/s, N) of faulty and healthy at a steady pump speed, healthy ripple left out."""
    changes: dict[str, Any] = dict(
        duration=1.6, duty=Levels(points=speed, offset=-np.copysign(0.07, speed)), load=NoLoad(),
        control=Control(mode="speed"), details=Details(pump_ripple=0.0), recording=Recording.perfect(),
    )  # fmt: skip
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
    teeth = np.exp(-1j * Details().pump_teeth * truth["pump_angle"][turning])
    assert 2.0 * abs(np.mean(share * teeth)) == pytest.approx(
        0.98 * (Details().pump_ripple + 0.05), rel=0.05
    )
    pressed = turning & (np.abs(drop) > 100e3)
    assert pressed.sum() > 1000
    ratio = viscosity_ratio(case.unit.oil, truth["oil_temperature"])
    leaking = truth["cross_flow"][pressed] / drop[pressed] * ratio[pressed] - case.unit.pump.cross_port_leakage
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
    quiet: dict[str, Any] = dict(
        duration=3.0, duty=Sines(amplitude=0.01, low_hz=3.0, high_hz=8.0, count=4), seed=3,
        details=Details(pump_ripple=0.0), recording=Recording.perfect(),
    )  # fmt: skip
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
    assert not truth[f"refeed_flow_{side}"].any()
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
    changes: dict[str, Any] = dict(
        duration=3.0, duty=Levels(points="0:100/1:-100/2:100"), control=Control(mode="speed"),
        details=Details(pump_ripple=0.0), recording=Recording.perfect(), load=NoLoad(),
    )  # fmt: skip
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


def only_measured(case: Case) -> None:
    for name in case.healthy.truth.columns:
        assert np.array_equal(case.truth[name], case.healthy.truth[name]), name


def _added(case: Case, channel: str) -> Array:
    return np.asarray((case.faulty.samples[channel] - case.healthy.samples[channel])[case.after])


def pressure_sensor_bias(case: Case) -> None:
    step = case.unit.sensors["pressure_difference"].resolution
    np.testing.assert_allclose(_added(case, "pressure_difference"), 250e3, atol=1.01 * step)
    only_measured(case)


def pressure_sensor_drift(case: Case) -> None:
    expected = 5e3 * (case.faulty.samples.time[case.after] - ONSET)
    step = case.unit.sensors["pressure_difference"].resolution
    np.testing.assert_allclose(_added(case, "pressure_difference"), expected, atol=1.01 * step + 10.0)
    only_measured(case)


def position_sensor_slip(case: Case) -> None:
    """About once a second by 0.5 to 1.5 mm, to either side, within 5 mm; the controller follows it."""
    spec = case.spec.model_copy(update={"onset": 0.0})
    long = run(spec, axis=case.axis, duration=120.0, recording=Recording.perfect())
    encoder = case.unit.sensor("position")
    slipped = long.samples["position"] - encoder.gain * long.truth["position"] - encoder.zero
    # The encoder's own errors are microns; a slip is a step from one millisecond to the next.
    jumps = np.diff(slipped)
    jumps = jumps[np.abs(jumps) > 0.2e-3]
    assert 80 < jumps.size < 160, "Poisson of 120, four deviations"
    # Reflected at the walls a slip may show smaller.
    inside = np.abs(jumps[np.abs(slipped[:-1][np.abs(np.diff(slipped)) > 0.2e-3]) < 3.4e-3])
    assert inside.min() > 0.49e-3 and inside.max() < 1.51e-3
    assert np.mean(inside) == pytest.approx(1e-3, abs=0.15e-3)
    assert 0.25 < np.mean(jumps > 0.0) < 0.75
    assert np.abs(slipped).max() < 5.05e-3
    if case.axis == 1:
        few: dict[str, Any] = dict(duration=120.0, recording=Recording.perfect())
        error, usual = (
            np.median(np.abs(out.samples["position_setpoint"] - out.samples["position"]))
            for out in (long, run(**few))
        )
        assert error == pytest.approx(usual, rel=0.1), "the loop believes its encoder"
    else:
        only_measured(case)


def sensor_dropout(case: Case) -> None:
    variant = str(case.spec.variant)
    channel = "position" if variant.startswith("position") else "pressure_difference"
    values, sound = case.faulty.samples[channel], case.healthy.samples[channel]
    dead = case.unit.sensors[channel].loop.offset if variant == "broken_loop" else 0.0
    lost_all = values[case.after][500:]  # a contact opens within a tenth of a second or so
    if variant.endswith("missing"):
        assert np.isnan(lost_all).all()
    elif variant.endswith("held"):
        assert np.ptp(lost_all) == 0.0 and np.ptp(sound[case.after]) > 0.0
        assert lost_all[0] in sound, "a value that was seen"
    else:
        np.testing.assert_array_equal(lost_all, -dead)
    only_measured(case)
    # At 0.3 it is lost for 30 % of the time, in bursts of about 0.1 s.
    part = case.spec.model_copy(update={"severity": 0.3, "onset": 0.0})
    few: dict[str, Any] = dict(axis=case.axis, duration=120.0, recording=Recording.perfect())
    out = run(part, **few)
    values = out.samples[channel]
    if variant.endswith("held"):
        gone = np.concatenate([[False], np.diff(values) == 0.0])
        gone &= np.concatenate([[False], np.diff(run(**few).samples[channel]) != 0.0])
        assert gone.mean() > 0.1
        return
    gone = np.isnan(values) if variant.endswith("missing") else values == -dead
    assert gone.mean() == pytest.approx(0.3, abs=0.05)
    bursts = int((np.diff(gone.astype(int)) == 1).sum())
    assert gone.sum() * 1e-3 / bursts == pytest.approx(0.1 / 0.7, rel=0.25)


CHECKS: dict[str, Callable[[Case], None]] = {
    check.__name__: check
    for check in (
        internal_leakage, external_leakage, pump_wear, case_drain_seal_failure, shaft_seal_wear, seal_wear,
        aeration, check_valve_stuck_open, check_valve_clogged, relief_valve_stuck_open, oil_degradation,
        motor_degradation, coupling_wear, pressure_sensor_bias, pressure_sensor_drift, position_sensor_slip,
        sensor_dropout,
    )
}  # fmt: skip
