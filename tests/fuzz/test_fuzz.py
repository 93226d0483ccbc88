"""What was found once is not found again, and some hundred changed files of each kind find nothing new.

What is read of a model or a profile with a value replaced is fit for use."""

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
from tests.fuzz.targets import CORPUS, KINDS, run
from tests.fuzz.workers import Task, fuzz, tasks_of

EACH = 300


@pytest.mark.parametrize("kind", KINDS)
def test_every_seed_is_read(kind: str, tmp_path: Path) -> None:
    seeds = KINDS[kind].seeds(kind)
    assert seeds
    for path in seeds:
        copy = tmp_path / path.name
        copy.write_bytes(path.read_bytes())
        assert run(kind, copy) == "read", path.name


@pytest.mark.slow
def test_changed_files_are_read_or_refused_in_one_line() -> None:
    """Corpus: files that once ended the process, hung or raised something else than an `InputError`."""
    corpus = [Task(p.parent.name, file=p) for p in sorted(CORPUS.glob("*/*"))]
    assert len(corpus) >= 15
    out = fuzz([*corpus, *tasks_of(KINDS, EACH * len(KINDS), seed=1000)])
    assert not out.finds, "\n".join(f"{task}: {what}" for task, what in out.finds)
    for kind in KINDS:
        both = [out.counts[kind, what] for what in ("read", "refused")]
        assert sum(both) >= EACH and both[0] >= EACH // 100
    assert sum(n for (_, what), n in out.counts.items() if what == "refused") > 4 * EACH


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
