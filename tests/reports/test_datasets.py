"""What is measured of data sets and disturbed logs: slips of units, identification, losses, answers."""

from typing import Any

import numpy as np
import pytest

from fdd import Samples, Unit
from fdd.campaign.labels import Label
from fdd.identification import Identification, TableRow
from reports import datasets, disturbed
from tests.made_up import answer, entry, finding, label


def test_a_log_slips_in_the_channels_it_has() -> None:
    time = np.arange(5) * 1e-3
    log = Samples(time, {"position": 0.01 * time, "pressure_1": 1e5 + time, "pressure_2": 2e5 + time})
    found = datasets.slipped(log)
    assert set(found) == {*datasets.SLIPS, datasets.SWAPPED} - {"rpm read as rad/s", "degrees read as rad"}
    np.testing.assert_array_equal(found[datasets.SWAPPED]["pressure_1"], log["pressure_2"])
    np.testing.assert_allclose(found["ms read as s"].time, np.arange(5))
    np.testing.assert_allclose(found["bar read as MPa"]["pressure_2"], 10.0 * log["pressure_2"])
    one = found["one chamber in MPa read as bar"]
    np.testing.assert_array_equal(one["pressure_2"], log["pressure_2"])
    np.testing.assert_allclose(one["pressure_1"], 0.1 * log["pressure_1"])
    chamber = datasets.CHAMBERS[0]
    np.testing.assert_array_equal(found["mm read as cm"][chamber], log[chamber])


def test_the_truth_is_counted_with_the_sheets_area() -> None:
    """Test: a true unit of 10 % more area. Expected: what flow tells of it is in the same ratios."""
    sheet, true = Unit.load("axis_a"), Unit.load("axis_a")
    true.cylinder.area_1 *= 1.1
    true.cylinder.area_2 *= 1.1
    seen = datasets.counted(true, sheet)
    assert seen.cylinder.area_1 == pytest.approx(sheet.cylinder.area_1)
    gains = [u.pump.displacement / u.cylinder.area_1 for u in (seen, true)]
    volumes = [u.cylinder.volume_1 / u.pump.displacement for u in (seen, true)]
    assert (gains[0], volumes[0]) == pytest.approx((gains[1], volumes[1]))


def test_departures_are_in_standard_deviations() -> None:
    unit = Unit.load("axis_a")
    std = 0.01 * unit.pump.displacement
    row = TableRow("pump.displacement", "m^3/rad", 1.0, unit.pump.displacement + 2.0 * std, std)
    found = Identification(unit, unit, "test", [row])
    assert datasets.standardised(found, unit) == {"travel per rad": pytest.approx(2.0)}


LEAK = "internal_leakage"


def said(name: str, verdict: str, score: float, misfit: float, found: tuple, *true: Label, **more: Any):
    labelled = entry(*true, file=f"unit_000/{name}", structure="thesis", **{"visible": True, **more})
    return datasets.Said(labelled, verdict, score, misfit, found)


def test_what_is_lost_is_told_by_its_kind() -> None:
    leak = (("pump_wear", ("pump_wear", LEAK)),)
    found = [
        said("a", "faulty", 9.0, 90.0, leak, label(LEAK, 0.0)),
        said("b", "faulty", 9.0, 90.0, (("aeration", ("aeration",)),), label(LEAK, 20.0)),
        said("c", "healthy", 2.0, 5.0, (), label(LEAK, 20.0)),
        said("d", "healthy", 2.0, 5.0, (), label(LEAK, 20.0, 0.1)),
        said("e", "healthy", 2.0, 51.0, (), label(LEAK, 20.0), visible=False),
        said("f", "faulty", 6.0, 90.0, leak, visible=None),
        said("g", "healthy", 1.0, 5.0, (), visible=None),
    ]
    lines = datasets.budget_table(found).splitlines()
    (whole,) = (line for line in lines if line.startswith("| all"))
    asked = "0.67" in whole and "of 3" in whole and "0.33" in whole
    assert asked, "a small and an invisible one are not"
    (start,) = (line for line in lines if "from the first sample" in line)
    assert "1.00" in start and "of 1" in start
    assert "0.50" in lines[0] and "of 2" in lines[0], "healthy logs called faulty"
    assert any("unit_000/f 6.0" in line for line in lines)
    assert any("more than 50 nats" in line and line.endswith("1 of 7 logs.") for line in lines)


def test_departures_are_told_over_what_is_stated() -> None:
    """Test: a hundred departures, two of them far. Expected: rms, share, and the farthest log."""
    found = [datasets.Departure("volume", "leak", 1.0, 0.05, f"unit_000/log_{k:03d}") for k in range(98)]
    found += [datasets.Departure("volume", "leak", z, 0.05, "unit_000/odd") for z in (4.0, -10.0)]
    found += [datasets.Departure("force", "damping", 1.0, 0.5, "unit_000/few") for _ in range(5)]
    (row,) = (line for line in datasets.budget_table(found).splitlines() if "leak" in line)
    assert all(told in row for told in ("| 100 |", "1.48", "1.46", "0.02", "unit_000/odd -10.0"))
    assert "damping" not in datasets.budget_table(found), "too few logs say nothing"


