"""Severity 1 of seals, oil, motor, drive and coupling by the catalogue's words, measured from runs."""

import numpy as np
import pytest
from fault_case import Array, Case, checked, lost, over_time

from fdd.plant.details import Details
from fdd.plant.faults import FaultScales
from fdd.plant.oil import viscosity_ratio
from fdd.plant.rig import ConstantLoad, NoLoad
from fdd.plant.scenario import Recording
from fdd.plant.state import Truth
from fdd.unit import FrictionBranch


def strokes(case: Case, speed: float, duration: float) -> tuple[Truth, Truth]:
    """Faulty and healthy at a steady pump speed, from 7 cm before mid-stroke."""
    return case.at_speeds(speed, duration, -np.copysign(0.07, speed), details=Details(pump_ripple=0.0))


def dry(branch: FrictionBranch, v: float, level: float = 1.0, rest: float = 1.0) -> float:
    """Friction (N) of eq. 5.9 but for its viscous part, of a scaled level and a scaled part beyond it."""
    falling = np.exp(-((abs(v) / branch.stribeck_velocity) ** branch.stribeck_exponent))
    return float(level * branch.coulomb + rest * (branch.static - branch.coulomb) * falling)


Pair = tuple[float, float]


def friction_changes(case: Case, forward: Pair, reverse: Pair, viscous: float, thicker: float = 1.0) -> None:
    """At two speeds each direction's level, what rest has beyond it and the viscous part, against eq. 5.9."""
    for speed, (sign, (level, rest)) in (
        (n, s) for n in (200.0, 80.0) for s in ((1.0, forward), (-1.0, reverse))
    ):
        branch = case.unit.friction.forward if sign > 0.0 else case.unit.friction.reverse
        (v, force), (v_healthy, force_healthy) = (
            (truth["velocity"][-400:].mean(), truth["friction_force"][-400:].mean())
            for truth in strokes(case, sign * speed, 1.6)
        )
        draw = (force_healthy - branch.viscous * v_healthy) / (sign * dry(branch, v_healthy))
        assert 0.7 < draw < 1.3, "the spread from trial to trial"
        expected = sign * draw * dry(branch, thicker * v, level, rest) + viscous * branch.viscous * v
        assert force == pytest.approx(expected, rel=5e-3), (sign, speed)


@checked
def seal_wear(case: Case) -> None:
    kind, _, direction = str(case.spec.variant).partition("_")
    full = 0.35 if kind == "loose" else 2.0
    # Worn in one direction, half of the change goes into what both have in common.
    common = 0.5 if direction else 1.0
    steeper = -1.0 if kind == "loose" else 3.0
    level, rest, viscous = {
        "whole": (full, full, full), "coulomb": (full, 1.0, 1.0), "stribeck": (1.0, full, 1.0),
        "viscous": (0.5 * (1.0 + full), 1.0, 1.0 + steeper), "track": (1.0, 1.0, 1.0),
    }[str(case.spec.law)]  # fmt: skip
    if case.spec.law == "track":
        worn_in_the_middle(case, full, direction)
    else:
        friction_changes(
            case,
            forward=(1.0, 1.0) if direction == "reverse" else (level, rest),
            reverse=(1.0, 1.0) if direction == "forward" else (level, rest),
            viscous=1.0 + common * (viscous - 1.0),
        )
    truth, after = case.truth, case.after
    pressed = sum(over_time(truth, truth[f"pressure_{k}"], after) for k in (1, 2))
    each_rod = 1e-14 if kind == "loose" else 0.0
    # What the integrator makes of 4 litres is 1e-14 m³; the rods lose 3e-8.
    assert lost(truth, after) == pytest.approx(each_rod * pressed, rel=1e-2, abs=1e-12)
    np.testing.assert_allclose(truth["leakage"], case.healthy.truth["leakage"], rtol=1e-3)


def worn_in_the_middle(case: Case, full: float, direction: str) -> None:
    """`full` at mid-stroke only; of one direction half of it all along that way, half at mid-stroke."""
    half = 0.5 * (1.0 + full)
    for sign, way in ((1.0, "forward"), (-1.0, "reverse")):
        truth, healthy = strokes(case, sign * 200.0, 2.15)
        branch = getattr(case.unit.friction, way)
        away = half if way == direction else 1.0
        middle = away * half if direction else full
        for at, expected in ((0.0, middle), (0.078, away)):
            (v, force), (v_healthy, force_healthy) = (
                (each["velocity"][i], each["friction_force"][i])
                for each in (truth, healthy)
                for i in [int(np.argmin(np.abs(sign * each["position"] - at)))]
            )
            assert abs(abs(v) - abs(v_healthy)) < 0.02 * abs(v)
            dry, dry_healthy = force - branch.viscous * v, force_healthy - branch.viscous * v_healthy
            assert dry / dry_healthy == pytest.approx(expected, rel=0.03), (way, at)


