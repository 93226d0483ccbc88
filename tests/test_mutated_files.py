"""Models and profiles with any value replaced: something right, or refused (`tests.fuzz` tears more)."""

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

from fdd.diagnosis.baseline import effects_of
from fdd.diagnosis.model import Model
from fdd.errors import InputError
from fdd.unit import Unit
from tests.fuzz.mutations import VALUES, changed, places

PROFILE = (resources.files("fdd.demo") / "unit.yaml").read_text(encoding="utf-8")
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
