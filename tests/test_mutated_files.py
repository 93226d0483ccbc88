"""Files of ours with anything in them changed: read as something right, or refused in one line."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from fdd.campaign.recipe import Recipe
from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.unit import Unit
from tests.fuzz.mutations import VALUES, changed, places, torn

PROFILE = (resources.files("fdd.demo") / "unit.yaml").read_text(encoding="utf-8")
RECIPES = Path(__file__).parents[1] / "datasets"
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]


def read(parse: Callable[[], Any]) -> Any:
    """What was read, or None where it was refused as it should be."""
    try:
        return parse()
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000
        return None


def test_a_model_with_any_figure_replaced(tmp_path: Path) -> None:
    plain = json.loads(Model.load().model_dump_json(by_alias=True))
    path, kept, tried = tmp_path / "model.json", 0, 0
    for place in places(plain):
        for value in VALUES:
            path.write_text(json.dumps(changed(plain, place, value)))
            model, tried = read(lambda: Model.load(path)), tried + 1
            if model is not None:
                kept += 1
                for rate in (1e-9, 1.0, 1e9):
                    assert math.isfinite(model.tail.threshold(rate))
                assert all(0.0 <= model.calibration.probability(s) <= 1.0 for s in (-1e9, 0.0, 1e9))
    assert tried > 100 and 0 < kept < tried // 3


@pytest.mark.parametrize("seed", SEEDS)
def test_a_profile_with_values_replaced(seed: int) -> None:
    plain, rng, kept = yaml.load(PROFILE, yaml.CSafeLoader), random.Random(seed), 0
    everywhere = list(places(plain))
    for place in rng.sample(everywhere, 100):
        text = yaml.dump(changed(plain, place, rng.choice(VALUES)), Dumper=yaml.CSafeDumper)
        unit = read(lambda text=text: Unit.from_yaml(text))
        if unit is not None:
            kept += 1
            for effects in effects_of(unit).values():
                assert np.isfinite(np.linalg.inv(effects.covariance)).all()
    assert 0 < kept < 100


@pytest.mark.parametrize("seed", SEEDS)
def test_torn_profiles_and_recipes(seed: int) -> None:
    rng = random.Random(100 + seed)
    recipes = [p.read_text(encoding="utf-8") for p in sorted(RECIPES.glob("*.yaml"))]
    assert recipes
    for _ in range(150):
        read(lambda: Unit.from_yaml(torn(PROFILE, rng)))
        read(lambda: Recipe.from_yaml(torn(rng.choice(recipes), rng)))


@pytest.mark.parametrize("recipe", sorted(p.name for p in RECIPES.glob("*.yaml")))
def test_a_recipe_with_values_replaced(recipe: str) -> None:
    plain, rng = (
        yaml.load((RECIPES / recipe).read_text(encoding="utf-8"), yaml.CSafeLoader),
        random.Random(recipe),
    )
    everywhere = list(places(plain))
    for _ in range(60):
        text = yaml.dump(changed(plain, rng.choice(everywhere), rng.choice(VALUES)), Dumper=yaml.CSafeDumper)
        read(lambda text=text: Recipe.from_yaml(text))
