"""What is measured of a data set's units: slips of units of measure, identification, the loss budget."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.campaign.dataset import Conditions, Entry, Label
from fdd.identification.profile import Identification, TableRow
from fdd.samples import Samples
from fdd.unit import Unit
from reports.datasets import (
    CHAMBERS,
    SLIPS,
    SOUND,
    SWAPPED,
    Departure,
    Said,
    Told,
    budget_table,
    counted,
    identification_table,
    left_out_table,
    scales_table,
    slipped,
    standardised,
)
from reports.disturbed import Comparison, disturbed_table


def test_a_log_slips_in_the_channels_it_has() -> None:
    time = np.arange(5) * 1e-3
    log = Samples(time, {"position": 0.01 * time, "pressure_1": 1e5 + time, "pressure_2": 2e5 + time})
    found = slipped(log)
    assert set(found) == {*SLIPS, SWAPPED} - {"rpm read as rad/s", "degrees read as rad"}
    np.testing.assert_array_equal(found[SWAPPED]["pressure_1"], log["pressure_2"])
    np.testing.assert_allclose(found["ms read as s"].time, np.arange(5))
    np.testing.assert_allclose(found["bar read as MPa"]["pressure_2"], 10.0 * log["pressure_2"])
    one = found["one chamber in MPa read as bar"]
    np.testing.assert_array_equal(one["pressure_2"], log["pressure_2"])
    np.testing.assert_allclose(one["pressure_1"], 0.1 * log["pressure_1"])
    np.testing.assert_array_equal(slipped(log)["mm read as cm"][CHAMBERS[0]], log[CHAMBERS[0]])


def test_the_table_counts_what_was_said() -> None:
    text = scales_table([(SWAPPED, "refused"), (SWAPPED, "warned"), (SWAPPED, "passed"), (SOUND, "passed")])
    (swapped,) = [line for line in text.splitlines() if SWAPPED in line]
    (sound,) = [line for line in text.splitlines() if SOUND in line]
    assert swapped.count("0.33") == 2 and "0.00" in sound


def test_each_table_has_its_rows() -> None:
    """What was identified, left out and disturbed, with shares of the right logs."""
    told = [
        Told("u0", "thesis", True, (), {"leakage": 2.5}, 1.001, 0.999),
        Told("u1", "lift", True, (), {"leakage": -1.5}, 1.05, 0.999),
        Told("u2", "lift", False, ("too noisy", "too short"), {}),
    ]
    lines = identification_table(told).splitlines()
    assert "Refused: 0.33 (0.06 to 0.79) of 3" in lines and "- u2 (lift): too noisy; too short" in lines
    assert any(line.startswith("Single rods") and "0.50" in line and "of 2" in line for line in lines)
    assert "| u1 | lift | 1.0500 | 0.9990 |" in lines
    (row,) = (line for line in lines if line.startswith("| leakage"))
    assert row.startswith("| leakage | 2.06 | +0.50 | 0.50 (")
    text = left_out_table([("seal_wear", "unknown"), ("seal_wear", "another"), ("aeration", "nothing")])
    assert "| seal wear | 0 | 1 | 0 | 1 |" in text and "with a finding: 0.50 (0.09 to 0.91) of 2" in text
    text = disturbed_table([Comparison("u0", "200 Hz", True, True, False)])
    assert "| 200 Hz | 1 | 1.00 (" in text and "1 units" in text and "| 500 Hz | 0 | - of 0" in text


def test_the_truth_is_counted_with_the_sheets_area() -> None:
    """Test: a true unit of 10 % more area. Expected: what flow tells of it is in the same ratios."""
    sheet, true = Unit.load("axis_a"), Unit.load("axis_a")
    true.cylinder.area_1 *= 1.1
    true.cylinder.area_2 *= 1.1
    seen = counted(true, sheet)
    assert seen.cylinder.area_1 == pytest.approx(sheet.cylinder.area_1)
    assert seen.pump.displacement / seen.cylinder.area_1 == pytest.approx(
        true.pump.displacement / true.cylinder.area_1
    )
    assert seen.cylinder.volume_1 / seen.pump.displacement == pytest.approx(
        true.cylinder.volume_1 / true.pump.displacement
    )


def test_departures_are_in_standard_deviations() -> None:
    unit = Unit.load("axis_a")
    std = 0.01 * unit.pump.displacement
    row = TableRow("pump.displacement", "m^3/rad", 1.0, unit.pump.displacement + 2.0 * std, std)
    assert standardised(Identification(unit, unit, "test", [row]), unit) == {
        "travel per rad": pytest.approx(2.0)
    }


def entry(file: str, *, onset: float | None, severity: float = 0.5, visible: bool = True) -> Entry:
    leak = Label(
        fault="internal_leakage", family="leakage", severity=severity, onset_s=onset or 0.0, profile="step"
    )
    faults = () if onset is None else (leak,)
    return Entry(
        file=f"unit_000/{file}", truth=f"unit_000/truth_{file}", unit="unit_000", base="axis_a",
        duration_s=60.0, samples=60_000, faults=faults, truth_medians={},
        visible=None if onset is None else visible, structure="thesis",
        scenario=Conditions(
            load="gust", duty="steps", control="position", oil_temperature=30.0, charge_factor=1.0, seed=1
        ),
    )  # fmt: skip


def test_what_is_lost_is_told_by_its_kind() -> None:
    leak = (("pump_wear", ("pump_wear", "internal_leakage")),)
    found = [
        Said(entry("a", onset=0.0), "faulty", 9.0, 90.0, leak),
        Said(entry("b", onset=20.0), "faulty", 9.0, 90.0, (("aeration", ("aeration",)),)),
        Said(entry("c", onset=20.0), "healthy", 2.0, 5.0, ()),
        Said(entry("d", onset=20.0, severity=0.1), "healthy", 2.0, 5.0, ()),
        Said(entry("e", onset=20.0, visible=False), "healthy", 2.0, 51.0, ()),
        Said(entry("f", onset=None), "faulty", 6.0, 90.0, leak),
        Said(entry("g", onset=None), "healthy", 1.0, 5.0, ()),
    ]
    lines = budget_table(found).splitlines()
    (whole,) = (line for line in lines if line.startswith("| all"))
    assert "0.67" in whole and "of 3" in whole and "0.33" in whole, (
        "a small and an invisible one are not asked"
    )
    (start,) = (line for line in lines if "from the first sample" in line)
    assert "1.00" in start and "of 1" in start
    assert "0.50" in lines[0] and "of 2" in lines[0], "healthy logs called faulty"
    assert any("unit_000/f 6.0" in line for line in lines)
    assert any("more than 50 nats" in line and line.endswith("1 of 7 logs.") for line in lines)


def test_departures_are_told_over_what_is_stated() -> None:
    """Test: a hundred departures, two of them far. Expected: rms, share, and the farthest log."""
    found = [Departure("volume", "leak", 1.0, 0.05, f"unit_000/log_{k:03d}") for k in range(98)]
    found += [Departure("volume", "leak", z, 0.05, "unit_000/odd") for z in (4.0, -10.0)]
    found += [Departure("force", "damping", 1.0, 0.5, "unit_000/few") for _ in range(5)]
    (row,) = (line for line in budget_table(found).splitlines() if "leak" in line)
    assert (
        "| 100 |" in row and "1.48" in row and "1.46" in row and "0.02" in row and "unit_000/odd -10.0" in row
    )
    assert "damping" not in budget_table(found), "too few logs say nothing"
