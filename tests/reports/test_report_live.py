"""What ``python -m reports load``, ``troubles`` and ``plant`` measure and say."""

from pathlib import Path

import numpy as np
import pytest

from fdd.samples import CHANNELS, Samples
from fdd.service.blocks import Decoder
from reports.__main__ import app
from reports.live import capacity
from reports.live.capacity import Inside, Overload, Stage, inside, logs, messages, ramp, why_not
from reports.live.report import report_text
from reports.plant.numerics import WORK, RealTime, work_precision
from reports.plant.report import Measured, Plan
from reports.plant.report import report_text as plant_text
from reports.plant.wild import Outcome as Wild
from reports.troubles import TROUBLES, Outcome
from reports.troubles import report_text as troubles_text

MB = 10**6


@pytest.fixture(scope="module")
def recorded() -> list[Samples]:
    return logs(31.0)


def stage(axes: int, **more: object) -> Stage:
    given = {
        "cpu_us": 8.0, "busy": 8e-3 * axes, "lag": 0.5, "lag_99": 0.8, "looks": 100, "findings": 1,
        "finding_lag": 0.7, "dropped": 0, "behind": 0.2, "late": 0.01, "rss": (200 + 3 * axes) * MB,
    }  # fmt: skip
    return Stage(axes, **{**given, **more})


def test_messages_hold_the_whole_log(recorded: list[Samples]) -> None:
    log = recorded[1]
    blocks = [Decoder().decode(m, axis="A1") for m in messages(log)]
    assert [b.sequence for b in blocks] == list(range(310))
    joined = Samples.concatenate([b.samples for b in blocks])
    assert set(joined.channels) == set(CHANNELS) - {"time", "load_force"}, "all that the rig has"
    for name in joined.channels:
        assert np.array_equal(joined[name], log[name], equal_nan=True)


def test_the_fleet_costs_more_than_the_pipeline_alone(recorded: list[Samples]) -> None:
    cost = inside(recorded, axes=1, seconds=8.0, repeats=1, aged_s=0.0)
    assert cost.whole > cost.alone > 1.0


def test_the_report_says_what_was_found() -> None:
    cost = Inside(10, 60.0, 9.0, 7.5, 3.0 * MB, 660.0)
    over = Overload(160, 60.0, 50, 0.8, "overloaded", 700 * MB, 9_600_000, 9_600_000, 90.0)
    stages, cases = [stage(50), stage(100), stage(120, lag_99=1.4)], {"every axis leaks": stage(40, lag=0.33)}
    text = report_text(cost, stages, 60.0, None, cases, over)
    for told in (
        "on one core: 100 axes.",
        "the service adds 1.5 µs",
        "3.0 MB an axis after 660 s",
        "| every axis leaks | 8.0 | 32 % | 0.33 |",
        "**50** of them (31 %) were followed, with a median lag of 0.80 s",
        "9,600,000 samples were sent; 9,600,000 were worked 90 s after",
    ):
        assert told in text
    missed = report_text(cost, [stage(50), stage(100, dropped=3)], 60.0)
    assert "on one core: 50 axes." in missed
    assert "Not measured in real time: no mosquitto here." in report_text(cost, [], 60.0, "no mosquitto here")


def test_without_a_broker_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capacity, "MOSQUITTO", None)
    assert "install it (Debian: mosquitto)" in (why_not() or "")


def test_numbers_of_axes_are_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for wrong in ("many", "0,10", "2000"):
        assert app(["load", "-o", str(tmp_path), "--axes", wrong], standalone_mode=False) == 2
        assert f"--axes {wrong!r}" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(why_not() is not None, reason=str(why_not()))
def test_one_axis_in_real_time(recorded: list[Samples]) -> None:
    (one,) = ramp(recorded, [1], 14.0, lambda line: None)
    assert one.axes == 1 and one.looks >= 1 and one.dropped == 0
    assert 0.0 < one.lag <= one.lag_99 and one.cpu_us > 1.0 and one.rss > 50 * MB


@pytest.mark.slow
@pytest.mark.skipif(why_not() is not None, reason=str(why_not()))
def test_an_outage_loses_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    app(["outage", "--axes", "2", "--seconds", "40"], standalone_mode=False)
    said = capsys.readouterr().out
    assert "100,000 of 100,000 samples are worked" in said
    assert "1 findings, 1 alarms raised, of 1 axes that leak" in said


def test_a_loss_is_told_as_wrong() -> None:
    kept = Outcome("store locked", "held", "is locked", 100, 100, 0)
    lost = Outcome("disk full", "filled", "ok | fine", 100, 90, 7, ["10 samples were never taken"])
    rows = troubles_text([kept, lost], ["quota reached"]).splitlines()
    assert "| store locked | held | is locked | 100 | 100 | 0 | as it should be |" in rows
    told = "| disk full | filled | ok \\| fine | 100 | 90 | 7 | WRONG: 10 samples were never taken |"
    assert told in rows and "Left out: quota reached (needs root, to mount a small disk)." in rows


def test_an_unknown_trouble_is_refused_in_one_line(tmp_path, capsys):
    assert app(["troubles", "--only", "flood", "-o", str(tmp_path)], standalone_mode=False) == 2
    assert "no trouble 'flood'" in capsys.readouterr().err
    assert len({trouble.tried for trouble in TROUBLES}) == len(TROUBLES)


@pytest.fixture(scope="module")
def measured() -> Measured:
    work, trust = work_precision(WORK, 0.06, 1)
    return Measured(
        Plan(), [RealTime("steps", 320.0, 1.5), RealTime("two axes", 100.0, 1.5)], work, trust,
        [Wild(0, [], 1e4, -0.1, 2.0), Wild(7, ["NaN"])],
    )  # fmt: skip


@pytest.mark.slow
def test_errors_fall_as_work_rises(measured):
    ours = [point for point in measured.work if point.solver == "this plant"]
    assert [point.evaluations for point in ours] == sorted(point.evaluations for point in ours)
    assert ours[-1].pressure < ours[0].pressure
    peers = {"SciPy RK45", "SciPy LSODA", "SciPy Radau"}
    assert {point.solver for point in measured.work} == {"this plant", *peers}


@pytest.mark.slow
def test_the_report_on_the_plant_says_what_was_found(measured):
    text = plant_text(measured)
    for told in ("320", "steps, has 320: met", "seed 7: NaN", "refine 1", "SciPy Radau"):
        assert told in text
    slow = [RealTime("sines", 299.0, 1.5)]
    missed = plant_text(Measured(measured.plan, slow, measured.work, measured.trust))
    assert "299: missed" in missed and "Robustness" not in missed
