"""The package at work in fdd's own commands: install it first (pip install .)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from fdd import load_dataset
from fdd.cli.app import app
from fdd.diagnosis.model import Model
from fdd.logs import read_log
from fdd.logs.formats import open_log

FAULT = "piston_seal_extrusion"
DUTY = ("--profile", "steps:amplitude=0.04,hold=1", "--load", "spring", "--duration", 40)
RECIPE = f"""
schema: fdd.recipe/1
name: extruded seals
seed: 8
bases: [axis_a]
units: 2
logs_per_unit: 8
healthy_share: 0.5
severity: [0.7, 1.0]
faults:
  {FAULT}: {{weight: 3}}
  internal_leakage: {{}}
duration: [22, 25]
onset: [0.3, 0.5]
loads: {{spring: 1}}
duties: {{steps: 1}}
baseline: true
format: parquet
"""


def fdd(*arguments: object) -> Result:
    """Run a command in this process."""
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert done.exit_code == 0, done.stderr or done.stdout
    return done


def answer_of(log: Path, *options: object) -> dict:
    """The answer of ``fdd diagnose --json -``."""
    return json.loads(fdd("diagnose", log, "--unit", "axis_a", "--json", "-", *options).stdout)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A healthy log, one with our fault and one with its nearest neighbour."""
    folder = tmp_path_factory.mktemp("logs")
    for number, name in enumerate(("healthy", FAULT, "internal_leakage")):
        fault = () if name == "healthy" else ("--fault", f"{name}:severity=0.7,onset=15")
        fdd("simulate", "--unit", "axis_a", *DUTY, *fault, "--seed", number, "-o", folder / f"{name}.mcap")
    return {path.stem: path for path in folder.iterdir()}


def test_the_catalogue_lists_it() -> None:
    listed = fdd("simulate", "--list-faults").stdout
    assert FAULT in listed and "fdd-example 0.1.0" in listed


def test_it_is_named_with_its_onset_and_severity(logs: dict[str, Path], tmp_path: Path) -> None:
    answer = answer_of(logs[FAULT], "--report", tmp_path / "report.html")
    first = answer["faults"][0]
    assert first["fault"] == FAULT and first["family"] == "seal_wear"
    assert first["onset_s"] == pytest.approx(15.0, abs=0.6)
    assert first["severity_interval"][0] < 0.7 < first["severity_interval"][1]
    # The shipped model has not learnt it, and that is said.
    assert any("has not learnt from logs with extruded piston seal" in line for line in first["evidence"])
    assert answer["versions"]["faults"] == "fdd-example 0.1.0"
    assert "Extruded piston seal" in (tmp_path / "report.html").read_text("utf-8")


def test_neither_a_healthy_log_nor_a_leak_is_taken_for_it(logs: dict[str, Path]) -> None:
    assert answer_of(logs["healthy"])["verdict"] == "healthy"
    assert answer_of(logs["internal_leakage"])["faults"][0]["fault"] == "internal_leakage"


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with our fault, of two units."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "recipe.yaml").write_text(RECIPE, "utf-8")
    fdd("generate", folder / "recipe.yaml", "-o", folder / "data", "--workers", 1)
    return folder / "data"


def test_a_data_set_with_it_is_learnt_and_validated(
    data: Path, logs: dict[str, Path], tmp_path: Path
) -> None:
    fdd("train", data, "-o", tmp_path / "model.json", "--workers", 1)
    model = Model.load(tmp_path / "model.json")
    assert model.faults == ("internal_leakage", FAULT)
    # Now it is learnt, and nothing else needs to be said.
    learnt = answer_of(logs[FAULT], "--model", tmp_path / "model.json")["faults"][0]
    assert learnt["fault"] == FAULT and not any("not learnt" in line for line in learnt["evidence"])
    arguments = ("--model", tmp_path / "model.json", "-o", tmp_path / "reports", "--workers", 1)
    fdd("validate", data, *arguments)
    outcomes = (tmp_path / "reports" / "outcomes.csv").read_text("utf-8").splitlines()
    assert sum(FAULT in line for line in outcomes) >= 3


