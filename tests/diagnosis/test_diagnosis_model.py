"""Models on disk: checked before they are believed."""

from __future__ import annotations

import json
import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from fdd.diagnosis.model import CLASSIFIER, MANIFEST, Model
from fdd.errors import InputError
from fdd.residuals.features import FEATURES


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    with resources.as_file(resources.files("fdd") / "diagnosis" / "model") as shipped:
        shutil.copytree(shipped, tmp_path / "model")
    return tmp_path / "model"


def change(folder: Path, **fields: object) -> None:
    data = json.loads((folder / MANIFEST).read_text())
    data.update(fields)
    (folder / MANIFEST).write_text(json.dumps(data))


def test_round_trip(copy: Path, tmp_path: Path) -> None:
    model = Model.load(copy)
    model.save(tmp_path / "again")
    again = Model.load(tmp_path / "again")
    x = np.random.default_rng(0).normal(size=(5, len(FEATURES)))
    np.testing.assert_array_equal(model.probabilities(x), again.probabilities(x))
    np.testing.assert_allclose(model.probabilities(x).sum(axis=1), 1.0, atol=1e-12)


def test_shipped_model_knows_a_healthy_window() -> None:
    model = Model.load()
    window = np.array(model.manifest.centre)[None, :]
    assert model.classes[int(np.argmax(model.probabilities(window)))] == "healthy"


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"schema_name": "fdd.model/0"}, "version 'fdd.model/0'"),
        ({"classifier_sha256": "0" * 64}, "SHA-256"),
        ({"feature_version": "0"}, "features of version 0"),
        ({"classes": ["healthy", "gremlins"]}, "families"),
        ({"golden_outputs": [[1.0]]}, "golden"),
        ({"temperature": "warm"}, "temperature"),
    ],
)
def test_wrong_manifests_are_refused(copy: Path, fields: dict[str, object], says: str) -> None:
    change(copy, **fields)
    with pytest.raises(InputError, match=says) as caught:
        Model.load(copy)
    assert "\n" not in str(caught.value)


def test_changed_classifier_is_refused_before_it_is_parsed(copy: Path) -> None:
    content = bytearray((copy / CLASSIFIER).read_bytes())
    content[len(content) // 2] ^= 1
    (copy / CLASSIFIER).write_bytes(bytes(content))
    with pytest.raises(InputError, match="SHA-256"):
        Model.load(copy)


def test_missing_model_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="fdd train"):
        Model.load(tmp_path)


def test_foreign_types_are_not_loaded(copy: Path) -> None:
    import hashlib
    import operator

    from sklearn.preprocessing import FunctionTransformer
    from skops.io import dumps

    content = dumps(FunctionTransformer(operator.methodcaller("getcwd")))
    (copy / CLASSIFIER).write_bytes(content)
    change(copy, classifier_sha256=hashlib.sha256(content).hexdigest())
    with pytest.raises(InputError, match="types that fdd does not load"):
        Model.load(copy)
