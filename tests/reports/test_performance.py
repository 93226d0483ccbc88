"""What ``python -m reports plant`` says; what it measures is in `tests/plant`."""

from reports.plant.numerics import Difference, RealTime
from reports.plant.report import Measured, Plan, report_text
from reports.plant.wild import Outcome


def test_the_report_says_what_was_found() -> None:
    half = Difference("sines", {"position": 0.02, "pump_angle": 3.0})
    speeds = [RealTime("steps", 320.0, 1.5), RealTime("two axes", 100.0, 1.5)]
    wild = [Outcome(0, [], 1e4, -0.1, 2.0), Outcome(7, ["NaN"])]
    text = report_text(Measured(Plan(), speeds, [half], [half], wild))
    for told in ("320", "steps, has 320: met", "seed 7: NaN", "The worst is 2.0e-02", "28 µrad"):
        assert told in text
    missed = report_text(Measured(Plan(), [RealTime("sines", 299.0, 1.5)]))
    assert "299: missed" in missed and "Robustness" not in missed
