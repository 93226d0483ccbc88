"""A tiny model for tests of what stands around the classifier; it says nothing about accuracy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from fdd.diagnosis.model import MODEL_SCHEMA, Manifest, Model
from fdd.residuals.features import FEATURE_VERSION, FEATURES

# The same examples on every run, and no deadlines: the first call of a compiled function takes seconds.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

DISPLACED: dict[str, dict[str, tuple[float, float]]] = {
    "leakage": {"leakage": (0.25, 1.5)},
    "seal_wear": {"friction": (-1.5, -0.4)},
    "aeration": {"compliance": (0.3, 1.5)},
    "sensor": {"redundancy": (2.0, 8.0)},
}


# What differs from one healthy axis to the next, as its charge pressure does, has a wide spread.
_WIDE = ["drive", "torque", "innovation", "low_side", "accumulator", "jump", "load_unrest"]
SPREAD = np.where(np.isin(FEATURES, _WIDE), 0.5, 0.12)


def _windows(rng: np.random.Generator, family: str, count: int) -> NDArray[np.float64]:
    windows = rng.normal(0.0, SPREAD, (count, len(FEATURES)))
    for name, (low, high) in DISPLACED.get(family, {}).items():
        windows[:, FEATURES.index(name)] += rng.uniform(low, high, count)
    return windows


@pytest.fixture(scope="session")
def tiny_model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a saved model that knows four families, trained on made-up windows."""
    from sklearn.linear_model import LogisticRegression

    rng = np.random.default_rng(5)
    families = ["healthy", *DISPLACED]
    x = np.concatenate([_windows(rng, f, 400) for f in families]) / SPREAD
    y = np.repeat(families, 400)
    classifier = LogisticRegression(max_iter=2000).fit(x, y)
    golden = x[::400]
    manifest = Manifest(
        schema_name=MODEL_SCHEMA, fdd_version="0", sklearn_version="0", numpy_version="0",
        features=list(FEATURES), feature_version=FEATURE_VERSION,
        classes=[str(c) for c in classifier.classes_],
        healthy_share=0.2, centre=[0.0] * len(FEATURES), scale=SPREAD.tolist(),
        usual_spread=SPREAD.tolist(), tail={"height": 2.0, "rate": 1e-3, "scale": 1.0},
        temperature=1.0, training_data="made up for tests", training_sha256="", classifier_sha256="",
        golden_inputs=golden.tolist(), golden_outputs=classifier.predict_proba(golden).tolist(),
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("tiny") / "model"
    Model(classifier, manifest, "tiny").save(folder)
    return folder


@pytest.fixture(scope="session")
def tiny_model(tiny_model_folder: Path) -> Model:
    """That model, loaded."""
    return Model.load(tiny_model_folder)
