"""The commands on good input: what they print, write and exit with."""

from __future__ import annotations

import json
import re
from functools import partial
from pathlib import Path

import pytest

from fdd.cli.diagnose import output_paths
from fdd.diagnosis.findings import Diagnosis
from fdd.logs import read_log
from fdd.logs.formats import open_log
from tests.refusal import refused

KEYS = [
    "schema", "log", "axis", "unit", "duration_s", "samples", "verdict", "faults", "probabilities",
    "estimates", "quality", "sensors", "not_visible", "prior", "versions", "sha256",
]  # fmt: skip


@pytest.fixture(scope="module")
def answers(run, logs, tiny_model_file) -> dict[str, dict]:
    """JSON answers of a healthy and a leaking log."""
    out = {}
    for name in ("healthy", "leaking"):
        result = run("diagnose", logs[name], "--model", tiny_model_file, "--unit", "axis_a", "--json", "-")
        assert result.exit_code == 0 and result.stderr == ""
        out[name] = json.loads(result.stdout)
    return out


def test_simulated_mcap_carries_truth_unit_and_scenario(logs) -> None:
    log = read_log(logs["leaking"])
    assert "schema: fdd.unit/1" in log.metadata["unit"]["yaml"]
    scenario = json.loads(log.metadata["scenario"]["json"])
    assert scenario["faults"][0]["fault"] == "internal_leakage" and scenario["seed"] == 4
    labels = json.loads(log.metadata["labels"]["json"])
    assert labels["faults"][0]["onset_s"] == 8.0
    name = "/eha/axis_a/truth.leakage"
    leakage = open_log(logs["leaking"]).read([name])[name]
    assert leakage.size == len(log.samples)
    assert leakage[-1] - leakage[0] == pytest.approx(0.8 * 12e-12, rel=0.01)


def test_the_answer_is_the_contracts(answers) -> None:
    answer = answers["leaking"]
    assert list(answer) == KEYS and answer["schema"] == "fdd.diagnosis/1"
    assert answer["log"] == "leaking.mcap" and answer["axis"] == "axis_a"
    fault = answer["faults"][0]
    assert fault["fault"] == "internal_leakage" and fault["ambiguity"][0] == "internal_leakage"
    assert abs(fault["onset_s"] - 8.0) < 1.0 and fault["detected_s"] > 8.0
    low, high = fault["severity_interval"]
    assert low < fault["severity"] < high and fault["severity"] == pytest.approx(0.8, abs=0.2)
    assert fault["onset_interval"][0] <= fault["onset_s"] <= fault["onset_interval"][1]
    assert fault["next_check"] and fault["channel"] is None
    assert {s["channel"]: s["state"] for s in answer["sensors"]}["pressure_1"] == "trusted"
    hidden = {i["fault"]: i["severity"] for i in answer["not_visible"]}
    assert hidden["internal_leakage"] < 0.8, "it was seen"
    estimate = answer["estimates"]["leakage"]
    assert list(estimate)[:5] == ["unit", "baseline", "value", "std", "observable"]
    assert list(estimate)[5:] == ["held", "held_std", "age_s", "information_std"]
    assert estimate["value"] - estimate["baseline"] == pytest.approx(0.8 * 12e-12, rel=0.15)
    assert answers["healthy"]["verdict"] == "healthy" and answers["healthy"]["faults"] == []
    Diagnosis.model_validate(answer)


def test_people_are_told_verdict_evidence_and_estimates(run, logs, tiny_model_file) -> None:
    shown = run("diagnose", logs["leaking"], "--model", tiny_model_file).stdout
    text = " ".join(re.sub(r"[│•]", " ", shown).split())
    # A pump worn at its sides leaks alike.
    what = r"! Internal leakage \(\d+ %\) or pump gear wear \(\d+ %\)"
    assert re.search(what + r", since [5-9]\.\d s, severity 0\.\d\d, \S+ ?\d+ % sure", text)
    assert "The balance of the chambers' oil does not close from" in text
    assert re.search(r"Severity between 0\.\d\d and \d\.\d\d \(80 %\)", text)
    assert "To confirm it: Block the rod" in text
    assert re.search(r"Would have been invisible here: .+ below severity", text)
    assert re.search(r"Leakage coefficient 6\.5\d+ 1\d\.\d+ ± 0\.\d+ \+1\d\d % 1e-12 m³/\(s·Pa\)", text)
    assert "rows are missing" in text


