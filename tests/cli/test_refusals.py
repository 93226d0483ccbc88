"""Unusable input: status 2 and one line that names file and problem; the published schemas refuse it too."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import yaml

import fdd.logs

MAIN = [sys.executable, "-c", "from fdd.cli import main; main()"]
TAIL = {"height": 3, "scale": 1, "hours": 1}


@pytest.mark.parametrize(
    ("kind", "words"), [("missing", ["no such file"]), ("no position", ["missing channels: position"])]
)
def test_a_bad_log_is_refused(run, one_line, logs, tiny_model_file, tmp_path, kind, words):
    path, out = tmp_path / "bad.csv", tmp_path / "out"
    if kind == "no position":
        pd.read_csv(logs["csv"]).drop(columns="position").to_csv(path, index=False)
    out.mkdir()
    outputs = ["--json", out / "a.json", "--report", out / "r.html", "--mcap", out / "a.mcap"]
    result = run("diagnose", path, "--model", tiny_model_file, *outputs)
    one_line(result, str(path), *words)
    assert result.stdout == "" and list(out.iterdir()) == []
    one_line(run("monitor", path, "--model", tiny_model_file, "--speed", "max"), str(path), *words)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"schema": "fdd.model/99"}, ["schema", "fdd.model/5"]),
        ({"tail": {**TAIL, "rate_per_hour": -1}}, ["tail.rate_per_hour", "greater than 0"]),
        ({"classifier": "x"}, ["classifier"]),
        (None, ["no such model file"]),
    ],
)
def test_a_bad_model_is_refused(run, one_line, logs, tiny_model_file, tmp_path, changes, words):
    path = tmp_path / "model.json"
    if changes is not None:
        path.write_text(json.dumps({**json.loads(tiny_model_file.read_text()), **changes}))
    for command in ("diagnose", "monitor"):
        one_line(run(command, logs["healthy"], "--model", path), str(path), *words)


@pytest.mark.parametrize("option", ["--json", "--report", "--mcap"])
def test_an_output_that_cannot_be_written(run, one_line, logs, tiny_model_file, tmp_path, option):
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "nowhere" / "x", tmp_path / "file" / "x"):
        result = run("diagnose", logs["healthy"], "--model", tiny_model_file, option, target)
        one_line(result, str(target), "cannot be written")
        assert result.stdout == ""
    one_line(run("diagnose", logs["healthy"], option, logs["healthy"]), "would be written over")
    if option != "--json":
        several = run("diagnose", logs["healthy"], logs["leaking"], option, tmp_path / "one")
        one_line(several, "of one log, not of 2")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file"]


@pytest.mark.parametrize(
    ("option", "text", "words"),
    [
        ("--map", "time: {column: time}\nposition: {column: nowhere}\n", ["nowhere"]),
        ("--map", "chanels: {position: {column: position}}\n", ["file.yaml", "did you mean 'channels'?"]),
        ("--unit", "schema: fdd.unit/1\nname: x\n", ["file.yaml"]),
    ],
)
def test_a_bad_map_or_unit(run, one_line, logs, tiny_model_file, tmp_path, option, text, words):
    path = tmp_path / "file.yaml"
    path.write_text(text)
    one_line(run("diagnose", logs["csv"], option, path, "--model", tiny_model_file), *words)


@pytest.mark.parametrize(
    "arguments",
    [["diagnos"], ["diagnose"], ["diagnose", "a.csv", "--colour"], ["simulate", "--seed", "x"], []],
)
def test_wrong_usage_has_status_2(run, arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    if arguments:
        assert len(result.stderr.splitlines()) == 1 and "--help" in result.stderr


@pytest.mark.parametrize(
    ("raised", "status", "told"),
    [
        (ZeroDivisionError("oops\nover two lines"), 70, "ZeroDivisionError: oops over two lines"),
        (KeyboardInterrupt(), 130, ""),
        (MemoryError(), 70, "memory"),
    ],
)
def test_what_ends_a_command(run, monkeypatch, logs, tiny_model_file, raised, status, told):
    def broken(*_: object) -> None:
        raise raised

    monkeypatch.setattr(fdd.logs, "read_log", broken)
    result = run("diagnose", logs["healthy"], "--model", tiny_model_file)
    assert result.exit_code == status and told in result.stderr
    assert "Traceback" not in result.stderr and len(result.stderr.splitlines()) <= 1
    if isinstance(raised, ZeroDivisionError):
        assert result.stderr == f"fdd: internal error: {told}\n"
        monkeypatch.setenv("FDD_DEBUG", "1")
        assert "Traceback" in run("diagnose", logs["healthy"], "--model", tiny_model_file).stderr


def test_a_reader_that_goes_away_is_no_error_and_a_full_disk_is_told(logs, tiny_model_file):
    read, write = os.pipe()
    os.close(read)
    command = [*MAIN, "diagnose", str(logs["healthy"]), "--model", str(tiny_model_file)]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE)
    os.close(write)
    assert done.returncode == 141 and done.stderr == b""
    if Path("/dev/full").exists():
        with Path("/dev/full").open("wb") as full:
            done = subprocess.run([*MAIN, "--version"], stdout=full, stderr=subprocess.PIPE)
        assert done.returncode == 70 and len(done.stderr.splitlines()) == 1 and b"space" in done.stderr


def test_names_and_notes_from_a_log_are_no_markup(ran, logs, tiny_model_file, tmp_path):
    path = tmp_path / "[red]x[bold].csv"
    shutil.copy(logs["csv"], path)
    result = ran("diagnose", path, "--model", tiny_model_file)
    assert "[red]x[bold].csv" in result.stdout


ROOT = Path(__file__).parent.parent.parent
FILES = [
    ("map", "examples/*.map.yaml"), ("profile", "fdd/units/*.yaml"), ("profile", "fdd/demo/unit.yaml"),
    ("profile", "examples/*.base.yaml"), ("recipe", "datasets/*.yaml"), ("serve", "examples/serve.yaml"),
]  # fmt: skip


class Yaml12(yaml.SafeLoader):
    """As editors read it: PyYAML's 1.1 takes 2.1e8 for text."""


