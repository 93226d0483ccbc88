"""Adding a fault touches one module of the product and one line of a recipe: shown on a copy of the tree."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DIFF = Path(__file__).parent / "adding_a_fault.diff"
NEW = "bypass_valve_ajar"
USE = f"""
from pathlib import Path
import numpy as np
from fdd import Scenario, Unit
import fdd
assert Path(fdd.__file__).is_relative_to(Path.cwd()), fdd.__file__

from fdd.faults import CATALOGUE
assert "{NEW}" in [f.id for f in CATALOGUE.values() if f.family == "leakage"][5:]
assert CATALOGUE["{NEW}"].signatures

from fdd.campaign.recipe import Recipe
assert Recipe.load("datasets/wide.yaml").faults["{NEW}"].weight == 0.3

from fdd.campaign.sizes import Scale, Size, sized_unit
larger = Scale(sized_unit(Size(), np.random.default_rng(1))).fault_scales({{}})
assert np.isclose(larger["bypass_valve_flow"], 0.5 * larger["relief_valve_flow"], rtol=1e-12)

from fdd.plant import conditions as c
from fdd.plant.faults import parse_fault
from fdd.plant.prepare import axis_conditions
for scales, flow in (({{}}, 5e-5), ({{"bypass_valve_flow": 2e-5}}, 2e-5)):
    faults = [parse_fault("{NEW}:severity=0.4,onset=1")]
    scenario = Scenario(faults=faults, fault_scales=scales)
    time = np.array([0.0, 1.0, 2.0])
    rows = axis_conditions(Unit.load("axis_a"), scenario, time, np.zeros(3), np.zeros(3)).rows
    np.testing.assert_allclose(rows[:, c.BYPASS], [0.0, 0.4 * flow, 0.4 * flow])
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tree with the diff applied."""
    folder = tmp_path_factory.mktemp("tree")
    for name in ("fdd", "estimators", "datasets"):
        # With the compiled code, which holds no fault.
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("*.pyc", "*.mcap"))
    alone = {"GIT_CEILING_DIRECTORIES": str(folder.parent)}  # or a repository around it would be meant
    subprocess.run(["git", "apply", str(DIFF)], cwd=folder, env={**os.environ, **alone}, check=True)
    return folder


def test_the_diff_is_one_new_module_and_one_recipe_line() -> None:
    parts = re.split(r"^diff --git .*\n", DIFF.read_text("utf-8"), flags=re.MULTILINE)[1:]
    recipes = [p for p in parts if "+++ b/datasets/" in p]
    modules = [p for p in parts if f"--- /dev/null\n+++ b/fdd/faults/{NEW}.py" in p]
    assert (len(parts), len(recipes), len(modules)) == (2, 1, 1)
    changed = [line for line in recipes[0].splitlines() if re.match(r"[+-](?![+-]{2} )", line)]
    assert changed == [f"+  {NEW}: {{weight: 0.3}}"]


@pytest.mark.slow
def test_it_is_in_the_catalogue_in_the_recipe_and_in_the_plant(copy: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    command = [sys.executable, "-c", USE]
    done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
