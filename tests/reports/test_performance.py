"""What ``python -m reports plant`` measures: peers solve the same problem; what its report says."""

import pytest

from reports.plant.report import WORK, Plan, RealTime, report_text, work_precision
from reports.plant.wild import Outcome

pytestmark = pytest.mark.slow


def test_peers_solve_the_same_and_the_report_says_what_was_found():
    work, trust = work_precision(WORK, 0.06, 1)
    ours = [point for point in work if point.solver == "this plant"]
    assert [point.evaluations for point in ours] == sorted(point.evaluations for point in ours)
    assert ours[-1].pressure < ours[0].pressure
    assert {point.solver for point in work} == {"this plant", "SciPy RK45", "SciPy LSODA", "SciPy Radau"}
    tight = [point for point in work if point.setting == "rtol 1e-09"]
    assert len(tight) == 3 and all(point.pressure < 50.0 for point in tight), "Pa; the sensor's noise is 7000"
    speed = [RealTime("steps", 320.0, 1.5), RealTime("two axes", 100.0, 1.5)]
    text = report_text(Plan(), speed, work, trust, [Outcome(0, [], 1e4, -0.1, 2.0), Outcome(7, ["NaN"])])
    for told in ("320", "steps, has 320: met", "seed 7: NaN", "refine 1", "SciPy Radau"):
        assert told in text
    missed = report_text(Plan(), [RealTime("sines", 299.0, 1.5)], work, trust, [])
    assert "299: missed" in missed and "Robustness" not in missed