RATE = 1000


@pytest.fixture(scope="module")
def log() -> Samples:
    """Twelve seconds of smooth motion and unlike pressures."""
    time = 3.0 + np.arange(12 * RATE) / RATE
    angle = 80.0 * np.sin(2.0 * time) + time
    columns = {
        "position": 2e-5 * angle, "pump_angle": angle, "pump_speed": 160.0 * np.cos(2.0 * time) + 1.0,
        "pressure_1": 1e6 + 2e5 * np.sin(3.0 * time), "pressure_2": 8e5 + 1e5 * np.cos(5.0 * time),
        "pressure_difference": 2e5 + 3e5 * np.sin(4.0 * time), "oil_temperature": 40.0 + 0.01 * time,
    }  # fmt: skip
    return Samples(time, columns)


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.mark.parametrize("rate", [200.0, 500.0, 2000.0])
def test_at_another_rate_it_is_the_same_motion(log: Samples, rate: float) -> None:
    other = disturbed.at_rate(rate)(log, rng())
    step = max(1.0 / rate, 1e-3)  # the reader makes means of a faster log
    np.testing.assert_allclose(np.diff(other.time)[:-1], step, atol=1e-9)
    assert other.time[0] == pytest.approx(log.time[0], abs=step)
    assert other.time[-1] > log.time[-1] - 2.0 * step
    for name in ("position", "pressure_1", "oil_temperature"):
        right = np.interp(other.time, log.time, log[name])
        np.testing.assert_allclose(other[name], right, rtol=1e-6, atol=1e-6 * np.ptp(log[name]), err_msg=name)
    turned = np.cumsum(other["pump_speed"][1:] * np.diff(other.time))
    np.testing.assert_allclose(turned, other["pump_angle"][1:] - other["pump_angle"][0], atol=0.2)


def test_seen_from_the_other_end_motion_turns_and_chambers_swap(log: Samples) -> None:
    other = disturbed.mirrored(log)
    np.testing.assert_array_equal(other["pressure_1"], log["pressure_2"])
    np.testing.assert_array_equal(other["pressure_2"], log["pressure_1"])
    for name in ("position", "pump_angle", "pump_speed", "pressure_difference"):
        np.testing.assert_array_equal(other[name], -log[name])
    np.testing.assert_array_equal(other["oil_temperature"], log["oil_temperature"])
    back = disturbed.mirrored(other)
    assert all(np.array_equal(back[name], log[name]) for name in log.channels)
    bare = Samples(log.time, {"pressure_1": log["pressure_1"]})
    np.testing.assert_array_equal(disturbed.mirrored(bare)["pressure_1"], log["pressure_1"])


def test_answers_are_compared_by_verdict_leading_group_and_onset() -> None:
    leak = finding(LEAK, 10.0, ambiguity=[LEAK, "pump_wear"])
    other, air = finding("pump_wear", 10.9), finding("aeration", 11.2)
    healthy, faulty = answer("healthy"), answer("faulty", leak)
    assert disturbed._same(healthy, healthy) == (True, True, True)
    assert disturbed._same(healthy, faulty) == disturbed._same(faulty, healthy) == (False, False, False)
    assert disturbed._same(faulty, answer("faulty", other)) == (True, True, True)
    assert disturbed._same(answer("faulty", other), faulty) == (True, True, True)
    assert disturbed._same(faulty, answer("inconclusive", air)) == (False, False, False)
    late = answer("faulty", finding(LEAK, 11.1), leak)
    assert disturbed._same(faulty, late) == (True, True, False), "the leading one's"


def test_a_mirrored_profile_has_its_ends_swapped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disturbed, "add_baseline", lambda unit, logs: unit)
    unit = Unit.load("axis_a")
    c = unit.cylinder
    unit.cylinder = c.model_copy(update={"area_2": 0.9 * c.area_1, "volume_2": 1.3 * c.volume_1})
    for name, zero in (("position", 1e-3), ("pressure_1", 5e3)):
        unit.sensors[name] = unit.sensor(name).model_copy(update={"zero": zero})
    turned = disturbed.mirrored_unit(unit, [])
    assert turned.cylinder.area_1 == unit.cylinder.area_2 and turned.cylinder.area_2 == unit.cylinder.area_1
    assert turned.cylinder.volume_1 == unit.cylinder.volume_2
    assert turned.friction.forward == unit.friction.reverse
    assert turned.sensor("position").zero == -1e-3 and turned.sensor("pressure_2").zero == 5e3
    assert disturbed.mirrored_unit(turned, []) == unit
