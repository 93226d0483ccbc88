"""``fdd diagnose`` and ``fdd monitor`` on good input: what they print, write and exit with."""

import json
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pandas as pd
import pytest

from fdd.cli.monitor import status_line
from fdd.diagnosis.findings import Diagnosis, Estimate
from fdd.logs import read_log
from fdd.logs.formats import open_log
from fdd.monitor import Status

KEYS = [
    "schema", "log", "axis", "unit", "duration_s", "samples", "verdict", "faults", "probabilities",
    "estimates", "quality", "sensors", "not_visible", "prior", "versions", "sha256",
]  # fmt: skip


@pytest.fixture(scope="module")
def answers(ran, logs, tiny_model_file) -> dict[str, dict]:
    out = {}
    for name in ("healthy", "leaking"):
        result = ran("diagnose", logs[name], "--model", tiny_model_file, "--unit", "axis_a", "--json", "-")
        assert result.stderr == ""
        out[name] = json.loads(result.stdout)
    return out


def test_simulated_mcap_carries_truth_unit_and_scenario(logs):
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


def test_the_answer_is_the_contracts(answers):
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


def test_people_report_and_mcap_are_told_verdict_evidence_and_estimates(ran, logs, tiny_model_file, tmp_path):
    report, annotated = tmp_path / "r.html", tmp_path / "a.mcap"
    outputs = ("--report", report, "--mcap", annotated)
    result = ran("diagnose", logs["leaking"], "--model", tiny_model_file, *outputs)
    text = " ".join(re.sub(r"[│•]", " ", result.stdout).split())
    what = r"! Internal leakage \(\d+ %\) or one of 2 others"
    assert re.search(what + r", since [5-9]\.\d s, severity 0\.\d\d, \S+ ?\d+ % sure", text)
    assert "The balance of the chambers' oil does not close from" in text
    assert re.search(r"Severity between 0\.\d\d and \d\.\d\d \(80 %\)", text)
    assert "To confirm it: Block the rod" in text
    assert re.search(r"Would have been invisible here: .+ below severity", text)
    assert re.search(r"Leakage coefficient 6\.5\d+ 1\d\.\d+ ± 0\.\d+ \+1\d\d % 1e-12 m³/\(s·Pa\)", text)
    assert "rows are missing" in text
    page = report.read_text(encoding="utf-8")
    assert "Internal leakage" in page and "Would have been invisible" in page
    log = read_log(annotated)
    assert len(log.samples) == len(read_log(logs["leaking"]).samples)
    answer = json.loads(log.metadata["diagnosis"]["json"])
    assert list(answer) == KEYS and answer["verdict"] == "faulty"
    assert {"/eha/axis_a/estimate", "/eha/axis_a/diagnosis"} <= set(open_log(annotated).topics)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.mcap", "r.html"]


def test_the_logs_profile_is_used_unless_one_is_given(ran, logs, tiny_model_file, tmp_path):
    path = tmp_path / "b.mcap"
    ran("simulate", "-o", path, "--unit", "axis_b", "--duration", 6, "--no-truth")
    model = ["--model", tiny_model_file, "--json", "-"]
    assert json.loads(ran("diagnose", path, *model).stdout)["unit"] == "axis_b"
    assert json.loads(ran("diagnose", path, "--unit", "axis_a", *model).stdout)["unit"] == "axis_a"
    assert open_log(path).topics == ["/eha/axis_b/measurement"]
    answer = json.loads(ran("diagnose", logs["csv"], *model).stdout)
    assert answer["unit"] == "axis_a", "a table has none"
    assert any("no unit profile given: taken for axis_a" in n for n in answer["quality"]["notes"])


def test_the_prior_moves_what_is_answered(run, ran, logs, tmp_path):
    odds = {}
    for prior in (0.5, 0.1):
        path = tmp_path / f"{prior}.json"
        ran("diagnose", logs["healthy"], "--prior", prior, "--json", path)
        found = json.loads(path.read_text())
        assert found["prior"] == prior
        odds[prior] = (1.0 - found["probabilities"]["healthy"]) / found["probabilities"]["healthy"]
    # Up to what a log could have shown, which goes by the score that is asked of it.
    assert odds[0.5] / 15.0 < odds[0.1] < odds[0.5] / 5.0
    assert run("diagnose", logs["healthy"], "--prior", 1.5).exit_code == 2


