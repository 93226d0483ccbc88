"""The chambers' volumes from the position dependence of compliance, on units whose volumes are known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from made_units import calibration_logs, random_unit

from fdd.identification import identify_unit
from fdd.identification.profile import Identification
from fdd.plant import oil as plant_oil
from fdd.samples import Samples
from fdd.unit import Cylinder, Unit

# Of the plant's own volumes: both chambers unequal, larger and smaller than the base's.
SCALES = [(1.25, 0.95), (0.8, 0.9), (1.0, 1.3)]


@cache
def unit_of(seed: int, scale_1: float, scale_2: float, bulk: float = 1.0) -> tuple[Unit, tuple[Samples, ...]]:
    """A random unit with scaled volumes, and healthy logs of it."""
    unit = random_unit(seed)
    unit.cylinder.volume_1 *= scale_1
    unit.cylinder.volume_2 *= scale_2
    unit.oil.bulk_modulus *= bulk
    return unit, tuple(calibration_logs(unit, seed))


def gain_and_split(cylinder: Cylinder, base: Cylinder) -> tuple[float, float]:
    """Mean volume of the base over that of the cylinder; half the chambers' difference over their mean."""
    total = cylinder.volume_1 + cylinder.volume_2
    return (base.volume_1 + base.volume_2) / total, (cylinder.volume_1 - cylinder.volume_2) / total


def std_of(found: Identification, quantity: str) -> float:
    (row,) = [r for r in found.table if r.quantity == quantity]
    assert row.std is not None
    return row.std


@pytest.mark.parametrize(("seed", "scale"), zip((1, 2, 1), SCALES, strict=True))
def test_volumes_of_both_chambers_are_found(seed: int, scale: tuple[float, float]) -> None:
    truth, logs = unit_of(seed, *scale)
    base = Unit.load("axis_a")
    found = identify_unit(list(logs), base)
    gain, split = gain_and_split(found.unit.cylinder, base.cylinder)
    true_gain, true_split = gain_and_split(truth.cylinder, base.cylinder)
    assert gain == pytest.approx(true_gain, abs=0.08)
    assert split == pytest.approx(true_split, abs=0.01)
    assert found.unit.cylinder.position_compliance == 1.0
    for chamber in ("volume_1", "volume_2"):
        error = getattr(found.unit.cylinder, chamber) - getattr(truth.cylinder, chamber)
        assert abs(error) < 3.0 * std_of(found, f"cylinder.{chamber}")
    # Volume in hand, bulk modulus is no longer relative to the base's: without it it would be up to 15 % off.
    beta = float(plant_oil.bulk_modulus(truth.oil, found.unit.oil.reference_pressure))
    assert found.unit.oil.bulk_modulus == pytest.approx(beta, rel=0.06)
    assert abs(found.unit.oil.bulk_modulus - beta) < 3.0 * std_of(found, "oil.bulk_modulus")
    assert any("volumes follow from" in note for note in found.notes)
    assert not any("volumes stay" in note for note in found.notes)


def test_strokes_too_short_leave_the_bases_volumes() -> None:
    """Sines of some millimetres: compliance hardly changes over them."""
    base, logs = Unit.load("axis_a"), unit_of(1, *SCALES[0])[1]
    found = identify_unit([logs[1]], base)
    assert np.ptp(logs[1]["position"]) < 0.1 * np.ptp(logs[0]["position"]) + 0.05
    assert found.unit.cylinder == base.cylinder
    assert any("compliance against position does not tell" in note for note in found.notes)
    assert any("volumes stay the base's" in note for note in found.notes)


@cache
def halved() -> tuple[Unit, Identification]:
    """A unit of half the volumes and half the bulk modulus: in mid-stroke as compliant as its base."""
    truth, logs = unit_of(1, 0.5, 0.5, 0.5)
    return truth, identify_unit(list(logs), Unit.load("axis_a"))


def test_a_gain_of_two_is_no_volume() -> None:
    truth, found = halved()
    base = Unit.load("axis_a").cylinder
    gain, split = gain_and_split(found.unit.cylinder, base)
    assert gain == pytest.approx(1.0, abs=1e-9)
    assert split == pytest.approx(0.0, abs=0.01)
    assert found.unit.cylinder.position_compliance == pytest.approx(2.0, abs=0.08)
    std = std_of(found, "cylinder.position_compliance")
    assert abs(found.unit.cylinder.position_compliance - 2.0) < 3.0 * std < 0.5
    assert any("volumes stay the base's" in note for note in found.notes)
    # Bulk modulus goes with the volumes: twice that of the oil, as the volumes are.
    beta = float(plant_oil.bulk_modulus(truth.oil, found.unit.oil.reference_pressure))
    assert found.unit.oil.bulk_modulus == pytest.approx(2.0 * beta, rel=0.05)
