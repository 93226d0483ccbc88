"""From data sets to a trained classifier, judged on units that it has not seen."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.metrics import accuracy_score, f1_score
from sklearn.utils.validation import has_fit_parameter

from fdd import __version__
from fdd.campaign.dataset import SPLITS
from fdd.campaign.loading import LabelledData, Target
from fdd.errors import InputError
from fdd.learning.stored import StoredClassifier
from fdd.packages import CLASSIFIERS, additions

Figures = dict[str, float]


def made(name: str) -> Any:
    """A new classifier, by the name of an entry point of the group ``fdd.classifiers`` or as
    ``module:function``, where the module may lie in the working folder; an InputError where there is none, it
    does not load, or what it makes is no classifier."""
    known = {a.name: a for a in additions(CLASSIFIERS)}
    module, colon, function = name.partition(":")
    if not colon and name not in known:
        mend = f"give {', '.join(sorted(known)) or 'none is installed'}, or MODULE:FUNCTION"
        raise InputError("no classifier of that name", where=name, mend=mend)
    try:
        if colon and str(Path.cwd()) not in sys.path:
            sys.path.append(str(Path.cwd()))
        make = getattr(import_module(module), function) if colon else known[name].load()
        estimator = make()
    except InputError:
        raise
    except Exception as error:
        problem = f"makes no classifier ({type(error).__name__}: {error})"
        mend = "give a function without arguments that returns one"
        raise InputError(problem, where=name, mend=mend) from None
    if not all(hasattr(estimator, method) for method in ("fit", "predict_proba", "get_params")):
        problem = "makes no classifier of scikit-learn's kind with probabilities"
        mend = "return one with predict_proba, e.g. in CalibratedClassifierCV"
        raise InputError(problem, where=name, mend=mend)
    return estimator


def train_classifier(
    name: str, sets: Sequence[LabelledData], target: Target = "family"
) -> tuple[StoredClassifier, Figures]:
    """Train a classifier `made` by name on the units of train and validation, judge it on those of test.

    It comes with its figures: accuracy, macro_f1, brier, and how many rows and units of test they rest on;
    beside it accuracy and macro_f1 of fdd's own answers on the same rows. An InputError where features
    differ, there is too little to learn or to judge by, or the classifier refuses the data.
    """
    estimator = made(name)
    names = sets[0].names
    for each in sets[1:]:
        if each.names != names:
            problem = f"features unlike those of {sets[0].data.directory}"
            raise InputError(problem, where=each.data.directory, mend="make them all with one version")
    splits = [(k, one.rows(split)) for k, one in enumerate(sets) for split in SPLITS]
    rows = pd.concat([part.assign(unit=f"{k}/" + part["unit"]) for k, part in splits])
    x, test = rows[list(names)].to_numpy(dtype=np.float64), (rows["split"] == "test").to_numpy()
    y, groups, own = (rows[c].to_numpy(dtype=np.str_) for c in (target, "unit", f"answer_{target}"))
    judges = np.unique(groups[test]).size
    if not judges or np.unique(y[~test]).size < 2:
        problem = f"{judges} units to judge by, {np.unique(y[~test]).size} classes to learn"
        raise InputError(problem, where=sets[0].data.directory, mend="generate more units and logs")
    more = {"groups": groups[~test]} if has_fit_parameter(estimator, "groups") else {}
    try:
        estimator.fit(x[~test], y[~test], **more)
        probabilities = np.asarray(estimator.predict_proba(x[test]), dtype=np.float64)
        classes = [str(c) for c in estimator.classes_]
    except Exception as error:
        raise InputError(f"refuses the data ({type(error).__name__}: {error})", where=name) from None
    figures = {
        **judged(y[test], np.array(classes)[probabilities.argmax(axis=1)]),
        "brier": brier(y[test], probabilities, classes), "rows": int(test.sum()), "units": judges,
    }  # fmt: skip
    data = {s.data.manifest.name: s.data.manifest.sha256 for s in sets}
    stored = StoredClassifier(estimator, list(names), target, None, name, __version__, data, figures)
    return stored, judged(y[test], own[test])


def judged(true: Any, said: Any) -> Figures:
    """Shares of answers (n,) against the truth (n,)."""
    macro = f1_score(true, said, average="macro", zero_division=0.0)
    return {"accuracy": float(accuracy_score(true, said)), "macro_f1": float(macro)}


def brier(true: Any, probabilities: Any, classes: Sequence[str]) -> float:
    """Mean over rows of the squared errors of all classes' probabilities, 0 to 2.

    Not scikit-learn's: a class that was not learnt has probability 0.
    """
    true = np.asarray(true, dtype=np.str_)
    hit = true[:, None] == np.asarray(classes, dtype=np.str_)
    return float(np.mean(np.sum(np.square(probabilities - hit), axis=1) + ~hit.any(axis=1)))
