"""Two logs of a simulated unit."""

from typing import Any

import numpy as np
import pytest

from fdd.diagnosis.pipeline import Pipeline
from fdd.history import Comparison
from fdd.history.compare import NO_CHANGE, Side, compare
from fdd.history.view import compare_sheet
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.report.page import render_sheet
from fdd.samples import Samples
from fdd.unit import Unit

UNIT = Unit.load("axis_a")
SHORT = {"name": "steps", "amplitude": 0.03, "hold": 1.0}
PUSH = {"name": "constant"}


def side(**scenario: Any) -> Side:
    samples = simulate(UNIT, Scenario(duration=40.0, **scenario)).samples
    pipeline = Pipeline(UNIT, log="run.mcap")
    pipeline.push(samples)
    return Side(pipeline.finish(), pipeline.trajectories(), samples)


def leak(severity: float) -> list[dict[str, Any]]:
    return [{"fault": "internal_leakage", "severity": severity, "onset": 0.0}]


@pytest.fixture(scope="module")
def before() -> Side:
    return side(load={"name": "spring"}, oil_temperature=30.0, seed=1)


def compared(a: Side, b: Side) -> Comparison:
    return compare(a, b, UNIT)


def test_nothing_is_told_of_two_healthy_logs_of_other_duty_and_temperature(before):
    found = compared(before, side(duty=SHORT, load=PUSH, oil_temperature=48.0, seed=2))
    assert found.headline == NO_CHANGE
    assert not any(c.changed for c in found.estimates)
    row = found.estimates[0]
    assert row.quantity == "leakage" and row.a == pytest.approx(6.52e-12, rel=0.05)
    assert row.b == pytest.approx(row.a, rel=0.05), "temperature alone makes it 1.9 times"


def test_a_leak_of_three_tenths_is_told_unless_the_oils_temperature_may_be_why(before):
    leaks = side(duty=SHORT, load=PUSH, oil_temperature=48.0, seed=3, faults=leak(0.3))
    found, back = compared(before, leaks), compared(leaks, before)
    row = found.estimates[0]
    assert row.changed and found.headline.startswith("leakage coefficient rose by")
    assert row.difference == pytest.approx(0.3 * 12e-12, abs=2.0 * (row.std or 0.0))
    assert [c.quantity for c in found.estimates if c.changed] == ["leakage"]
    assert back.headline.startswith("leakage coefficient fell by")
    assert back.estimates[0].p_value == row.p_value
    known = {n: before.samples[n] for n in before.samples.channels if n != "oil_temperature"}
    found = compared(Side(before.answer, before.trajectories, Samples(before.samples.time, known)), leaks)
    assert not found.estimates[0].changed and "Oil temperature" in found.notes[0]


def test_balances_and_duty_are_those_of_the_logs_and_the_page_is_drawn(before):
    found = compared(before, before)
    assert found.headline == NO_CHANGE and all(c.p_value in (1.0, None) for c in found.estimates)
    volume = next(c for c in found.balances if c.balance == "volume")
    misfit = before.trajectories.features[:, before.trajectories.feature_names.index("volume")]
    told = misfit[misfit > 0.0]
    assert volume.a == volume.b == pytest.approx(float(np.linalg.norm(told)) / told.size**0.5, rel=1e-3)
    duty = {r.signal: r for r in found.duty}
    percentiles = np.nanpercentile(np.abs(before.samples["pressure_1"]), [5, 50, 95])
    assert duty["pressure_1"].a == pytest.approx(percentiles, rel=1e-3)
    assert "load_force" not in duty
    found.a.log = "<script>alert(1)</script>"
    html = render_sheet(compare_sheet(found))
    assert "<script>alert" not in html and "&lt;script&gt;alert" in html
    assert "default-src 'none'" in html and len(html) < 1_500_000
