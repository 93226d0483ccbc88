"""What the report counts of identified units: truth in the measure of an identification, and its table."""

from __future__ import annotations

import pytest

from fdd.identification.profile import Identification, TableRow
from fdd.unit import Unit
from reports.identification import counted, departures


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
    assert departures(Identification(unit, unit, "test", [row]), unit) == {
        "travel per rad": pytest.approx(2.0)
    }
