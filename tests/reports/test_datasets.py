"""What is measured of a data set's units: slips of units of measure, truth as an identification counts it."""

from __future__ import annotations

import numpy as np
import pytest

from fdd.identification.profile import Identification, TableRow
from fdd.samples import Samples
from fdd.unit import Unit
from reports.datasets import CHAMBERS, SLIPS, SOUND, SWAPPED, counted, departures, scales_table, slipped


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
