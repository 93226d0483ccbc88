"""The chambers' volumes from the position dependence of compliance, on units whose volumes are known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import yaml
from made_units import calibration_logs, only, random_unit

from fdd.errors import InputError
from fdd.identification import identify_unit
from fdd.identification.balance import Estimate
from fdd.identification.profile import Identification
from fdd.identification.volumes import VolumeFit
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


def compliance(unit: Unit, position: float, pressure: float, chamber: int) -> float:
    """Oil volume taken up per pascal, m³/Pa, by the plant's law for the oil."""
    c = unit.cylinder
    sign, area, volume = (1.0, c.area_1, c.volume_1) if chamber == 1 else (-1.0, c.area_2, c.volume_2)
    swept = sign * c.position_compliance * area * position
    return (volume + swept) / float(plant_oil.bulk_modulus(unit.oil, pressure))


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


def test_a_pressure_difference_alone_tells_no_volumes() -> None:
    """The chambers' pressures are then reconstructed, with the base's volumes: these would come out again."""
    base, logs = Unit.load("axis_a"), unit_of(1, *SCALES[0])[1]
    found = identify_unit([only(g, "position", "pump_angle", "pressure_difference") for g in logs], base)
    assert found.unit.cylinder == base.cylinder
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


@pytest.mark.parametrize("chamber", [1, 2])
def test_compliance_at_each_position_is_the_units(chamber: int) -> None:
    """The profile is not the unit, yet what the filters use of it is: volume over bulk modulus."""
    truth, found = halved()
    pressure = found.unit.oil.reference_pressure
    for position in (-0.06, 0.0, 0.06):
        expected = compliance(truth, position, pressure, chamber)
        assert compliance(found.unit, position, pressure, chamber) == pytest.approx(expected, rel=0.05)
    # How much it changes from one end to the other: 18 %, of which the volumes alone would explain half.
    swept = [
        np.log(compliance(unit, 0.06, pressure, chamber) / compliance(unit, -0.06, pressure, chamber))
        for unit in (found.unit, truth)
    ]
    assert abs(swept[1]) > 0.15
    assert swept[0] == pytest.approx(swept[1], rel=0.05)


def test_a_base_with_a_position_compliance_is_corrected_not_replaced() -> None:
    """Identified again from its own profile, a unit stays what it is; from a near one it gets there."""
    _, first = halved()
    logs = list(unit_of(1, 0.5, 0.5, 0.5)[1])
    again = identify_unit(logs, first.unit).unit.cylinder
    assert again.position_compliance == first.unit.cylinder.position_compliance
    assert again.volume_1 == pytest.approx(first.unit.cylinder.volume_1, rel=0.05)
    base = Unit.load("axis_a")
    base.cylinder.position_compliance = 0.8
    found = identify_unit(logs, base)
    assert found.unit.cylinder.position_compliance == pytest.approx(2.0, abs=0.1)
    assert found.unit.cylinder.volume_1 == pytest.approx(base.cylinder.volume_1, rel=0.01)
    assert 0.0 < std_of(found, "cylinder.position_compliance") < 0.2


@pytest.mark.parametrize(
    ("gain", "std", "of_volume"), [(1.5, 0.02, True), (1.7, 0.02, False), (1.7, 0.2, True)]
)
def test_a_volume_is_believed_within_three_standard_deviations_of_the_bases(
    gain: float, std: float, of_volume: bool
) -> None:
    """15 % among units of one kind; ln 1.5 is 2.7 of these, ln 1.7 is 3.5."""
    for value in (gain, 1.0 / gain):
        fit = VolumeFit(Estimate(value, std), Estimate(0.1, 0.01))
        assert fit.of_volume == of_volume
        unit = Unit.load("axis_a")
        before = unit.cylinder.volume_1
        fit.apply(unit)
        shrink = value if of_volume else 1.0
        assert unit.cylinder.volume_1 == pytest.approx(1.1 * before / shrink)
        assert unit.cylinder.volume_2 == pytest.approx(0.9 * before / shrink)
        assert unit.cylinder.position_compliance == pytest.approx(1.0 if of_volume else value)


def test_profiles_without_it_are_those_of_rigid_walls() -> None:
    data = yaml.safe_load(Unit.load("axis_a").to_yaml())
    data["cylinder"].pop("position_compliance", None)
    assert Unit.from_yaml(yaml.safe_dump(data)).cylinder.position_compliance == 1.0
    for value in (0.0, -1.0, 6.0, float("nan")):
        data["cylinder"]["position_compliance"] = value
        with pytest.raises(InputError, match="position_compliance"):
            Unit.from_yaml(yaml.safe_dump(data))