Yaml12.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$"), list("-+0123456789")
)


def plain(text: str) -> Any:
    return json.loads(json.dumps(yaml.load(text, Yaml12)))


@pytest.mark.parametrize(("kind", "pattern"), FILES)
def test_files_of_the_project_are_valid(validator, kind, pattern):
    paths = sorted(ROOT.glob(pattern))
    assert paths
    for path in paths:
        assert [e.message for e in validator(kind).iter_errors(plain(path.read_text("utf-8")))] == [], path


@pytest.mark.parametrize(
    ("kind", "file", "old", "new"),
    [
        ("profile", "fdd/units/axis_a.yaml", "moving_mass: {value: 3.688", "moving_mass: {value: heavy"),
        ("profile", "fdd/units/axis_a.yaml", "moving_mass:", "mass:"),
        ("profile", "fdd/units/axis_a.yaml", "3.688, unit: kg", "3.688, size: kg"),
        ("profile", "fdd/units/axis_a.yaml", "fdd.unit/1", "fdd.unit/9"),
        ("map", "examples/rig1.map.yaml", "position: {column: cyl_mm", "postion: {column: cyl_mm"),
        ("map", "examples/rig1.map.yaml", "{column: cyl_mm, unit: mm}", "{column: cyl_mm, sign: 2}"),
        ("recipe", "datasets/smoke.yaml", "units: 2", "units: 0"),
        ("recipe", "datasets/smoke.yaml", "seed: 5", "sed: 5"),
    ],
)  # fmt: skip
def test_wrong_files_are_refused(validator, kind, file, old, new):
    text = (ROOT / file).read_text("utf-8")
    assert old in text
    assert not validator(kind).is_valid(plain(text.replace(old, new)))


def test_a_map_may_have_its_channels_at_the_top(validator, run, one_line):
    short = {"position": {"topic": "/daq", "field": "cyl.pos", "unit": "mm"}}
    assert validator("map").is_valid(short)
    assert not validator("map").is_valid({"posision": short["position"]})
    one_line(run("schema", "answer"), "diagnosis", "recipe")
