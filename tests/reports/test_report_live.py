"""What ``python -m reports load``, ``troubles`` and ``plant`` measure and say."""

from pathlib import Path

import numpy as np
import pytest

from fdd.samples import CHANNELS, Samples
from fdd.service.blocks import Decoder
from reports.__main__ import app
from reports.live import capacity
from reports.live.capacity import logs, messages, ramp, why_not
from reports.plant.numerics import WORK, work_precision
from reports.troubles import TROUBLES, Outcome
from reports.troubles import report_text as troubles_text


@pytest.fixture(scope="module")
def recorded() -> list[Samples]:
    return logs(31.0)


def test_messages_hold_the_whole_log(recorded: list[Samples]) -> None:
    log = recorded[1]
    blocks = [Decoder().decode(m, axis="A1") for m in messages(log)]
    assert [b.sequence for b in blocks] == list(range(310))
    joined = Samples.concatenate([b.samples for b in blocks])
    assert set(joined.channels) == set(CHANNELS) - {"time", "load_force"}, "all that the rig has"
    for name in joined.channels:
        assert np.array_equal(joined[name], log[name], equal_nan=True)


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
    assert 0.0 < one.lag <= one.lag_99 and one.cpu_us > 1.0 and one.rss > 50e6


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


@pytest.mark.slow
def test_errors_fall_as_work_rises():
    work, _ = work_precision(WORK, 0.06, 1)
    ours = [point for point in work if point.solver == "this plant"]
    assert [point.evaluations for point in ours] == sorted(point.evaluations for point in ours)
    assert ours[-1].pressure < ours[0].pressure
    peers = {"SciPy RK45", "SciPy LSODA", "SciPy Radau"}
    assert {point.solver for point in work} == {"this plant", *peers}
