"""The door of the diagnosis gives the command line's answer, from whatever holds the log."""

import copy
import json
import pickle
import sys
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from typer.testing import CliRunner

import fdd
from fdd import Diagnosis, InputError, Samples, diagnose, read_log
from fdd.cli.app import app
from tests.refusal import refused

matplotlib.use("Agg")
DEMO = Path(fdd.__file__).parent / "demo"
LOG, UNIT = DEMO / "demo.mcap", DEMO / "unit.yaml"


@pytest.fixture(scope="module")
def answer() -> Diagnosis:
    return diagnose(LOG, UNIT)


def test_a_file_gets_the_answer_of_the_command_line_and_it_comes_back_from_other_processes(answer):
    told = CliRunner().invoke(app, ["diagnose", str(LOG), "--unit", str(UNIT), "--json", "-"])
    assert json.loads(answer.model_dump_json(by_alias=True)) == json.loads(told.stdout)
    assert answer.verdict == "faulty" and set(answer.sha256) == {"log", "profile", "model"}
    assert pickle.loads(pickle.dumps(answer)) == answer == copy.deepcopy(answer)


def test_what_was_read_samples_and_those_that_lack_what_follows_get_the_same_findings(answer):
    log, unit = read_log(LOG), fdd.Unit.load(UNIT)
    for given, started in ((log, answer.started_at), (log.samples, None)):
        found = diagnose(given, unit, axis="left", keep_signals=False)
        assert found.faults == answer.faults and found.estimates == answer.estimates
        assert found.axis == "left" and set(found.sha256) == {"model"} and found.started_at == started
    # As read_log does it: speed makes an angle, both chambers make a difference.
    samples, unit = read_log(LOG).samples, fdd.Unit.load(UNIT)
    made = {n: v for n, v in samples.columns.items() if n not in ("pump_angle", "pressure_difference")}
    found = diagnose(Samples(samples.time, made), unit, keep_signals=False)
    assert [f.fault for f in found.faults] == ["internal_leakage"]
    assert found.faults[0].onset_s == pytest.approx(16.0, abs=0.5)


def test_what_cannot_be_diagnosed_is_refused_in_one_line(tmp_path):
    samples = read_log(LOG).samples
    assert "none.csv" in refused(partial(diagnose, tmp_path / "none.csv"))
    assert "axis_z" in refused(partial(diagnose, LOG, "axis_z"))
    assert "none.yaml" in refused(partial(diagnose, LOG, map="none.yaml"))
    assert "none.json" in refused(partial(diagnose, LOG, model=tmp_path / "none.json"))
    assert "int is no log" in refused(partial(diagnose, 3))
    assert "give it to read_log" in refused(partial(diagnose, samples, map="rig.map.yaml"))
    assert "too short" in refused(partial(diagnose, samples.rows(0, 500)))
    bare = Samples(samples.time, {"command": samples["command"]})
    assert "missing channels: position" in refused(partial(diagnose, bare))
    metres = samples.with_columns({"position": 1e3 * samples["position"]})
    assert "looks like mm" in refused(partial(diagnose, metres))


def test_the_picture_shows_what_was_found(answer):
    figure = answer.plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    for quantity, unit in (("position", "mm"), ("pressures", "bar"), ("leakage", "10⁻¹² m³/(s·Pa)"),
                           ("bulk modulus", "MPa"), ("test statistic", "–")):  # fmt: skip
        assert f"{quantity}\n({unit})" in labels
    assert figure.axes[-1].get_xlabel() == "time (s)" and "Internal leakage" in figure.get_suptitle()
    for axes in figure.axes:
        at = {line.get_label(): line.get_xdata()[0] for line in axes.lines if len(line.get_xdata()) == 2}
        assert at["onset: internal leakage"] == answer.faults[0].onset_s
        assert at["alarm: internal leakage"] == answer.faults[0].detected_s
    position = next(x for x in figure.axes[0].lines if x.get_label() == "measured").get_ydata()
    assert np.nanmax(position) == pytest.approx(1e3 * np.nanmax(read_log(LOG).samples["position"]))
    leakage = figure.axes[labels.index("leakage\n(10⁻¹² m³/(s·Pa))")]
    last = next(x for x in leakage.lines if x.get_label() == "EKF").get_ydata()[-1]
    assert last == pytest.approx(1e12 * answer.estimates["leakage"].value, rel=1e-3)
    band = next(b for b in leakage.collections if b.get_label() == "EKF, 95 %").get_paths()[-1].vertices
    std = answer.estimates["leakage"].std
    ends = band[band[:, 0] == band[:, 0].max(), 1]
    assert std is not None and np.ptp(ends) == pytest.approx(4e12 * std, rel=0.1)
    matplotlib.pyplot.close(figure)


def test_what_is_not_kept_is_not_drawn_nor_anything_without_matplotlib(answer, monkeypatch):
    from_json = Diagnosis.model_validate_json(answer.model_dump_json(by_alias=True))
    for other in (from_json, diagnose(LOG, UNIT, keep_signals=False)):
        assert other == answer
        with pytest.raises(InputError, match=r"demo\.mcap.*fdd\.diagnose"):
            other.plot()
    other.verdict = "healthy"
    assert other != answer
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"install fdd\[reports\]"):
        answer.plot()
