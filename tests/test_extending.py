"""The code of docs/extending.md runs as it stands there."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdd.faults import CATALOGUE, Fault
from fdd.faults import _problem as problem_of
from fdd.logs.formats import Format
from fdd.plant.details import Details
from fdd.plant.faults.injection import PARAMETERS
from fdd.residuals.added_tracker import TAKEN, Tracker
from fdd.residuals.balances import BALANCES
from fdd.unit import Unit

DOC = Path(__file__).parents[1] / "docs" / "extending.md"
BLOCKS = re.findall(r"```python\n(.*?)```", DOC.read_text("utf-8"), flags=re.DOTALL)


@pytest.fixture
def run(tmp_path: Path) -> Any:
    def block(number: int) -> dict[str, Any]:
        path = tmp_path / "block.py"
        path.write_text(BLOCKS[number], "utf-8")
        return runpy.run_path(str(path))

    return block


def test_the_fault_could_stand_in_the_catalogue(run) -> None:
    entry = run(0)["FAULT"]
    assert isinstance(entry, Fault) and problem_of(entry, CATALOGUE) == ""
    figures = {figure.name for figure in entry.figures}
    assert figures <= {n for e in entry.effects for n in e.numbers}
    assert not figures & set(Details.model_fields)
    assert {e.parameter for e in entry.effects} <= set(PARAMETERS)
    (columns,) = (s.columns(None) for s in entry.signatures)
    assert all(set(changes) <= set(BALANCES[name].columns) for name, changes in columns.items())


def test_the_format_reads_its_files(run, tmp_path: Path) -> None:
    found = run(1)["FORMAT"]
    assert isinstance(found, Format) and found.sniff(b' {"position"') and not found.sniff(b"time,position")
    path = tmp_path / "a.pairs"
    path.write_text(json.dumps({"position": [0.0, 0.1, None], "pump_speed": [1.0, 2.0, 3.0]}), "utf-8")
    log = found.opener(path)
    np.testing.assert_array_equal(log.read(["position"])["position"], [0.0, 0.1, np.nan])
    assert log.stamps("").tolist() == [0.0, 1e-3, 2e-3] and list(log.signals) == ["position", "pump_speed"]


def test_the_tracker_finds_a_leak_at_the_load_that_it_was_made_for(run) -> None:
    unit = Unit.load("axis_a")
    tracker = run(2)["make"](unit, tuple(TAKEN), 0.01)
    assert isinstance(tracker, Tracker) and {*tracker.inputs, *tracker.measurements} <= set(TAKEN)
    # The pump makes up for a leak of twice the profile's, and the piston stands.
    speed = 2.0 * unit.pump.total_leakage * 1e6 / unit.pump.displacement
    for _ in range(3000):
        tracker.filter.predict(u=np.array([speed]))
        tracker.filter.update(np.array([0.0]))
    leakage = tracker.quantities["leakage"](np.ravel(tracker.filter.x))
    assert leakage == pytest.approx(2.0 * unit.pump.total_leakage, rel=0.02)
