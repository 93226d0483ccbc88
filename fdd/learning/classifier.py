"""A classifier of faults on the features of logs, as scikit-learn's estimators.

`FaultClassifier` is thin over scikit-learn: what is missing is filled in, heavy tails are drawn in, a
logistic regression or boosted trees decide, and their probabilities are calibrated on rows that they have
not seen.
"""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.calibration import CalibratedClassifierCV
from sklearn.ensemble import GradientBoostingClassifier
from sklearn.impute import SimpleImputer
from sklearn.linear_model import LogisticRegression
from sklearn.model_selection import GroupKFold, StratifiedKFold
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer, StandardScaler
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

Array = NDArray[np.float64]


class FaultClassifier(ClassifierMixin, BaseEstimator):
    """Which fault, by the features of a log.

    Parameters
    ----------
    kind : ``logistic`` regression, or ``boosting`` of trees (which needs some hundred logs).
    strength : of the regression, larger is freer (C); or the trees' learning rate over 0.1.
    folds : of the calibration, by Platt's sigmoid; 0 leaves it out, and so does a class of fewer rows.
    random_state : seed of the trees.

    Attributes
    ----------
    classes_ : (c,) labels. model_ : what was fitted.

    Examples
    --------
    >>> X, y = np.array([[0.0], [0.1], [5.0], [5.1]]), ["healthy", "healthy", "leakage", "leakage"]
    >>> FaultClassifier(folds=2).fit(X, y).predict([[4.9]]).tolist()
    ['leakage']
    """

    def __init__(
        self, kind: Literal["logistic", "boosting"] = "logistic", strength: float = 1.0, folds: int = 3,
        random_state: int | None = None,
    ) -> None:  # fmt: skip
        self.kind = kind
        self.strength = strength
        self.folds = folds
        self.random_state = random_state

    def fit(self, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None = None) -> Self:
        """Learn from labelled logs.

        Parameters
        ----------
        X : (n, k) features, NaN where one is missing. y : (n,) labels. groups : (n,) units: no unit is both
            learnt from and calibrated by.

        Raises ValueError: as scikit-learn's: shapes that do not fit, infinite values, fewer than two classes.
        """
        X, y = validate_data(self, X, y, ensure_all_finite="allow-nan")
        X = np.asarray(X)
        check_classification_targets(y)
        self.classes_, codes = np.unique(y, return_inverse=True)
        if self.classes_.size < 2:
            raise ValueError(f"a classifier needs two classes or more, not {self.classes_.size} class")
        model = self._plain()
        splits = self._splits(X, codes, groups)
        if splits:
            model = CalibratedClassifierCV(model, cv=splits, ensemble=False)
        self.model_ = model.fit(X, codes)
        return self

    def _plain(self) -> Any:
        if self.kind == "boosting":
            # Not the histogram one: its threads wait for each other where cores are shared.
            decides = GradientBoostingClassifier(
                learning_rate=0.1 * self.strength, subsample=0.8, max_features="sqrt",
                random_state=self.random_state,
            )  # fmt: skip
        elif self.kind == "logistic":
            decides = LogisticRegression(C=self.strength, max_iter=2000)
        else:
            raise ValueError(f"kind is logistic or boosting, not {self.kind!r}")
        # What no log of the training tells stays a column, so that all keep their places.
        filled = SimpleImputer(strategy="median", keep_empty_features=True)
        return make_pipeline(filled, FunctionTransformer(np.arcsinh), StandardScaler(), decides)

    def _splits(self, X: Array, codes: NDArray[np.int64], groups: ArrayLike | None) -> list[Any]:
        """Folds of the calibration; none where a class has fewer rows, or there are fewer groups."""
        if self.folds < 2 or np.bincount(codes).min() < self.folds:
            return []
        if groups is None:
            return list(StratifiedKFold(self.folds).split(X, codes))
        groups = np.asarray(groups)
        if np.unique(groups).size < self.folds:
            return []
        splits = list(GroupKFold(self.folds).split(X, codes, groups))
        every = np.unique(codes).size
        return splits if all(np.unique(codes[learnt]).size == every for learnt, _ in splits) else []

    def predict_proba(self, X: ArrayLike) -> Array:
        """Probability of each of `classes_`, (n, c)."""
        check_is_fitted(self)
        X = validate_data(self, X, ensure_all_finite="allow-nan", reset=False)
        return np.asarray(self.model_.predict_proba(X))

    def predict(self, X: ArrayLike) -> NDArray[Any]:
        """The likeliest label of each row, (n,)."""
        likeliest = self.predict_proba(X).argmax(axis=1)
        return np.asarray(self.classes_[likeliest])

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags


def logistic() -> FaultClassifier:
    """A regularised logistic regression: good on a hundred logs."""
    return FaultClassifier("logistic", strength=0.3)


def boosting() -> FaultClassifier:
    """Boosted trees: better from some hundred logs on."""
    return FaultClassifier("boosting", random_state=0)
