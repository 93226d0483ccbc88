"""The classifier against scikit-learn and Bayes; training: what is held out stays so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.metrics import brier_score_loss
from sklearn.utils.estimator_checks import parametrize_with_checks

from fdd import load_dataset
from fdd.campaign.classifiers import brier, judged, made, train_classifier
from fdd.learning import FaultClassifier
from fdd.learning.classifier import boosting, logistic
from tests.refusal import refused


@pytest.mark.slow
@parametrize_with_checks([FaultClassifier("logistic")])
def test_it_is_an_estimator_of_scikit_learn(estimator: Any, check: Any) -> None:
    check(estimator)


def drawn(n: int, seed: int, apart: float = 2.0) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Two classes, normal in one column, `apart` standard deviations from each other; others say nothing."""
    rng = np.random.default_rng(seed)
    y = rng.integers(0, 2, n)
    x = rng.normal(size=(n, 4))
    x[:, 0] += apart * y
    x[rng.random(n) < 0.3, 3] = np.nan
    return x, y


@pytest.mark.parametrize("make", [logistic, boosting])
def test_probabilities_are_near_those_of_bayes(make: Any) -> None:
    x, y = drawn(600, 0)
    unseen, truth = drawn(2000, 1)
    given = make().fit(x, y).predict_proba(unseen)[:, 1]
    right = 1.0 / (1.0 + np.exp(-2.0 * unseen[:, 0] + 2.0))
    brier, best = np.mean((given - truth) ** 2), np.mean((right - truth) ** 2)
    assert brier < best + 0.02 and np.mean(np.abs(given - right)) < 0.09


def test_units_are_not_learnt_from_and_calibrated_by_at_once() -> None:
    """Each unit has its label by heart in a column of its own: calibrated by rows it seems sure of itself."""
    rng = np.random.default_rng(2)
    units = rng.permutation(np.repeat(np.arange(30), 10))
    y = rng.integers(0, 2, 30)[units]
    # A feature that is the unit's own number: it tells all of a known unit and nothing of another.
    x = rng.normal(size=30)[units][:, None] + 1e-3 * rng.normal(size=(300, 1))
    new = rng.normal(size=(500, 1))
    by_rows = FaultClassifier("boosting", random_state=0).fit(x, y)
    by_units = FaultClassifier("boosting", random_state=0).fit(x, y, groups=units)
    assert by_rows.predict_proba(new).max(axis=1).mean() > 0.85
    assert by_units.predict_proba(new).max(axis=1).mean() < 0.7


SEEN: list[tuple[int, set[str]]] = []


class Remembering(ClassifierMixin, BaseEstimator):
    """Keeps what it is given."""

    def fit(self, X, y, groups=None):
        SEEN.append((len(X), set(groups)))
        self.classes_ = np.unique(y)
        return self

    def predict_proba(self, X):
        return np.full((len(X), self.classes_.size), 1.0 / self.classes_.size)


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


NONE = {
    "nothing": "no classifier of that name; give boosting, logistic",
    "no_such_module:make": "ModuleNotFoundError",
    f"{__name__}:no_classifier": "with predict_proba",
}


@pytest.mark.parametrize("name", NONE)
def test_what_is_no_classifier_is_refused(name: str) -> None:
    assert NONE[name] in refused(lambda: made(name))
