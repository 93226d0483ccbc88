"""Two logs of a simulated unit, and spectra of which the lines are known."""

from typing import Any

import numpy as np
import pytest

from fdd.diagnosis.pipeline import Pipeline
from fdd.history import Comparison
from fdd.history.compare import NO_CHANGE, Side, changed_lines, compare, spectra_of
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
    return compare(a, b, UNIT)[0]


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
    answer, spectra = compare(before, before, UNIT)
    answer.a.log = "<script>alert(1)</script>"
    html = render_sheet(compare_sheet(answer, spectra))
    assert "<script>alert" not in html and "&lt;script&gt;alert" in html
    assert html.count('class="plot"') == len(spectra) > 4
    assert "default-src 'none'" in html and len(html) < 1_500_000


def turning(
    seed: int, lines: dict[float, float], *, rate: float = 1000.0, duration: float = 40.0, speed: float = 90.0
) -> Samples:
    """White pressure noise of 1 kPa with sines of given amplitude, orders of a shaft that turns evenly."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(duration * rate)) / rate
    pressure = rng.normal(0.0, 1e3, time.size)
    for order, amplitude in lines.items():
        pressure += amplitude * np.sin(order * speed * time)
    keep = rng.uniform(size=time.size) > 0.01
    columns = {"pressure_1": pressure, "pump_angle": speed * time}
    return Samples(time[keep], {k: v[keep] for k, v in columns.items()})


@pytest.mark.parametrize("rate", [1000.0, 700.0])
def test_the_line_that_came_is_named_by_frequency_and_order(rate):
    a, b = turning(1, {11.0: 400.0}), turning(2, {11.0: 400.0, 7.0: 600.0}, rate=rate)
    spectra = spectra_of(a, b)
    found = {x.channel: x for x in changed_lines(spectra, a, b)}["pressure_1"]
    assert found.beyond_chance and found.ratio > 10.0
    assert found.frequency_hz == pytest.approx(7.0 * 90.0 / (2.0 * np.pi), abs=0.5)
    assert found.order == pytest.approx(7.0, abs=0.05)
    gone = {x.channel: x for x in changed_lines(spectra_of(b, a), b, a)}["pressure_1"]
    assert gone.frequency_hz == pytest.approx(found.frequency_hz, abs=0.5) and gone.ratio < 0.1


def test_densities_hold_the_signals_power_and_short_logs_or_varying_speeds_have_no_line_or_order():
    a = turning(1, {})
    spectrum = next(s for s in spectra_of(a, turning(2, {})) if s.channel == "pressure_1")
    step = spectrum.frequency[1] - spectrum.frequency[0]
    # Interpolated over the hundredth that is missing.
    assert spectrum.a.sum() * step == pytest.approx(1e6, rel=0.04)
    short = turning(1, {}, duration=7.0)
    assert spectra_of(short, short) == [] and changed_lines([], short, short) == []
    a = turning(1, {11.0: 900.0})
    swept = a.with_columns({"pump_angle": 90.0 * a.time + 0.5 * 4.0 * a.time**2})
    assert {x.order for x in changed_lines(spectra_of(swept, swept), swept, swept)} == {None}


@pytest.mark.slow
def test_noise_alone_has_lines_beyond_chance_once_in_a_hundred():
    told = 0
    for seed in range(100):
        a, b = turning(seed, {}, duration=12.0), turning(seed + 500, {}, duration=20.0)
        found = changed_lines(spectra_of(a, b), a, b)
        told += any(x.beyond_chance for x in found if x.channel == "pressure_1")
    assert told <= 4
