"""Many logs at once: which are meant, what is written, what one bad log does, and going on after a break."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

import fdd.logs
from fdd.cli.batch import file_names, find_logs, names_of
from fdd.cli.diagnose import status_of
from fdd.diagnosis.findings import Diagnosis
from fdd.errors import InputError
from fdd.logs import read_log
from fdd.logs.formats import suffixes
from fdd.offline import utc
from fdd.unit import Unit
from tests.logs.made_up_logs import mcap_of

MAIN = [sys.executable, "-c", "from fdd.cli import main; main()"]


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def folder(logs, tmp_path_factory) -> Path:
    """Two logs of one name in two folders, one that cannot be read, and what is no log."""
    base = tmp_path_factory.mktemp("many") / "runs"
    for day, name in (("day1", "healthy"), ("day2", "csv")):
        (base / day).mkdir(parents=True)
        shutil.copy(logs[name], base / day / f"run{logs[name].suffix}")
    shutil.copy(logs["parquet"], base / "day1" / "run.csv")
    (base / "bad.csv").write_text("nothing,of,use\n1,2,3\n")
    (base / "notes.md").write_text("not a log")
    (base / ".hidden.csv").write_text("hidden")
    return base


@pytest.fixture(scope="module")
def one_folder(folder, run, tiny_model_file) -> Path:
    out = folder.parent / "out"
    result = run("diagnose", folder, "-o", out, "--model", tiny_model_file, "--workers", 1)
    assert result.exit_code == 2 and "3 of 4 logs diagnosed, 1 could not be read" in result.stdout
    assert all(x.startswith("fdd: error: ") and "bad.csv" in x for x in result.stderr.splitlines())
    return out


def answers_of(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "answers.jsonl").read_text("utf-8").splitlines()]


def test_folders_and_names_that_collide(tmp_path):
    for name in (
        "b/2.csv", "b/1.MCAP", "a.csv.gz", "z.txt", "b/.x/3.csv", ".4.csv", "notes.md", "out/summary.csv",
    ):  # fmt: skip
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()

    def found(*given: Path) -> list[str]:
        paths = find_logs(list(given), leave_out=tmp_path / "out")
        return [p.relative_to(tmp_path).as_posix() for p in paths]

    assert found(tmp_path) == ["a.csv.gz", "b/1.MCAP", "b/2.csv", "z.txt"]
    assert found(tmp_path / "b/2.csv", tmp_path / "b") == ["b/2.csv", "b/1.MCAP"], "each once"
    assert found(tmp_path / "missing.csv") == ["missing.csv"], "refused when it is read"
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no log below"):
        find_logs([tmp_path / "empty"])
    assert {".mcap", ".csv.gz", ".mf4"} <= set(suffixes())
    logs = [tmp_path / "a" / "x" / "r.csv", tmp_path / "b" / "x" / "r.csv", tmp_path / "b" / "s.csv"]
    assert names_of(logs) == ["a/x/r.csv", "b/x/r.csv", "s.csv"]
    names = file_names(["a/r.csv", "A-r.csv", 'q"?.csv'])
    assert len({n.lower() for n in names}) == 3 and not any(c in n for n in names for c in '/\\"?')


def test_a_folder_of_logs_makes_a_folder_of_answers(one_folder, folder, tiny_model):
    answers = answers_of(one_folder)
    assert [a["log"] for a in answers] == ["bad.csv", "day1/run.csv", "run.mcap", "day2/run.csv"]
    assert [a["verdict"] for a in answers] == ["inconclusive", "faulty", "healthy", "faulty"]
    assert answers[1]["faults"] == answers[3]["faults"], "one run as Parquet and as CSV"
    bad = answers[0]
    assert "bad.csv" in bad["error"] and "\n" not in bad["error"]
    assert set(bad) == {*answers[1], "error"} and set(bad["estimates"]) == set(answers[1]["estimates"])
    assert set(bad["probabilities"]) == set(answers[1]["probabilities"])
    files = [folder / "bad.csv", folder / "day1/run.csv", folder / "day1/run.mcap", folder / "day2/run.csv"]
    assert [a["sha256"] for a in answers] == [{"log": sha256(f), "model": tiny_model.sha256} for f in files]
    assert answers[1]["versions"] == {"fdd": "0.1.0", "model": "fdd.model/5"}
    pages = {p.name for p in (one_folder / "reports").iterdir()}
    assert pages == {"day1-run.csv.html", "run.mcap.html", "day2-run.csv.html", "plotly.min.js"}
    assert all(page.stat().st_size < 500_000 for page in (one_folder / "reports").glob("*.html"))
    table = pd.read_csv(one_folder / "summary.csv")
    assert set(table["log"]) == {a["log"] for a in answers}
    assert all((one_folder / link).is_file() for link in table["report"].dropna())
    index = (one_folder / "index.html").read_text("utf-8")
    assert all(f'href="reports/{name}"' in index for name in pages if name.endswith(".html"))


def test_answers_are_valid_by_the_published_schema(validator, one_folder):
    """Of a log that could not be read and of one that was."""
    valid = validator("diagnosis")
    wrong = ({"verdict": "fine"}, {"schema": "fdd.diagnosis/2"}, {"duration_s": "60"}, {"samples": None},
             {"faults": [{"fault": "aeration"}]}, {"quality": {"dropped_samples": 0.5}},
             {"sha256": {"log": 1}})  # fmt: skip
    for answer in answers_of(one_folder)[:2]:
        assert [e.message for e in valid.iter_errors(answer)] == []
        assert not any(valid.is_valid({**answer, **change}) for change in wrong)
        for key in set(answer) - {"error", "started_at"}:
            assert not valid.is_valid({k: v for k, v in answer.items() if k != key}), key


def test_map_profile_and_start_are_told(ran, logs, tiny_model_file, tmp_path):
    samples, start = read_log(logs["leaking"]).samples, 1_700_000_000_250_000_000
    names = ("position", "pump_angle", "pressure_difference")
    rows = zip(*(samples[n].tolist() for n in names), strict=True)
    texts = (json.dumps(dict(zip(names, row, strict=True))).replace("NaN", "null").encode() for row in rows)
    mcap_of(tmp_path / "abs.mcap", texts, "/rig", start_ns=start)
    (tmp_path / "map.yaml").write_text("".join(f"{n}: {{topic: /rig, field: {n}}}\n" for n in names))
    Unit.load("axis_a").save(tmp_path / "unit.yaml")
    out = tmp_path / "answer.json"
    ran("diagnose", tmp_path / "abs.mcap", "--map", tmp_path / "map.yaml", "--unit",
                 tmp_path / "unit.yaml", "--model", tiny_model_file, "--json", out)  # fmt: skip
    answer = json.loads(out.read_text())
    assert answer["started_at"] == utc(start)
    assert answer["started_at"].startswith("2023-11-14T22:13:20.25")
    for key, file in (("log", "abs.mcap"), ("map", "map.yaml"), ("profile", "unit.yaml")):
        assert answer["sha256"][key] == sha256(tmp_path / file)


@pytest.mark.slow
def test_workers_change_nothing(run, folder, one_folder, tiny_model_file, tmp_path):
    out = tmp_path / "two"
    shutil.copy(folder / "day1" / "run.mcap", tmp_path / "other.mcap")
    given = [folder / "day2", folder / "bad.csv", tmp_path / "other.mcap"]
    result = run("diagnose", *given, "-o", out, "--model", tiny_model_file, "--workers", 2, "--json",
                 tmp_path / "all.json")  # fmt: skip
    assert result.exit_code == 2
    leaking, bad, healthy = found = answers_of(out)
    assert json.loads((tmp_path / "all.json").read_text("utf-8")) == found
    wanted = {a["log"]: a for a in answers_of(one_folder)}
    assert leaking == {**wanted["day2/run.csv"], "log": "run.csv"}, "as they were given"
    assert bad == wanted["bad.csv"]
    assert healthy == {**wanted["run.mcap"], "log": "other.mcap"}


def test_a_single_bad_log_writes_nothing_and_another_folder_is_left_alone(run, one_line, folder, tmp_path):
    out = tmp_path / "none"
    one_line(run("diagnose", folder / "bad.csv", "-o", out, "--exit-code"), "bad.csv")
    assert not out.exists()
    one_line(run("diagnose", folder, "-o", folder / "day1"), "not empty")
    one_line(run("diagnose", folder, "--resume"), "--output")


@pytest.mark.slow
def test_resume_works_only_what_is_new(run, one_folder, folder, tiny_model_file, tmp_path, monkeypatch):
    folder = shutil.copytree(folder, tmp_path / "runs")
    one_folder = shutil.copytree(one_folder, tmp_path / "out")
    read, worked = fdd.logs.read_log, []

    def counted(path: Path, *rest: object) -> object:
        worked.append(Path(path).relative_to(folder).as_posix())
        return read(path, *rest)

    monkeypatch.setattr(fdd.logs, "read_log", counted)

    def again(*more: object) -> list[str]:
        worked.clear()
        result = run("diagnose", folder, "-o", one_folder, "--model", tiny_model_file, "--resume",
                     "--workers", 1, *more)  # fmt: skip
        assert result.exit_code == 2 and "bad.csv" in result.stderr, "told again"
        return list(worked)

    before = answers_of(one_folder)
    assert again() == []
    assert answers_of(one_folder) == before
    (one_folder / "reports" / "run.mcap.html").unlink()
    assert again() == ["day1/run.mcap"]
    shutil.copy(folder / "day1" / "run.mcap", folder / "day2" / "new.mcap")
    assert again() == ["day2/new.mcap"]
    with (folder / "day2" / "run.csv").open("a") as log:
        log.write("\n")
    assert again() == ["day2/run.csv"]
    assert len(again("--unit", "axis_b")) == 5, "another profile"
    assert again("--unit", "axis_b") == []
    changed = (one_folder / "answers.jsonl").read_text("utf-8").replace('"fdd":"0.1.0"', '"fdd":"0.0.9"', 1)
    (one_folder / "answers.jsonl").write_text(changed + '{"cut o', "utf-8")
    assert again("--unit", "axis_b") == ["bad.csv"], "another version"


def test_exit_codes(run, ran, logs, one_folder, tiny_model_file, tmp_path):
    """1 for a fault, else 2 for an unreadable log, else 3 for an inconclusive verdict."""
    pd.read_csv(logs["csv"]).iloc[:4000].to_csv(tmp_path / "short.csv", index=False)
    common = [logs["healthy"], tmp_path / "short.csv", "--model", tiny_model_file, "--workers", 1]
    out = tmp_path / "answers.json"
    ran("diagnose", *common, "--json", out)
    assert run("diagnose", *common, "--exit-code").exit_code == 3
    healthy, short = map(Diagnosis.model_validate, json.loads(out.read_text("utf-8")))
    bad, faulty, *_ = map(Diagnosis.model_validate, answers_of(one_folder))
    assert status_of([healthy]) == 0 and status_of([healthy, short, bad]) == 2
    assert status_of([healthy, short, bad, faulty]) == 1


def test_an_error_of_our_own_ends_one_log_only(run, logs, tiny_model_file, monkeypatch):
    read = fdd.logs.read_log

    def broken(path: Path, *rest: object) -> object:
        if "healthy" in str(path):
            raise ZeroDivisionError("for a test")
        return read(path, *rest)

    monkeypatch.setattr(fdd.logs, "read_log", broken)
    result = run("diagnose", logs["healthy"], logs["leaking"], "--model", tiny_model_file, "--workers", 1)
    assert result.exit_code == 2
    assert "internal error: ZeroDivisionError: for a test" in result.stderr
    assert "Internal leakage" in result.stdout and "Traceback" not in result.stderr


@pytest.mark.skipif(os.name == "nt", reason="sends a signal to a group of processes")
@pytest.mark.slow
def test_what_was_finished_survives_an_interrupt(logs, tiny_model_file, tmp_path):
    runs, out = tmp_path / "runs", tmp_path / "out"
    runs.mkdir()
    for k in range(60):
        shutil.copy(logs["healthy"], runs / f"{k:02d}.mcap")
    command = [*MAIN, "diagnose", runs, "-o", out, "--model", tiny_model_file, "--workers", "2"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, **pipes, text=True, start_new_session=True)
    until = time.monotonic() + 120.0
    while len(list((out / "reports").glob("*.html"))) < 3 and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in stderr
    answers = answers_of(out)
    assert 1 <= len(answers) < 60
    assert not list(out.glob("**/*.part"))
    assert f"{60 - len(answers)} more logs were not worked" in (out / "index.html").read_text("utf-8")
    assert len(pd.read_csv(out / "summary.csv")) == len(answers)
