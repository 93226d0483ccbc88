"""Training: what is held out stays so, and figures are scikit-learn's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.dummy import DummyClassifier
from sklearn.metrics import brier_score_loss

from fdd import load_dataset
from fdd.campaign.classifiers import brier, judged, made, train_classifier
from fdd.errors import InputError

SEEN: list[tuple[int, set[str]]] = []


class Remembering(ClassifierMixin, BaseEstimator):
    """Keeps what it is given."""

    def fit(self, X, y, groups=None):
        SEEN.append((len(X), set(groups)))
        self.classes_ = np.unique(y)
        return self

    def predict_proba(self, X):
        return np.full((len(X), self.classes_.size), 1.0 / self.classes_.size)


class Refusing(DummyClassifier):
    """Takes no data."""

    def fit(self, X, y):
        raise ValueError("X has\nNaN")


def no_classifier() -> object:
    return BaseEstimator()


def test_held_out_units_are_not_learnt_from(few: Path, few_features: Path) -> None:
    data = load_dataset(few, few_features)
    SEEN.clear()
    stored, _ = train_classifier(f"{__name__}:Remembering", [data, data])
    (rows, units), test = SEEN[0], data.truth[data.truth["split"] == "test"]
    assert rows == 2 * (len(data.truth) - len(test)) and stored.figures["rows"] == 2 * len(test)
    held = {f"{k}/{u}" for k in (0, 1) for u in test["unit"]}
    assert len(units) == 8 and not units & held and stored.figures["units"] == 2
    assert stored.figures["brier"] == pytest.approx(0.5) and stored.features == list(data.names)
    assert stored.data == {"few": data.data.manifest.sha256}


def test_a_shipped_one_tells_what_can_be_told(few: Path, few_features: Path) -> None:
    data = load_dataset(few, few_features)
    stored, own = train_classifier("logistic", [data], "fault")
    assert stored.figures["accuracy"] == 1.0 == stored.figures["macro_f1"] and stored.figures["brier"] < 0.5
    assert stored.target == "fault"
    # The drawn answers always say healthy.
    assert own["accuracy"] == np.mean(data.arrays("test", "fault")[1] == "healthy")


def test_figures_are_those_of_scikit_learn() -> None:
    rng = np.random.default_rng(5)
    classes = ["aeration", "healthy", "leakage"]
    true = rng.choice(classes, 200)
    probabilities = rng.dirichlet([1.0, 2.0, 1.0], 200)
    wanted = brier_score_loss(true, probabilities, labels=classes, scale_by_half=False)
    assert brier(true, probabilities, classes) == pytest.approx(wanted)
    assert judged(true, true) == {"accuracy": 1.0, "macro_f1": 1.0}
    # A class that nobody learnt counts as missed, with probability 0.
    assert brier(["motor"], np.array([[0.0, 1.0, 0.0]]), classes) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nothing", "no classifier of that name; give boosting, logistic"),
        ("no_such_module:make", "ModuleNotFoundError"),
        (f"{__name__}:no_classifier", "with predict_proba"),
        (f"{__name__}:nothing", "AttributeError"),
        ("math:pi", "TypeError"),
    ],
)
def test_what_is_no_classifier_is_refused(name: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        made(name)


def test_unusable_data_are_refused(few: Path, few_features: Path) -> None:
    data = load_dataset(few, few_features)
    with pytest.raises(InputError, match=r"refuses the data \(ValueError: X has NaN\)"):
        train_classifier(f"{__name__}:Refusing", [data])
    with pytest.raises(InputError, match="features unlike those"):
        train_classifier("logistic", [data, replace(data, names=data.names[1:])])
    assert data.features is not None
    healthy = replace(data, features=data.features[data.features["family"] == "healthy"])
    with pytest.raises(InputError, match="1 classes to learn"):
        train_classifier("logistic", [healthy])
