"""What ``python -m reports plant`` measures: peers solve the same problem; what its report says."""

import pytest

from reports.plant.numerics import WORK, RealTime, work_precision
from reports.plant.report import Measured, Plan, report_text
from reports.plant.wild import Outcome

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def measured() -> Measured:
    work, trust = work_precision(WORK, 0.06, 1)
    return Measured(
        Plan(), [RealTime("steps", 320.0, 1.5), RealTime("two axes", 100.0, 1.5)], work, trust,
        [Outcome(0, [], 1e4, -0.1, 2.0), Outcome(7, ["NaN"])],
    )  # fmt: skip


def test_errors_fall_as_work_rises(measured):
    ours = [point for point in measured.work if point.solver == "this plant"]
    assert [point.evaluations for point in ours] == sorted(point.evaluations for point in ours)
    assert ours[-1].pressure < ours[0].pressure
    peers = {"SciPy RK45", "SciPy LSODA", "SciPy Radau"}
    assert {point.solver for point in measured.work} == {"this plant", *peers}


def test_the_report_says_what_was_found(measured):
    text = report_text(measured)
    for told in ("320", "steps, has 320: met", "seed 7: NaN", "refine 1", "SciPy Radau"):
        assert told in text
    slow = [RealTime("sines", 299.0, 1.5)]
    missed = report_text(Measured(measured.plan, slow, measured.work, measured.trust))
    assert "299: missed" in missed and "Robustness" not in missed
