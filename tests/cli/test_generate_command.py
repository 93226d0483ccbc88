"""``fdd generate``: numbers on the command line stand for the recipe's."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fdd.campaign.dataset import Dataset
from fdd.unit import Unit

RECIPE = """
schema: fdd.recipe/1
units: 40
logs_per_unit: 9
healthy_share: 1
duration: [3, 3]
baseline: false
"""


def test_units_and_logs_replace_those_of_the_recipe(run, one_line, tmp_path: Path) -> None:
    recipe = tmp_path / "few.yaml"
    recipe.write_text(RECIPE, encoding="utf-8")
    common = ("generate", recipe, "-o", tmp_path / "few", "--workers", 1, "--units", 1, "--logs")
    result = run(*common, 2)
    assert result.exit_code == 0, result.stderr
    data = Dataset.load(tmp_path / "few")
    assert len(data.logs) == 2 and data.recipe.units == 1 and data.recipe.logs_per_unit == 2
    one_line(run(*common, 3), "another recipe")
    one_line(run("generate", recipe, "-o", tmp_path / "many", "--units", 100_000), "units")


def test_twins_on_the_command_line_stand_for_the_recipes(run, one_line, tmp_path: Path) -> None:
    recipe = tmp_path / "twins.yaml"
    faulty = RECIPE.replace("healthy_share: 1", "healthy_share: 0\nfaults: {pressure_sensor_bias: {}}")
    recipe.write_text(faulty + "twins: true\n", encoding="utf-8")
    for name, options, made in (("recipe", [], 1), ("none", ["--no-twins"], 0), ("asked", ["--twins"], 1)):
        where = ("-o", tmp_path / name, "--workers", 1, "--units", 1, "--logs", 1)
        result = run("generate", recipe, *where, *options)
        assert result.exit_code == 0, result.stderr
        data = Dataset.load(tmp_path / name)
        assert data.recipe.twins is bool(made) and sum(e.twin is not None for e in data.logs) == made
        assert len(list((tmp_path / name).rglob("twin_*"))) == made
    recipe.write_text(faulty + "twins: maybe\n", encoding="utf-8")
    one_line(run("generate", recipe, "-o", tmp_path / "maybe"), "twins.yaml", "twins", "maybe")


@pytest.mark.parametrize("volume", [None, 0])
def test_a_base_whose_accumulator_has_no_size_is_told_in_one_line(
    run, one_line, tmp_path: Path, volume: int | None
) -> None:
    """As one would write a partner down: its gas volume left out, or 0."""
    plain = yaml.safe_load(Unit.load("axis_b").to_yaml())
    plain["accumulator"]["gas_volume"] = volume
    if volume is None:
        del plain["accumulator"]["gas_volume"]
    base, recipe = tmp_path / "partner.yaml", tmp_path / "recipe.yaml"
    base.write_text(yaml.safe_dump(plain), encoding="utf-8")
    recipe.write_text(f"{RECIPE}bases: [{base}]\n", encoding="utf-8")
    where = ("-o", tmp_path / "out", "--workers", 1, "--units", 1, "--logs", 1)
    one_line(run("generate", recipe, *where), "partner.yaml", "accumulator.gas_volume")