def test_a_log_cut_short_is_diagnosed_as_far_as_it_goes(ran, logs, tiny_model_file, tmp_path):
    content = logs["leaking"].read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(content[: int(len(content) * 0.6)])
    result = ran("diagnose", path, "--model", tiny_model_file, "--json", "-")
    answer = json.loads(result.stdout)
    assert 10.0 < answer["duration_s"] < 19.9
    assert any("truncated" in n for n in answer["quality"]["notes"])


def events(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def stream_of(path: Path) -> bytes:
    samples = read_log(path).samples
    rows = pd.DataFrame({"time": samples.time, **samples.columns}).to_dict("records")
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def test_a_replay_gives_the_diagnosis_and_people_a_line_per_finding(ran, logs, tiny_model_file, answers):
    common = ("monitor", logs["leaking"], "--model", tiny_model_file, "--speed", "max")
    result, offline = ran(*common, "--json"), answers["leaking"]
    finding, summary = events(result.stdout)
    assert (finding["event"], summary["event"]) == ("finding", "summary")
    detected = offline["faults"][0]["detected_s"]
    assert [summary["diagnosis"][k] == offline[k] for k in ("faults", "estimates")] == [True, True]
    assert finding["time_s"] == detected
    shown = ran(*common).stdout
    told = rf"\[{detected:8.2f} s\] Internal leakage \(\d+ %\) or one of 2 others, since "
    assert re.match(told, shown) and "Leakage coefficient" in shown


def test_json_lines_on_standard_input_give_the_diagnosis(ran, logs, tiny_model_file, answers):
    stream = stream_of(logs["leaking"])
    half = stream.index(b"\n", len(stream) // 2) + 1
    dirty = stream[:half] + b'{"time": oops\n' + stream[half:]
    result = ran("monitor", "-", "--unit", "axis_a", "--model", tiny_model_file, "--json", input=dirty)
    found = events(result.stdout)
    assert sorted(e["event"] for e in found) == ["finding", "note", "summary"]
    assert found[-1]["diagnosis"]["faults"] == answers["leaking"]["faults"]
    assert "malformed lines left out: 1" in found[-1]["diagnosis"]["quality"]["notes"]


def test_what_cannot_be_monitored_is_refused(run, one_line, logs, tiny_model_file):
    for speed in ("0", "-1", "fast", "nan", "inf"):
        one_line(run("monitor", logs["leaking"], "--speed", speed), "--speed", "max")
    common = ("monitor", "-", "--unit", "axis_a", "--model", tiny_model_file)
    for came in (b"", b"nonsense\n"):
        one_line(run(*common, input=came), "standard input", "no samples came")
    lines = b"".join(b'{"time": %f, "position": 0.0}\n' % (0.001 * k) for k in range(1000))
    result, told = run(*common, "--json", input=lines), "standard input: no usable data for pump_angle"
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1].startswith(f"fdd: error: {told}")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_the_summary(logs, tiny_model_file, number):
    command = [sys.executable, "-c", "from fdd.cli import main; main()", "monitor", "-", "--unit", "axis_a"]
    process = subprocess.Popen(
        [*command, "--model", str(tiny_model_file), "--json"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    bound = threading.Timer(60.0, process.kill)  # else a finding that never comes is waited for without end
    bound.start()
    # The leak is found, so all of this was taken in; then the stream falls silent.
    process.stdin.write(stream_of(logs["leaking"]))
    process.stdin.flush()
    assert json.loads(process.stdout.readline())["event"] == "finding"
    bound.cancel()
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0 and err == b""
    assert json.loads(out.splitlines()[-1])["diagnosis"]["verdict"] == "faulty"


def test_the_status_line_shows_the_likely_and_what_is_observable():
    leakage = Estimate(unit="m^3/(s*Pa)", baseline=6.5e-12, value=9.8123e-12, std=1.04e-13, observable=True)
    blind = Estimate(unit="N", baseline=130.0, value=90.0, std=80.0, observable=False)
    status = Status(
        61.25, "faulty", {"healthy": 0.02, "leakage": 0.9, "aeration": 0.08},
        {"leakage": leakage, "coulomb_friction": blind},
    )  # fmt: skip
    expected = "[   61.25 s] faulty  leakage 90 %  air in the oil 8 %  leakage 9.81 ± 0.10 1e-12 m³/(s·Pa)"
    assert status_line(status).plain == expected
    sure = Status(1.0, "healthy", {"healthy": 0.98, "leakage": 0.02})
    assert status_line(sure).plain == "[    1.00 s] healthy  healthy 98 %"
