"""``fdd map`` and ``fdd inspect``: a foreign log in, a map that reads it out; questions and wrong answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd.logs import ChannelMap, read_log


@pytest.fixture(scope="module")
def foreign(logs, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The healthy log under names of a rig's own, pressures in kPa without saying so."""
    samples = read_log(logs["healthy"]).samples
    path = tmp_path_factory.mktemp("foreign") / "rig.csv"
    columns = {
        "t": samples.time,
        "pump_rpm": samples["pump_speed"] * 30 / np.pi,
        "cyl_mm": 1e3 * samples["position"],
        "p1": samples["pressure_1"] / 1e3,
        "p2": samples["pressure_2"] / 1e3,
    }
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def test_an_answered_question_gives_a_map_that_reads_the_log(
    run, logs, foreign: Path, tmp_path: Path
) -> None:
    out = tmp_path / "map.yaml"
    result = run("map", foreign, "-o", out, "--set", "pressure=:kPa", "--axis", "axis_a")
    assert result.exit_code == 0 and "as it should" in result.stdout, result.stderr
    assert ChannelMap.load(out).axis == "axis_a"
    read, wanted = read_log(foreign, out).samples, read_log(logs["healthy"]).samples
    for channel in ("position", "pump_speed", "pressure_1", "pressure_2"):
        np.testing.assert_allclose(read[channel], wanted[channel], rtol=1e-9, atol=1e-9)


def test_an_open_question_is_told_and_nothing_written(run, foreign: Path, tmp_path: Path) -> None:
    result = run("map", foreign, "-o", tmp_path / "map.yaml")
    assert result.exit_code == 2 and "--set pressure=:" in result.stderr and "--yes" in result.stderr
    assert not (tmp_path / "map.yaml").exists()
    assert run("map", foreign, "-o", tmp_path / "map.yaml", "--yes").exit_code == 0
    text = (tmp_path / "map.yaml").read_text()
    assert "In which unit are p1, p2? Assumed: " in text and " assumed" in text


@pytest.mark.parametrize(
    ("given", "said"), [("pressur=:kPa", "did you mean 'pressure"), ("position=x", "no column 'x'")]
)
def test_wrong_answers_are_told(run, one_line, foreign: Path, tmp_path: Path, given: str, said: str) -> None:
    one_line(run("map", foreign, "-o", tmp_path / "map.yaml", "--yes", "--set", given), said)


def test_inspect_shows_every_signal(run, logs, foreign: Path) -> None:
    result = run("inspect", foreign)
    for name in ("pump_rpm", "cyl_mm", "p1"):
        assert name in result.stdout
    assert "1000" in result.stdout
    messages = run("inspect", logs["healthy"]).stdout
    assert "  /eha/axis_a/measurement " in messages and "    pressure_difference " in messages


def test_the_command_may_stand_in_for_the_speed(foreign: Path) -> None:
    """Test: a map without a measured speed. Expected: the demand's values, said so in the quality."""
    channel_map = ChannelMap.from_yaml(
        "time: {column: t}\ncommand: {column: pump_rpm, unit: rpm}\npump_speed: {from: command}\n"
        "position: {column: cyl_mm, unit: mm}\n"
        "pressure_1: {column: p1, unit: kPa}\npressure_2: {column: p2, unit: kPa}\n"
    )
    log = read_log(foreign, channel_map)
    np.testing.assert_array_equal(log.samples["pump_speed"], log.samples["command"])
    assert any("the command stands in" in note for note in log.quality.notes)
