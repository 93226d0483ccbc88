"""The door of the identification: the command line's profile, from files or from samples; more logs narrow a
profile as if it had been made of all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from made_units import spread_unit, work
from typer.testing import CliRunner

from fdd import InputError, Samples, Scenario, Unit, identify
from fdd.cli.app import app
from fdd.diagnosis.baseline import add_baseline
from fdd.identification.from_logs import add_logs
from fdd.identification.identify import identify_unit
from fdd.plant.to_file import write_simulation

STROKES = {"name": "constant_speed", "amplitude": 0.08, "speeds": (60.0, 105.0), "turn": 5.0, "dwell": 0.3}
SCENARIO = Scenario(
    duration=21, duty=STROKES, control={"mode": "speed"}, load={"name": "throttle", "pressure": 1.5e6}, seed=6
)
PLAN = (("strokes", "constant"), ("steps", "spring"), ("flight", "gust"), ("steps", "constant"))


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


@pytest.fixture(scope="module")
def logs() -> list[Samples]:
    unit = spread_unit(4)
    return [work(unit, 60 + k, duty=duty, load=load) for k, (duty, load) in enumerate(PLAN)]


@pytest.fixture(scope="module")
def profile(logs: list[Samples]) -> Unit:
    return add_baseline(identify_unit(logs[:2], Unit.load("axis_a")).unit, logs[:2])


def test_added_logs_count_as_if_all_had_been_there(
    logs: list[Samples], profile: Unit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the unit's logs differ by stays as the first ones told it (`moderation`), here as any unit's."""
    monkeypatch.setattr("fdd.diagnosis.baseline.moderation", lambda name, logs, e: np.ones(len(e.mean)))
    profile = add_baseline(profile, logs[:2])
    found, added = add_logs(logs[2:], profile)
    together = add_baseline(profile, logs)
    assert added.baseline is not None and together.baseline is not None and profile.baseline is not None
    assert added.baseline.seconds == pytest.approx(together.baseline.seconds)
    assert set(added.baseline.balances) == set(together.baseline.balances)
    for name, one in added.baseline.balances.items():
        other, before = together.baseline.balances[name], profile.baseline.balances[name]
        std, std_all = (np.sqrt(np.diag(np.array(b.covariance))) for b in (one, other))
        assert np.all(np.abs(np.array(one.mean) - other.mean) < 0.5 * std_all), name
        np.testing.assert_allclose(std, std_all, rtol=0.05)
        assert np.all(std <= np.sqrt(np.diag(np.array(before.covariance))) * (1.0 + 1e-6))
        assert one.noise == pytest.approx(other.noise, rel=0.25)
    assert {row.quantity for row in found.balances} >= {"leakage", "travel per rad of the pump"}
    assert added.pump == profile.pump and added.cylinder == profile.cylinder


def test_a_profile_without_its_balances_takes_no_logs(logs: list[Samples], profile: Unit) -> None:
    assert profile.baseline is not None
    for baseline in (None, profile.baseline.model_copy(update={"version": "5"})):
        with pytest.raises(InputError, match="no healthy baseline of this version"):
            add_logs(logs[2:3], profile.model_copy(update={"baseline": baseline}))