@checked
def oil_degradation(case: Case) -> None:
    variant = str(case.spec.variant)
    factor = {"thin": 0.5, "thick": 2.0, "wet": 1.4}[variant]
    # Three tenths of a seal's level at speed is carried by a film, which goes with the root of viscosity.
    film = 1.0 + 0.3 * (np.sqrt(factor) - 1.0)
    truth, healthy, after = case.truth, case.healthy.truth, case.after
    # Other friction heats the oil otherwise, by some mK; 1 mK is 5e-5 of viscosity.
    for name, by in (
        ("viscous_friction", factor), ("leakage", 1.0 / factor), ("coulomb_friction", film),
        ("bulk_modulus", 1.0),
    ):  # fmt: skip
        np.testing.assert_allclose(truth[name][after] / healthy[name][after], by, rtol=2e-3, err_msg=name)
    ratio = viscosity_ratio(case.unit.oil, truth["oil_temperature"]) * factor
    leaking = case.unit.pump.cross_port_leakage / ratio * truth["port_difference"]
    np.testing.assert_allclose(truth["cross_flow"][after], leaking[after], rtol=1e-6)
    # As viscous as it is, the falling curve ends at a speed that is as much lower.
    friction_changes(case, forward=(film, 1.0), reverse=(film, 1.0), viscous=factor, thicker=factor)


PLAIN = Details(pump_ripple=0.0, pump_friction=0.0, pump_drag=0.0, cogging_torque=0.0)
"""A shaft on which nothing acts but what is written down here."""


def turning(case: Case) -> tuple[Truth, Truth]:
    """Faulty and healthy at speeds so low that a sample each millisecond shows what swings with the shaft."""
    load = ConstantLoad(level=600.0 * case.axis)
    return case.at_speeds("0:25/2:-25/4:40", 6.0, -0.03, load=load, details=PLAIN)


def shaft(case: Case, truth: Truth) -> Array:
    """Torque per ampere, its swing with twice the angle, and the brake, over the sound motor's, by lstsq."""
    drive, speed = case.unit.drive, truth["pump_speed"]
    slope = np.gradient(speed, truth.time)
    torque = drive.inertia * slope + case.unit.pump.displacement * truth["port_difference"]
    torque += drive.viscous_friction * speed + PLAIN.pump_coulomb_torque * speed / np.hypot(1.0, speed)
    electric = drive.torque_constant * truth["motor_current"]
    swing = np.cos(2.0 * PLAIN.pole_pairs * truth["pump_angle"])
    # Where the speed is steady for a while, so that its slope over 2 ms is exact.
    steady = np.abs(slope) < 300.0
    assert steady.sum() > 1000
    basis = np.column_stack([electric, electric * swing, -speed])[steady]
    return np.asarray(np.linalg.lstsq(basis, torque[steady], rcond=None)[0])


@checked
def motor_degradation(case: Case) -> None:
    law = str(case.spec.law)
    share, swing, brake, limit, ohms, volts = {
        "winding": (0.7, 0.0, 0.0, 8.0, 1.5, 0.7), "magnets": (0.7, 0.0, 0.0, 10.0, 1.0, 0.7),
        "shorted": (0.85, 0.0, 2e-3, 10.0, 0.7, 0.85), "phase": (0.7, -0.3, 0.0, 10.0, 1.0, 1.0),
    }[law]  # fmt: skip
    for truth, expected in zip(turning(case), ((share, swing, brake), (1.0, 0.0, 0.0)), strict=True):
        assert shaft(case, truth) == pytest.approx(expected, abs=0.02)
        assert shaft(case, truth)[2] == pytest.approx(expected[2], abs=2e-4)
    # The steps ask for all the current that there is.
    for truth, most in zip(case.again(recording=Recording.perfect()), (limit, 10.0), strict=True):
        assert np.abs(truth["motor_current"]).max() == pytest.approx(most, rel=1e-6)
    if case.axis == 2 or law == "phase":  # the other axis would drag a motor that falls behind
        return
    # A winding of much resistance on little voltage: V = R·i + K_e·ω at steady speed.
    supply, resistance = 40.0, 100.0
    drive = case.unit.drive.model_copy(update={"voltage_limit": supply, "winding_resistance": resistance})
    weak = case.unit.model_copy(update={"drive": drive})
    starved = case.at_speeds(200.0, 3.0, -0.05, unit=weak, details=PLAIN)
    for truth, emf, more in zip(starved, (volts, 1.0), (ohms, 1.0), strict=True):
        speed, current = truth["pump_speed"][-300:], truth["motor_current"][-300:]
        assert np.ptp(current) < 0.01 * current.mean()
        found = (supply - emf * drive.back_emf_constant * speed.mean()) / current.mean()
        assert found == pytest.approx(more * resistance, rel=0.01)


