"""``fdd compare`` and ``fdd trend`` on simulated logs, end to end."""

import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from jsonschema import Draft202012Validator
from rich.console import Console

from fdd.cli.console import diagnosis_view, print_sheet
from fdd.diagnosis.findings import Estimate
from fdd.logs.mcap_writing import write_run
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.report.page import Sheet, Table
from fdd.unit import Unit
from tests.made_up import answer

UNIT = Unit.load("axis_a")
GROWTH = 0.04 * 12e-12 / UNIT.pump.total_leakage
"""Of the healthy leakage, from log to log."""
EVERY_DAYS = 30
DUTIES = ({"name": "steps"}, {"name": "sines"}, {"name": "steps", "amplitude": 0.03, "hold": 1.0})
LOADS = ({"name": "spring"}, {"name": "constant"}, {"name": "constant", "level": -1000.0})


@pytest.fixture(scope="module")
def life(tmp_path_factory) -> Path:
    """Twelve logs, a month apart, of other duty and temperature; the laminar leakage grows straight. Their
    names are in another order than their dates."""
    folder, rng = tmp_path_factory.mktemp("life"), np.random.default_rng(5)
    for k in range(12):
        leak = {"fault": "internal_leakage", "severity": 0.04 * k, "onset": 0.0}
        scenario = Scenario(
            duration=14, duty=DUTIES[k % 3], load=LOADS[k // 4], oil_temperature=float(rng.uniform(20, 60)),
            seed=100 + k, faults=[leak] if k else [], fault_scales={"internal_leakage_orifice_share": 0.0},
        )  # fmt: skip
        start = 1_767_225_600_000_000_000 + k * EVERY_DAYS * 86_400_000_000_000
        path, samples = folder / f"run{7 * k % 12:02d}.mcap", simulate(UNIT, scenario).samples
        about = {"unit_yaml": UNIT.to_yaml(), "scenario_json": "{}", "labels": {}, "start_ns": start}
        write_run(path, samples, axis="axis_a", **about)
    return folder


@pytest.fixture(scope="module")
def answers(ran, life, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("answers") / "out"
    ran("diagnose", life, "-o", out, "--workers", 1)
    return out / "answers.jsonl"


@pytest.fixture(scope="module")
def told(ran, answers, tmp_path_factory) -> tuple[Any, Path]:
    out = tmp_path_factory.mktemp("told")
    return ran("trend", answers, "--json", out / "trend.json", "--report", out / "trend.html"), out


def valid(of: Draft202012Validator, answer: dict[str, Any]) -> None:
    assert [e.message for e in of.iter_errors(answer)] == []
    for key in answer:
        assert not of.is_valid({k: v for k, v in answer.items() if k != key}), key


def test_a_leakage_that_grows_over_twelve_logs(told, validator):
    result, out = told
    answer = json.loads((out / "trend.json").read_text("utf-8"))
    valid(validator("trend"), answer)
    assert result.stdout.splitlines()[0] == answer["headline"]
    leakage, *others = answer["trends"]
    low, high = leakage["slope_interval"]
    assert leakage["quantity"] == "leakage" and leakage["direction"] == "rises"
    assert low < GROWTH / EVERY_DAYS < high and high - low < 0.25 * GROWTH / EVERY_DAYS
    assert leakage["first"] == pytest.approx(1.0, abs=0.03)
    assert leakage["last"] == pytest.approx(1.0 + 11 * GROWTH, abs=0.05)
    assert leakage["limit"] == pytest.approx(1.0 + 12e-12 / UNIT.pump.total_leakage)
    least, most = leakage["until_limit_interval"]
    assert least < (1.0 / 0.04 - 11) * EVERY_DAYS < most
    assert [t["direction"] for t in others] == [None] * len(others)
    points = pd.json_normalize(answer["trends"], "points", "quantity")
    rows = points[points["quantity"] == "leakage"]
    assert rows["log"].tolist() == [f"run{7 * k % 12:02d}.mcap" for k in range(12)]
    assert rows["at"].tolist() == pytest.approx([EVERY_DAYS * k for k in range(12)])
    assert rows["value"].iloc[-1] == pytest.approx(1.0 + 11 * GROWTH, abs=0.1)
    page = (out / "trend.html").read_text("utf-8")
    assert page.count('class="plot"') >= 2 and "run07.mcap" in page and "complete in itself" in page


def test_of_answers_nothing_is_diagnosed_and_a_limit_may_be_given(ran, told, answers, monkeypatch):
    monkeypatch.setattr("fdd.offline.Diagnoser.answer", None)
    result = ran("trend", answers, "--limit", "leakage=2.0", "--json", "-")
    near = json.loads(result.stdout)["trends"][0]
    far = json.loads((told[1] / "trend.json").read_text("utf-8"))["trends"][0]
    assert near["limit"] == 2.0
    least, most = near["until_limit_interval"]
    assert least < (1.0 / GROWTH - 11) * EVERY_DAYS < most < far["until_limit_interval"][0]


def test_logs_say_the_same_as_their_answers_and_one_that_cannot_be_read_is_told(run, life, answers, tmp_path):
    names = {f"run{k:02d}.mcap" for k in (0, 7, 2, 9)}
    for name in names:
        shutil.copy(life / name, tmp_path)
    (tmp_path / "bad.csv").write_text("nothing,of,use\n1,2,3\n")
    result = run("trend", tmp_path, "--json", "-", "--workers", 1)
    assert result.exit_code == 2
    assert len(result.stderr.splitlines()) == 1 and "bad.csv" in result.stderr
    answer = json.loads(result.stdout)
    assert answer["logs"][-1]["log"] == "bad.csv" and "bad.csv" in answer["logs"][-1]["left_out"]
    few = [line for line in answers.read_text("utf-8").splitlines() if json.loads(line)["log"] in names]
    (tmp_path / "few.jsonl").write_text("\n".join(few), "utf-8")
    same = json.loads(run("trend", tmp_path / "few.jsonl", "--json", "-").stdout)
    assert {p["log"] for p in same["trends"][0]["points"]} == names
    assert answer["trends"] == same["trends"] and answer["logs"][:-1] == same["logs"]


def test_two_logs_compared(ran, validator, life, tmp_path):
    a, b, report = life / "run00.mcap", life / "run05.mcap", tmp_path / "compare.html"
    out = tmp_path / "compare.json"
    result = ran("compare", a, b, "--json", out, "--report", report)
    answer = json.loads(out.read_text("utf-8"))
    valid(validator("comparison"), answer)
    assert result.stdout.splitlines()[0] == answer["headline"]
    assert answer["headline"].startswith("leakage coefficient rose by")
    for word in ("chambers' oil", "pump speed", "axis_a was not identified"):
        assert word in result.stdout
    assert "run05.mcap (B)" in report.read_text("utf-8")
    same = ran("compare", a, a)
    assert same.stdout.splitlines()[0] == "no estimate changed beyond its uncertainty"


def test_wrong_input_is_one_line(run, one_line, life, tmp_path):
    log, answers = life / "run00.mcap", tmp_path / "answers.jsonl"
    answers.write_text("{}\n")
    one_line(run("compare", log, tmp_path / "none.mcap"), "none.mcap")
    one_line(run("compare", log, log, "--report", tmp_path), "a file is wanted")
    one_line(run("trend", answers), "answers.jsonl", "line 1")
    one_line(run("trend", answers, log), "answers and logs")
    one_line(run("trend", tmp_path / "none.jsonl"), "none.jsonl", "cannot be read")
    one_line(run("trend", log, "--limit", "leakage=one"), "--limit", "leakage=2.0")
    one_line(run("trend", answers, "--map", tmp_path / "map.yaml"), "--map")
    answers.write_text("")
    one_line(run("trend", answers), "no log")


@pytest.mark.parametrize("width", [40, 80, 140])
def test_no_number_is_cut_and_no_name_broken_however_narrow_the_terminal(width):
    rows = [
        ("relief_valve_stuck_open.mcap", "faulty: relief valve stuck open", "14.7 ± 3.0", "0.259 ± 0.087"),
        ("h1.mcap", "healthy", "0.991 ± 0.038", "0.4399 ± 0.0066"),
    ]
    table = Table("Logs", ("Log", "Verdict", "Leakage coefficient", "Bulk modulus"), rows, numbers=False)
    screen = io.StringIO()
    print_sheet(Sheet("", "", "healthy", [], [table], []), Console(width=width, file=screen))
    for cell in (c for row in rows for k, c in enumerate(row) if k != 1):
        assert cell in screen.getvalue(), cell


def test_estimates_are_whole_at_80_columns():
    leakage = Estimate(unit="m^3/(s*Pa)", baseline=7.989e-13, value=8.93e-13, std=3.1e-14, observable=True)
    modulus = Estimate(unit="Pa", baseline=9.29e8, value=3.21e8, std=6.99e11, observable=False)
    screen = io.StringIO()
    found = answer("healthy", estimates={"leakage": leakage, "bulk_modulus": modulus})
    Console(width=80, file=screen).print(diagnosis_view(found))
    shown = screen.getvalue()
    assert "…" not in shown and "1e-12 m³/(s·Pa)" in shown and "Effective bulk modulus" in shown
