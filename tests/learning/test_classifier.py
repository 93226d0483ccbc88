"""The classifier against scikit-learn's own checks, and against Bayes on data whose law is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, GroupKFold
from sklearn.utils.estimator_checks import parametrize_with_checks

from fdd import load_dataset
from fdd.learning import FaultClassifier
from fdd.learning.classifier import boosting, logistic


@pytest.mark.slow
@parametrize_with_checks([FaultClassifier("logistic"), FaultClassifier("boosting", random_state=0)])
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
    by_rows = FaultClassifier("boosting", random_state=0).fit(x, y).predict_proba(new).max(axis=1)
    by_units = (
        FaultClassifier("boosting", random_state=0).fit(x, y, groups=units).predict_proba(new).max(axis=1)
    )
    assert by_rows.mean() > 0.85 and by_units.mean() < 0.7


def test_a_search_over_units_finds_a_classifier(few: Path, few_features: Path) -> None:
    data = load_dataset(few, few_features)
    x, y, units = data.arrays("train")
    search = GridSearchCV(FaultClassifier(folds=0), {"strength": [1e-9, 1.0]}, cv=GroupKFold(3))
    search.fit(x, y, groups=units)
    assert search.best_params_ == {"strength": 1.0}
    unseen, truth, _ = data.arrays("test")
    assert search.predict(unseen).tolist() == truth.tolist()


def test_too_few_rows_are_not_calibrated_but_classified() -> None:
    x, y = drawn(40, 3, apart=20.0)
    y = np.where(y == 1, "leakage", "healthy").astype(object)
    y[0] = "aeration"
    model = clone(FaultClassifier()).fit(x, y)
    assert model.classes_.tolist() == ["aeration", "healthy", "leakage"]
    assert np.mean(model.predict(x[1:]) == y[1:]) == 1.0
    assert model.predict_proba(x).sum(axis=1) == pytest.approx(np.ones(40))
    with pytest.raises(ValueError, match="kind is logistic or boosting"):
        FaultClassifier("forest").fit(x, y)  # type: ignore[arg-type]