@checked
def drive_failure(case: Case) -> None:
    if case.spec.law == "phase":
        for truth, expected in zip(turning(case), ((0.5, -0.5, 0.0), (1.0, 0.0, 0.0)), strict=True):
            assert shaft(case, truth) == pytest.approx(expected, abs=0.02)
        faulty, _ = case.again(recording=Recording.perfect())
        # To the integrator's own tolerance of the current.
        assert np.abs(faulty["motor_current"]).max() == pytest.approx(5.0, abs=1e-4)
        return
    truth, sound = case.again(case.spec.onset, load=NoLoad(), recording=Recording.perfect())
    # The winding's current dies out within some current lags, and with it the torque.
    dead, before = truth.time > case.spec.onset + 0.01, truth.time < case.spec.onset
    assert np.abs(truth["motor_current"][dead]).max() < 1e-6
    assert np.abs(truth["motor_torque"][dead]).max() < 0.02, "magnets and slots alone"
    assert np.abs(sound["motor_current"][dead]).max() > 1.0 < np.abs(truth["motor_current"][before]).max()
    if case.axis == 1:  # the other axis would drive it by the rod
        assert np.abs(truth["pump_speed"][truth.time > case.spec.onset + 1.0]).max() < 1.0
        assert np.ptp(truth["position"][dead][500:]) < 1e-3 < np.ptp(sound["position"][dead][500:])


@checked
def coupling_wear(case: Case) -> None:
    """The pump's angle, from the flow that it gives, lags the motor's by the play, whichever way it turns."""
    loose = 0.0 if case.spec.law == "bent" else np.deg2rad(2.0)

    def to_and_fro(scales: FaultScales) -> tuple[Truth, Truth]:
        details = Details(pump_ripple=0.0)
        return case.at_speeds("0:100/1:-100/2:100", 3.0, details=details, fault_scales=scales)

    truth, healthy = to_and_fro(FaultScales(coupling_eccentricity=0.0))
    displacement = case.unit.pump.displacement
    for each, play in ((healthy, 0.0), (truth, loose)):
        turned = each["pump_flow"] / displacement
        pump = np.concatenate([[0.0], np.cumsum(0.5 * (turned[1:] + turned[:-1]) * np.diff(each.time))])
        behind = each["pump_angle"] - pump
        ends = [behind[each.time.searchsorted(t) - 1] for t in (0.98, 1.98, 2.98)]
        assert each["port_difference"][[980, 2980]].min() > 0.0 > each["port_difference"][1980]
        # The flanks give 500 N·m/rad under the pump's torque, friction and leakage on both sides of zero.
        torque = displacement * np.abs(each["port_difference"][[980, 1980, 2980]])
        for k in (0, 2):
            bent = (torque[k] + torque[1]) / 500.0 if play else 0.0
            assert ends[k] - ends[1] == pytest.approx(play + bent, abs=4e-4)
    # Out of line, the pump's speed swings once a turn; twice the first harmonic over the motor's angle.
    # Without the play, through which the pump's own pressure pulses would drive it to and fro.
    swinging, steady = to_and_fro(FaultScales(coupling_play=0.0))
    for each, swing in ((swinging, 0.0 if case.spec.law == "play" else 0.02), (steady, 0.0)):
        rows = (each.time > 0.4) & (each.time < 0.98)
        share = each["pump_flow"][rows] / (displacement * each["pump_speed"][rows]) - 1.0
        found = 2.0 * abs(np.mean(share * np.exp(-1j * each["pump_angle"][rows])))
        assert found == pytest.approx(swing, abs=1e-3)
