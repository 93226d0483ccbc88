"""The door of the diagnosis gives the command line's answer, from whatever holds the log."""

import copy
import json
import pickle
from functools import partial
from pathlib import Path

import pytest
from typer.testing import CliRunner

import fdd
from fdd import Diagnosis, Samples, diagnose, read_log
from fdd.cli.app import app
from tests.refusal import refused

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
        found = diagnose(given, unit, axis="left")
        assert found.faults == answer.faults and found.estimates == answer.estimates
        assert found.axis == "left" and set(found.sha256) == {"model"} and found.started_at == started
    # As read_log does it: speed makes an angle, both chambers make a difference.
    samples, unit = read_log(LOG).samples, fdd.Unit.load(UNIT)
    made = {n: v for n, v in samples.columns.items() if n not in ("pump_angle", "pressure_difference")}
    found = diagnose(Samples(samples.time, made), unit)
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
