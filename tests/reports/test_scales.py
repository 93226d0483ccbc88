"""The slips of units of measure that ``python -m reports scales`` tries."""

from __future__ import annotations

import numpy as np

from fdd.samples import Samples
from reports.scales import CHAMBERS, SLIPS, SOUND, SWAPPED, slipped, table


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
    text = table([(SWAPPED, "refused"), (SWAPPED, "warned"), (SWAPPED, "passed"), (SOUND, "passed")])
    (swapped,) = [line for line in text.splitlines() if SWAPPED in line]
    (sound,) = [line for line in text.splitlines() if SOUND in line]
    assert swapped.count("0.33") == 2 and "0.00" in sound