def test_the_classifier_learns_it_and_its_opinion_stands_beside_ours(
    data: Path, logs: dict[str, Path], tmp_path: Path
) -> None:
    path = tmp_path / "forest.skops"
    arguments = ("--classifier", "forest", "--target", "fault", "-o", path, "--workers", 1)
    assert "that it has not seen" in fdd("train", data, *arguments).stdout
    with_it = answer_of(logs[FAULT], "--classifier", path)
    opinion = with_it.pop("second_opinion")
    truth = load_dataset(data).truth
    learnt_from = set(truth.loc[truth["split"] != "test", "fault"])
    assert FAULT in learnt_from
    assert set(opinion["probabilities"]) == learnt_from
    assert opinion["answer"] != "healthy" and sum(opinion["probabilities"].values()) == pytest.approx(
        1.0, abs=1e-3
    )
    without = answer_of(logs[FAULT])
    del with_it["sha256"]["classifier"]
    assert with_it == without


@pytest.fixture(scope="module")
def bench(logs: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The faulty log as a bench would write it, in its own units."""
    samples = read_log(logs[FAULT]).samples
    step = 1e-3
    time = np.arange(0.0, samples.time[-1], step)
    units = {"position": ("mm", 1e3), "pump_angle": ("deg", np.degrees(1.0)),
             "pressure_1": ("bar", 1e-5), "pressure_2": ("bar", 1e-5)}  # fmt: skip
    columns = [np.interp(time, samples.time, samples[n]) * factor for n, (_, factor) in units.items()]
    path = tmp_path_factory.mktemp("bench") / "run.bench"
    head = ["BENCH 1", "rate 1000", *(f"signal {n} {unit}" for n, (unit, _) in units.items()), "data"]
    np.savetxt(path, np.column_stack(columns), "%.9g", header="\n".join(head), comments="")
    return path


def test_a_bench_log_is_read_like_any_other(bench: Path, logs: dict[str, Path]) -> None:
    assert "bench log, 4 signals" in fdd("inspect", bench).stdout
    mine, original = read_log(bench).samples, read_log(logs[FAULT]).samples
    for name in ("position", "pump_angle", "pressure_1"):
        expected = np.interp(mine.time, original.time, original[name])
        np.testing.assert_allclose(mine[name], expected, rtol=1e-7, atol=1e-9)
    assert answer_of(bench)["faults"][0]["fault"] == FAULT
    found = fdd("diagnose", bench.parent, "--unit", "axis_a", "-o", bench.parent / "out")  # by its suffix
    assert "1 of 1 logs" in found.stdout


def test_the_bounds_hold_for_it(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FDD_MAX_VALUES", "1000")
    done = CliRunner().invoke(app, ["diagnose", str(bench), "--unit", "axis_a"])
    assert done.exit_code == 2 and "at most 1000 numbers" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_tracker_stands_beside_ours(logs: dict[str, Path], tmp_path: Path) -> None:
    report, annotated = tmp_path / "report.html", tmp_path / "annotated.mcap"
    shown = ("--report", report, "--mcap", annotated)
    with_it = answer_of(logs["internal_leakage"], "--tracker", "ukf", *shown)
    estimates = with_it["estimates"]
    # The truth: 0.7 of 12e-12 more than the profile's leakage, and its bulk modulus, which is higher at the
    # chambers' pressure.
    truth = estimates["leakage"]["baseline"] + 0.7 * 12e-12
    assert estimates["leakage"]["methods"]["ukf"]["value"] == pytest.approx(truth, rel=0.15)
    assert estimates["bulk_modulus"]["methods"]["ukf"]["value"] == pytest.approx(2.1e8, rel=0.15)
    assert 0.0 < estimates["leakage"]["methods"]["ukf"]["std"] < 0.1 * truth
    assert "Leakage coefficient, by ukf" in report.read_text("utf-8")
    followed = open_log(annotated).read(["/eha/axis_a/estimate.ukf.leakage"])
    (over_time,) = followed.values()
    assert over_time[900] == pytest.approx(estimates["leakage"]["baseline"], rel=0.3)  # before the onset
    assert over_time[-100] == pytest.approx(truth, rel=0.15)
    # Nothing else changes.
    del with_it["versions"]["tracker ukf"], with_it["sha256"]
    for estimate in estimates.values():
        estimate.pop("methods", None)
    without = answer_of(logs["internal_leakage"])
    del without["sha256"]
    assert with_it == without
