"""How ``fdd simulate`` makes a scenario: file and options, partner, the list of faults."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

import fdd
from fdd.faults import CATALOGUE
from fdd.plant.scenario import Scenario, scenario_data
from fdd.unit import Unit

FILE: dict[str, Any] = {
    "schema": "fdd.scenario/1", "unit": "axis_b", "duration": 12, "seed": 3, "control": {"gain": 9000},
    "faults": [{"fault": "pump_wear", "severity": 0.3}],
    "partner": {"unit": "axis_a", "drive": "still", "circuit": {"blocked": True, "throttle": "0:1/5:0.2"}},
}  # fmt: skip


@pytest.fixture
def asked(ran, tmp_path, monkeypatch) -> Any:
    """Run the command, in place of the plant, which has its own tests; gives what that was asked to run."""
    kept: list[tuple[Unit, Scenario, Unit | None]] = []

    def write(out: Path, unit: Unit, scenario: Scenario, *, partner: Unit | None, **_: object) -> None:
        assert out == tmp_path / "run.mcap"
        kept.append((unit, scenario, partner))

    def ask(*arguments: object) -> tuple[Unit, Scenario, Unit | None]:
        ran("simulate", "-o", tmp_path / "run.mcap", *arguments)
        return kept.pop()

    monkeypatch.setattr("fdd.cli.simulate.write_simulation", write)
    return ask


@pytest.fixture
def file(tmp_path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(FILE), encoding="utf-8")
    return path


def test_a_scenario_is_the_defaults_or_that_of_a_file_which_can_be_kept(asked, file, tmp_path):
    unit, scenario, partner = asked()
    assert unit.name == "axis_a" and partner is None and scenario == Scenario()
    unit, scenario, partner = asked("--scenario", file)
    assert (unit.name, partner.name) == ("axis_b", "axis_a")
    assert scenario == Scenario(**{k: v for k, v in FILE.items() if k != "schema"})
    again = tmp_path / "again.yaml"
    again.write_text(scenario.model_dump_json(), encoding="utf-8")  # which travels with a log
    assert Scenario(**scenario_data(again)) == scenario


def test_the_pages_scenario_has_its_valves(asked, tmp_path):
    page = (Path(fdd.__file__).parents[1] / "docs" / "simulator.md").read_text("utf-8")
    path = tmp_path / "rig.yaml"
    path.write_text(re.findall(r"```yaml\n(.*?)```", page, flags=re.DOTALL)[0], encoding="utf-8")
    _, scenario, _ = asked("--scenario", path)
    assert scenario.connect.line_1.least == 1.0
    assert scenario.circuit.bypass.points == ((0, 0), (5, 0), (5, 1))
    other = scenario.partner.circuit
    assert other.blocked and other.throttle.points == ((0, 1), (30, 0.1))


def test_options_override_the_file_and_leave_the_rest(asked, file):
    unit, scenario, partner = asked(
        "--scenario", file, "--unit", "axis_a", "--seed", 8, "--control", "speed",
        "--partner", "axis_b:power=0",
        "--fault", "aeration:severity=0.2,axis=2",
    )  # fmt: skip
    assert (unit.name, partner.name) == (scenario.unit, scenario.partner.unit) == ("axis_a", "axis_b")
    assert (scenario.duration, scenario.seed) == (12.0, 8)
    assert (scenario.control.mode, scenario.control.gain) == ("speed", 9000.0)
    assert scenario.partner.drive == "still" and scenario.partner.power.most == 0.0
    circuit = scenario.partner.circuit
    assert circuit.blocked and circuit.throttle.points == ((0.0, 1.0), (5.0, 0.2))
    assert [(f.fault, f.axis) for f in scenario.faults] == [("aeration", 2)]


def test_levels_are_written_on_the_command_line(asked):
    _, scenario, _ = asked("--profile", "levels:points=0:0.02/5:-0.02")
    assert scenario.duty.points.points == ((0.0, 0.02), (5.0, -0.02))
    _, scenario, _ = asked("--profile", "constant_speed:speeds=60/120")
    assert scenario.control.mode == "speed" and scenario.duty.speeds == (60.0, 120.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--partner", "axis_z"], ["axis_z", "axis_a"]),
        (["--partner", "axis_b:drive=gently"], ["drive"]),
        (["--partner", "axis_b:speed=3"], ["speed", "drive or power"]),
        (["--fault", "aeration:severity=0.2,axis=2"], ["no axis 2"]),
        (["--fault", "leek:severity=0.4"], ["leek", "internal_leakage"]),
        (["--fault", "internal_leakage:severity=0.2,onset=99", "--duration", 5], ["onset"]),
        (["--profile", "hops"], ["hops", "steps"]),
        (["--profile", "steps:hopping=3"], ["hopping"]),
        (["--profile", "steps:hold"], ["hold"]),
        (["--load", "elephant"], ["elephant", "spring"]),
        (["--load", "spring:rate=-1"], ["rate"]),
        (["--unit", "axis_z"], ["axis_z", "axis_a"]),
        (["--duration", "1e9"], ["duration"]),
        (["--control", "force"], ["control"]),
        (["--seed", "-1"], ["seed"]),
    ],
)
def test_a_bad_simulation_is_refused(run, one_line, tmp_path, arguments, words):
    one_line(run("simulate", "-o", tmp_path / "x.mcap", *arguments), *words)
    one_line(run("simulate", "-o", tmp_path / "x.xlsx", *arguments), "x.xlsx")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema: fdd.recipe/1\n", ["fdd.recipe/1", "not a scenario"]),
        ("duration: [", ["not valid YAML"]),
        ("durations: 3\n", ["unknown parameter"]),
        ("partner: axis_b\n", ["partner", "fields"]),
        ("connect: {line_1: 1}\n", ["no partner"]),
        ("circuit: {tap: 1}\n", ["tap"]),
        ("circuit: {throttle: wide}\n", ["throttle", "number"]),
        ("circuit: {blocked: perhaps}\n", ["blocked"]),
    ],
)
def test_a_bad_scenario_file_is_refused(run, one_line, tmp_path, text, words):
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    one_line(run("simulate", "-o", tmp_path / "x.mcap", "--scenario", path), *words)
    one_line(run("simulate", "-o", tmp_path / "x.mcap", "--scenario", tmp_path / "none.yaml"), "none.yaml")
    assert [p.name for p in tmp_path.iterdir()] == ["rig.yaml"]


def test_the_list_of_faults_shows_the_whole_catalogue(ran):
    result = ran("simulate", "--list-faults")
    for entry in CATALOGUE.values():
        (line,) = [row for row in result.stdout.splitlines() if row.split()[:1] == [entry.id]]
        assert entry.family in line
        assert ("1, 2" in line) == bool(entry.sides)
    words = " ".join(result.stdout.split())
    laws = [law for entry in CATALOGUE.values() for law in entry.laws.items()]
    assert re.findall(r"(?m)^ *law=(\S+)", result.stdout) == [name for name, _ in laws]
    assert all(f"law={name} {text}" in words for name, text in laws) and "the first is the default" in words
    assert "12e-12" in words and "tight_reverse" in words and "(not simulated)" in words
