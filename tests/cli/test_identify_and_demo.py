"""Identification, experiments and the demo, end to end."""

import hashlib
import json
import math
import re
import shlex
import sys
from importlib import resources
from pathlib import Path

import pandas as pd
import pytest

from fdd.diagnosis.baseline import BASELINE_VERSION
from fdd.logs import read_log
from fdd.residuals.balances import BALANCES
from fdd.unit import Unit

STROKES = "constant_speed:amplitude=0.08,speeds=60/105,turn=5,dwell=0.3"


@pytest.fixture(scope="module")
def healthy_strokes(ran, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("identify") / "strokes.mcap"
    arguments = ["--profile", STROKES, "--load", "throttle:pressure=1.5e6", "--duration", 21, "--seed", 6]
    ran("simulate", "-o", path, *arguments)
    return path


@pytest.fixture(scope="module")
def made(ran, healthy_strokes, tmp_path_factory):
    out = tmp_path_factory.mktemp("made") / "unit.yaml"
    return ran("identify", healthy_strokes, "--json", out.with_suffix(".json"), "-o", out), out


def test_identify_says_whether_the_profile_is_usable_and_the_data_what_the_table_says(made, healthy_strokes):
    result, out = made
    unit, truth = Unit.load(out), Unit.load("axis_a")
    assert result.stdout.splitlines()[0].startswith("usable")
    assert unit.pump.total_leakage == pytest.approx(truth.pump.total_leakage, rel=0.3)
    assert unit.baseline is not None and 15.0 < unit.baseline.seconds <= 21.0
    assert unit.pump.std_of("cross_port_leakage") is not None
    for word in ("one log", "before", "± (95 %)", "cm³/turn", "identified"):
        assert word in result.stdout
    for word in ("NIS", "likelihood", "resolution"):
        assert word not in result.stdout
    digest = hashlib.sha256(healthy_strokes.read_bytes()).hexdigest()
    assert unit.origin is not None and unit.origin.logs == {digest: healthy_strokes.name}
    assert unit.origin.base == "axis_a" and not unit.origin.accepted
    hashed = hashlib.sha256(digest.encode()).hexdigest()[:8]
    assert re.fullmatch(rf"axis_a-\d{{4}}-\d\d-\d\d-{hashed}", unit.name)
    result, out = made
    data = json.loads(out.with_suffix(".json").read_text())
    assert data["schema"] == "fdd.identification/1" and data["verdict"] == "usable"
    assert result.stdout.splitlines()[0] == data["sentence"]
    row = next(r for r in data["table"] if r["quantity"] == "pump.displacement")
    assert row["after"] == pytest.approx(Unit.load(out).pump.displacement, rel=1e-6)
    shown = re.search(r"pump displacement +3\.5 +([\d.]+)", result.stdout)
    assert shown and float(shown[1]) == pytest.approx(row["after"] * 2e6 * math.pi, rel=1e-3)
    assert row["word"] == "identified"


def test_verbose_shows_the_sensors(ran, healthy_strokes, tmp_path):
    result = ran("identify", healthy_strokes, "--name", "rig 7", "--verbose", "-o", tmp_path / "unit.yaml")
    assert Unit.load(tmp_path / "unit.yaml").name == "rig 7"
    for word in ("sensors pressure 1", "resolution", "area_1 stays", "1e-12 m³/(s·Pa)"):
        assert word in result.stdout
    assert "…" not in result.stdout, "80 columns cut nothing"


@pytest.mark.slow
def test_a_leaking_log_is_taken_only_where_it_is_accepted(run, ran, one_line, healthy_strokes, tmp_path):
    log, out = tmp_path / "leak.mcap", tmp_path / "more.yaml"
    arguments = ["--profile", STROKES, "--load", "throttle:pressure=1.5e6", "--duration", 21, "--seed", 7]
    fault = ["--fault", "internal_leakage:severity=0.5,onset=0"]
    ran("simulate", "-o", log, *arguments, *fault)
    logs = (healthy_strokes, log)
    one_line(run("identify", *logs, "-o", out), "not usable, because", "disagree", "--accept")
    assert not out.exists()
    result = ran("identify", *logs, "--accept", "-o", out)
    assert result.stdout.startswith("not usable, because")
    origin = Unit.load(out).origin
    assert origin is not None and origin.accepted and len(origin.logs) == 2


def test_what_cannot_be_used_is_refused_in_one_line(run, one_line, healthy_strokes, tmp_path):
    out = tmp_path / "unit.yaml"
    one_line(run("identify", tmp_path / "none.mcap", "-o", out), "none.mcap", "no such file")
    one_line(run("identify", healthy_strokes, "--base", "axis_z", "-o", out), "axis_z")
    one_line(run("identify", healthy_strokes, "--name", "a/b", "-o", out), "a/b")
    one_line(run("identify", healthy_strokes, "-o", tmp_path / "no" / "unit.yaml"), "cannot be written")
    one_line(run("identify", healthy_strokes, healthy_strokes, "-o", out), "give each log once")
    assert list(tmp_path.iterdir()) == []
    log = read_log(healthy_strokes).samples
    columns = {c: log[c] for c in ("position", "pump_angle", "pressure_difference")}
    pd.DataFrame({"time": log.time, **columns}).to_csv(tmp_path / "bare.csv", index=False)
    command = ("experiment", "frequency-response", tmp_path / "bare.csv", "--input", "command")
    one_line(run(*command), "no command")
    one_line(run(*command[:3], "--window", 9), "windows of 9 s", "--window")


@pytest.mark.parametrize("kind", ["frequency-response", "friction", "leakage", "gain", "bulk-modulus"])
def test_each_kind_tells_and_says_what_it_does_not(ran, healthy_strokes, tmp_path, kind):
    page, data = tmp_path / "page.html", tmp_path / "data.json"
    result = ran("experiment", kind, healthy_strokes, "--html", page, "--json", data)
    found = json.loads(data.read_text())
    assert found["schema"] == "fdd.experiment/1" and found["experiment"] == kind
    assert found["logs"] == ["strokes.mcap"] and found["unit"] == "axis_a"
    for told in found["told"]:
        low, high = told["interval"]
        assert low <= told["value"] <= high and told["quantity"] in page.read_text()
    assert found["told"] or found["not_told"]
    assert 'class="panel verdict healthy"' not in page.read_text(), "an experiment says nothing of health"
    # 80 columns cut neither numbers nor names.
    cells = [cell for row in found["table"] for cell in row.values()]
    assert all(word in result.stdout for cell in cells for word in cell.split())
    assert ("Not told" in result.stdout) == bool(found["not_told"])


def test_the_shipped_demo_is_of_this_version_and_small():
    folder = resources.files("fdd") / "demo"
    unit = Unit.from_yaml((folder / "unit.yaml").read_text(encoding="utf-8"))
    assert unit.baseline is not None
    assert unit.baseline.version == BASELINE_VERSION and unit.baseline.seconds > 60.0
    for name, balance in unit.baseline.balances.items():
        assert tuple(balance.columns) == BALANCES[name].columns, name
    assert {"volume", "force", "refeed"} <= set(unit.baseline.balances)
    assert len((folder / "demo.mcap").read_bytes()) < 2_500_000


def test_the_demo_finds_the_leak_and_names_the_command_as_called(run, ran, one_line, tmp_path, monkeypatch):
    """After ``make demo`` fdd is in no path."""
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr(sys, "argv", [".venv/bin/fdd", "demo"])
    out = tmp_path / "report.html"
    result = ran("demo", "-o", out)
    onset = re.search(r"! Internal leakage, since (\d+\.\d) s", result.stdout)
    assert onset is not None and abs(float(onset[1]) - 16.0) < 1.0
    assert str(out) in result.stdout.replace("\n", "") and "Internal leakage" in out.read_text("utf-8")
    words = shlex.split(result.stdout.splitlines()[-1].partition(": ")[2])
    assert words[:2] == [".venv/bin/fdd", "diagnose"] and all(Path(words[k]).is_file() for k in (2, 4))
    one_line(run("demo", "-o", tmp_path / "no" / "r.html"), "cannot be written")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