def test_report_and_annotated_mcap(run, logs, tiny_model_file, tmp_path: Path) -> None:
    report, annotated = tmp_path / "r.html", tmp_path / "a.mcap"
    outputs = ("--report", report, "--mcap", annotated)
    result = run("diagnose", logs["leaking"], "--model", tiny_model_file, *outputs)
    assert result.exit_code == 0, result.stderr
    page = report.read_text(encoding="utf-8")
    assert "Internal leakage" in page and "Would have been invisible" in page
    log = read_log(annotated)
    assert len(log.samples) == len(read_log(logs["leaking"]).samples)
    answer = json.loads(log.metadata["diagnosis"]["json"])
    assert list(answer) == KEYS and answer["verdict"] == "faulty"
    topics = open_log(annotated).topics
    assert "/eha/axis_a/estimate" in topics and "/eha/axis_a/diagnosis" in topics
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "r.html"]


def test_outputs_for_several_logs(tmp_path: Path) -> None:
    paths = partial(output_paths, suffix=".html", option="--report")
    logs = [Path("x/a.mcap"), Path("b.csv")]
    assert paths(str(tmp_path), logs) == [tmp_path / "a.html", tmp_path / "b.html"]
    assert paths("r-{log}.html", logs) == [Path("r-a.html"), Path("r-b.html")]
    assert paths("one.html", logs[:1]) == [Path("one.html")] and paths(None, logs) == [None, None]
    for pattern, many in (("one.html", logs), ("{log}.html", [Path("a.csv"), Path("a.mcap")])):
        refused(partial(paths, pattern, many))


def test_the_logs_profile_is_used_unless_one_is_given(run, logs, tiny_model_file, tmp_path: Path) -> None:
    path = tmp_path / "b.mcap"
    assert run("simulate", "-o", path, "--unit", "axis_b", "--duration", 6, "--no-truth").exit_code == 0
    model = ["--model", tiny_model_file, "--json", "-"]
    assert json.loads(run("diagnose", path, *model).stdout)["unit"] == "axis_b"
    assert json.loads(run("diagnose", path, "--unit", "axis_a", *model).stdout)["unit"] == "axis_a"
    assert open_log(path).topics == ["/eha/axis_b/measurement"]
    answer = json.loads(run("diagnose", logs["csv"], *model).stdout)
    assert answer["unit"] == "axis_a", "a table has none"
    assert any("no unit profile given: taken for axis_a" in n for n in answer["quality"]["notes"])


def test_the_prior_moves_what_is_answered(run, logs, tmp_path: Path) -> None:
    odds = {}
    for prior in (0.5, 0.1):
        path = tmp_path / f"{prior}.json"
        assert run("diagnose", logs["healthy"], "--prior", prior, "--json", path).exit_code == 0
        found = json.loads(path.read_text())
        assert found["prior"] == prior
        odds[prior] = (1.0 - found["probabilities"]["healthy"]) / found["probabilities"]["healthy"]
    # Up to what a log could have shown, which goes by the score that is asked of it.
    assert odds[0.5] / 15.0 < odds[0.1] < odds[0.5] / 5.0
    assert run("diagnose", logs["healthy"], "--prior", 1.5).exit_code == 2


def test_a_log_cut_short_is_diagnosed_as_far_as_it_goes(run, logs, tiny_model_file, tmp_path) -> None:
    content = logs["leaking"].read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[: int(len(content) * 0.6)])
    result = run("diagnose", path, "--model", tiny_model_file, "--json", "-")
    assert result.exit_code == 0
    answer = json.loads(result.stdout)
    assert 10.0 < answer["duration_s"] < 19.9
    assert any("truncated" in n for n in answer["quality"]["notes"])
