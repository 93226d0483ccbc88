"""What severity 1 of worn seals and of bad oil is, by the catalogue's words, measured from runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fault_case import Case, lost, over_time

from fdd.plant.details import Details
from fdd.plant.duty import Levels
from fdd.plant.load import NoLoad
from fdd.plant.oil import viscosity_ratio
from fdd.plant.scenario import Control, Recording
from fdd.plant.truth import Truth
from fdd.unit import FrictionBranch


def strokes(case: Case, speed: float, duration: float) -> tuple[Truth, Truth]:
    """Faulty and healthy at a steady pump speed, from 7 cm before mid-stroke."""
    changes: dict[str, Any] = {
        "duration": duration, "duty": Levels(points=speed, offset=-np.copysign(0.07, speed)),
        "load": NoLoad(), "control": Control(mode="speed"), "details": Details(pump_ripple=0.0),
        "recording": Recording.perfect(),
    }  # fmt: skip
    return case.again(**changes)


def dry(branch: FrictionBranch, v: float, level: float = 1.0, rest: float = 1.0) -> float:
    """Friction (N) of eq. 5.9 but for its viscous part, of a scaled level and a scaled part beyond it."""
    falling = np.exp(-((abs(v) / branch.stribeck_velocity) ** branch.stribeck_exponent))
    return float(level * branch.coulomb + rest * (branch.static - branch.coulomb) * falling)


def friction_changes(
    case: Case,
    forward: tuple[float, float],
    reverse: tuple[float, float],
    viscous: float,
    *,
    thicker: float = 1.0,
) -> None:
    """Each direction's level at speed and what rest has beyond it, and the viscous part, over the healthy.

    At two speeds of steady sliding, against eq. 5.9 with the unit's own curve and this run's draw.
    """
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
    """Friction at mid-stroke is `full`, a quarter of the stroke away as ever.

    Worn in one direction, half of it is there all along that direction, half at mid-stroke both ways.
    """
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


FRICTION_CHECKS: dict[str, Callable[[Case], None]] = {
    check.__name__: check for check in (seal_wear, oil_degradation)
}
