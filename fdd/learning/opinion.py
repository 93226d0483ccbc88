"""What a trained classifier says of a log that fdd has diagnosed."""

from __future__ import annotations

import numpy as np

from fdd.diagnosis.findings import Diagnosis, SecondOpinion
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.learning.features import FEATURES, features_of
from fdd.learning.stored import MEND, StoredClassifier
from fdd.samples import Samples


def require_usable(stored: StoredClassifier, where: str) -> None:
    """Refuse a classifier that a log's features do not suit.

    Raises
    ------
    InputError : of windows, or of features that this version does not have.
    """
    if stored.window_s is not None:
        problem = f"was trained on windows of {stored.window_s:g} s"
        raise InputError(problem, where=where, mend="train it on features of whole logs")
    missing = next((name for name in stored.features if name not in FEATURES), None)
    if missing is not None:
        problem = f"wants the feature {missing}, which this version does not have"
        raise InputError(problem, where=where, mend=f"train it anew; it is of fdd {stored.fdd}")


def opinion(
    stored: StoredClassifier, name: str, pipeline: Pipeline, answer: Diagnosis, samples: Samples
) -> SecondOpinion:
    """What a classifier says of a diagnosed log.

    Parameters
    ----------
    name : of its file. pipeline, answer, samples : of the whole log; see `features_of`.

    Raises
    ------
    InputError : it cannot take the features, or gives no probabilities.
    """
    row = features_of(pipeline, answer, samples)
    x = np.array([[row[feature] for feature in stored.features]])
    try:
        classes = [str(c) for c in stored.estimator.classes_]
        given = np.asarray(stored.estimator.predict_proba(x), dtype=np.float64)[0]
        if given.size != len(classes) or not np.isfinite(given).all():
            raise ValueError("no probability for each class")
    except Exception as error:
        problem = f"gives no answer ({type(error).__name__}: {error})"
        raise InputError(problem, where=name, mend=MEND) from None
    probabilities = {c: round(float(p), 4) for c, p in zip(classes, given, strict=True)}
    return SecondOpinion(
        classifier=name, target=stored.target, answer=classes[int(given.argmax())],
        probability=round(float(given.max()), 4), probabilities=probabilities,
    )  # fmt: skip
