"""``fdd monitor``: the same answer as ``fdd diagnose``, as it comes."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from fdd.cli.monitor import status_line
from fdd.diagnosis.findings import Estimate
from fdd.logs import read_log
from fdd.monitor import Status


@pytest.fixture(scope="module")
def offline(run, logs, tiny_model_file) -> dict:
    return json.loads(run("diagnose", logs["leaking"], "--model", tiny_model_file, "--json", "-").stdout)


def events(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def stream_of(path: Path) -> bytes:
    samples = read_log(path).samples
    rows = pd.DataFrame({"time": samples.time, **samples.columns}).to_dict("records")
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def test_a_replay_gives_the_diagnosis(run, logs, tiny_model_file, offline) -> None:
    result = run("monitor", logs["leaking"], "--model", tiny_model_file, "--speed", "max", "--json")
    assert result.exit_code == 0, result.stderr
    found = events(result.stdout)
    assert [e["event"] for e in found] == ["finding", "summary"]
    answer = found[-1]["diagnosis"]
    assert answer["faults"] == offline["faults"] and answer["estimates"] == offline["estimates"]
    assert found[0]["time_s"] == offline["faults"][0]["detected_s"]


def test_json_lines_on_standard_input_give_the_diagnosis(run, logs, tiny_model_file, offline) -> None:
    stream = stream_of(logs["leaking"])
    half = stream.index(b"\n", len(stream) // 2) + 1
    dirty = stream[:half] + b'{"time": oops\n' + stream[half:]
    result = run("monitor", "-", "--unit", "axis_a", "--model", tiny_model_file, "--json", input=dirty)
    assert result.exit_code == 0, result.stderr
    found = events(result.stdout)
    assert sorted(e["event"] for e in found) == ["finding", "note", "summary"]
    assert found[-1]["diagnosis"]["faults"] == offline["faults"]
    assert "malformed lines left out: 1" in found[-1]["diagnosis"]["quality"]["notes"]


def test_people_get_a_line_per_finding_and_a_summary(run, logs, tiny_model_file, offline) -> None:
    result = run("monitor", logs["leaking"], "--model", tiny_model_file, "--speed", "max")
    first = result.stdout.splitlines()[0]
    detected = offline["faults"][0]["detected_s"]
    told = rf"\[{detected:8.2f} s\] Internal leakage \(\d+ %\) or pump gear wear \(\d+ %\), since "
    assert re.match(told, first)
    assert "Leakage coefficient" in result.stdout


def test_what_cannot_be_monitored_is_refused(run, one_line, logs, tiny_model_file) -> None:
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
def test_a_signal_ends_it_with_the_summary(logs, tiny_model_file, number) -> None:
    command = [sys.executable, "-c", "from fdd.cli import main; main()", "monitor", "-", "--unit", "axis_a"]
    process = subprocess.Popen(
        [*command, "--model", str(tiny_model_file), "--json"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    assert process.stdin is not None and process.stdout is not None
    # The leak is found, so all of this was taken in; then the stream falls silent.
    process.stdin.write(stream_of(logs["leaking"]))
    process.stdin.flush()
    assert json.loads(process.stdout.readline())["event"] == "finding"
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0 and err == b""
    assert json.loads(out.splitlines()[-1])["diagnosis"]["verdict"] == "faulty"


def test_the_status_line_shows_the_likely_and_what_is_observable() -> None:
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
