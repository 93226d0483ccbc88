"""The door of the identification: the command line's profile, from files or from samples."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from fdd import InputError, Scenario, Unit, identify, read_log
from fdd.cli.app import app
from fdd.plant.to_file import write_simulation

STROKES = {"name": "constant_speed", "amplitude": 0.08, "speeds": (60.0, 105.0), "turn": 5.0, "dwell": 0.3}
SCENARIO = Scenario(
    duration=21, duty=STROKES, control={"mode": "speed"}, load={"name": "throttle", "pressure": 1.5e6}, seed=6
)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("strokes") / "one.mcap"
    write_simulation(path, Unit.load("axis_a"), SCENARIO)
    return path


def told(unit: Unit) -> dict:
    """The profile without the minute that it was made in."""
    data = yaml.safe_load(unit.to_yaml())
    del data["origin"]["date"]
    return data


@pytest.mark.slow
def test_it_gives_the_profile_of_the_command_line(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "unit.yaml"
    assert CliRunner().invoke(app, ["identify", str(log), "-o", str(out)]).exit_code == 0
    unit = identify([log])
    assert told(unit) == told(Unit.load(out))
    assert unit.baseline is not None and unit.name.startswith("axis_a-")
    unit.save(tmp_path / "again.yaml")
    assert told(Unit.load(tmp_path / "again.yaml")) == told(unit)


@pytest.mark.slow
def test_samples_and_logs_serve_as_well(log: Path) -> None:
    read = read_log(log)
    from_log, from_samples = (identify(given, name="rig 7") for given in (read, [read.samples]))
    assert from_log.pump == from_samples.pump and from_log.baseline == from_samples.baseline
    assert from_log.name == "rig 7" and from_log.origin is not None
    assert list(from_log.origin.logs.values()) == ["one.mcap"]


def test_what_cannot_be_used_is_refused_in_one_line(log: Path) -> None:
    """Beside what the command refuses, by the same function (`tests/cli/test_identify_and_demo.py`)."""
    samples = read_log(log).samples
    for logs, more, words in (
        ([], {}, "no healthy log"),
        ([samples, samples], {}, "give each log once"),
        (log, {"add": "axis_a"}, "no healthy baseline"),
        (samples.with_columns({"pump_angle": -samples["pump_angle"]}), {}, "log 1"),
    ):  # fmt: skip
        with pytest.raises(InputError) as caught, warnings.catch_warnings():
            identify(logs, **more)
        assert words in str(caught.value) and "\n" not in str(caught.value)
