"""``fdd experiment`` end to end."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

STROKES = "constant_speed:amplitude=0.06,speeds=8/40/105/200,turn=5,dwell=0.3"


@pytest.fixture(scope="module")
def strokes(run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("experiment") / "strokes.parquet"
    assert run("simulate", "-o", path, "--profile", STROKES, "--duration", 20, "--seed", 6).exit_code == 0
    return path


@pytest.mark.parametrize("kind", ["frequency-response", "friction", "leakage", "gain", "bulk-modulus"])
def test_each_kind_tells_and_says_what_it_does_not(run, strokes, tmp_path, kind) -> None:
    page, data = tmp_path / "page.html", tmp_path / "data.json"
    result = run("experiment", kind, strokes, "--html", page, "--json", data)
    assert result.exit_code == 0, result.stderr
    found = json.loads(data.read_text())
    assert found["schema"] == "fdd.experiment/1" and found["experiment"] == kind
    assert found["logs"] == ["strokes.parquet"] and found["unit"] == "axis_a"
    for told in found["told"]:
        low, high = told["interval"]
        assert low <= told["value"] <= high and told["quantity"] in page.read_text()
    assert found["told"] or found["not_told"]
    # 80 columns cut neither numbers nor names.
    cells = [cell for row in found["table"] for cell in row.values()]
    assert all(word in result.stdout for cell in cells for word in cell.split())
    assert ("Not told" in result.stdout) == bool(found["not_told"])


def test_a_log_without_command_is_refused_in_one_line(run, strokes, tmp_path) -> None:
    bare, columns = tmp_path / "bare.csv", ["time", "position", "pump_angle", "pressure_difference"]
    pd.read_parquet(strokes)[columns].to_csv(bare, index=False)
    result = run("experiment", "frequency-response", bare, "--input", "command")
    assert result.exit_code == 2 and "no command" in result.stderr and result.stderr.count("\n") == 1
