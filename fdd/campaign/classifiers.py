"""From data sets to a trained classifier, judged on units that it has not seen."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from sklearn.metrics import accuracy_score, confusion_matrix, f1_score
from sklearn.utils.validation import has_fit_parameter

from fdd import __version__
from fdd.campaign.loading import LabelledData, Target
from fdd.errors import InputError
from fdd.learning.stored import StoredClassifier
from fdd.packages import CLASSIFIERS, additions


@dataclass(frozen=True)
class Judgement:
    """How good a classifier is on held-out rows.

    Attributes
    ----------
    accuracy, macro_f1 : shares. brier : mean over rows of the squared errors of all classes' probabilities, 0
        to 2. own_accuracy, own_macro_f1 : of fdd's own answers on the same rows. rows, units : held out.
    confusion : rows by true class (index) and answer (columns).
    """

    accuracy: float
    macro_f1: float
    brier: float
    own_accuracy: float
    own_macro_f1: float
    rows: int
    units: int
    confusion: pd.DataFrame

    @property
    def figures(self) -> dict[str, float]:
        """Those that are kept with the classifier."""
        return {"accuracy": self.accuracy, "macro_f1": self.macro_f1, "brier": self.brier,
                "rows": self.rows, "units": self.units}  # fmt: skip


def made(name: str) -> Any:
    """A new classifier, by name.

    Parameters
    ----------
    name : of an entry point of the group ``fdd.classifiers``, or ``module:function``; the module may lie in
        the working folder.

    Raises
    ------
    InputError : there is none, it does not load, or what it makes is no classifier.
    """
    known = {a.name: a for a in additions(CLASSIFIERS)}
    module, colon, function = name.partition(":")
    try:
        if colon:
            if str(Path.cwd()) not in sys.path:
                sys.path.append(str(Path.cwd()))
            make = getattr(import_module(module), function)
        elif name in known:
            make = known[name].load()
        else:
            raise InputError(
                "no classifier of that name", where=name,
                mend=f"give {', '.join(sorted(known)) or 'none is installed'}, or MODULE:FUNCTION",
            )  # fmt: skip
        estimator = make()
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"makes no classifier ({type(error).__name__}: {error})", where=name,
            mend="give a function without arguments that returns one",
        ) from None  # fmt: skip
    if not all(hasattr(estimator, method) for method in ("fit", "predict_proba", "get_params")):
        raise InputError(
            "makes no classifier of scikit-learn's kind with probabilities", where=name,
            mend="return one with predict_proba, e.g. in CalibratedClassifierCV",
        )  # fmt: skip
    return estimator


def train_classifier(
    name: str, sets: Sequence[LabelledData], target: Target = "family"
) -> tuple[StoredClassifier, Judgement]:
    """Train on the units of train and validation, judge on those of test.

    Parameters
    ----------
    name : see `made`. sets : with features, all of the same columns and windows. target : what it is to tell.

    Raises
    ------
    InputError : features that differ, too little to learn or to judge by, or the classifier refuses the data.
    """
    estimator = made(name)
    names, window = sets[0].names, sets[0].window_s
    for each in sets[1:]:
        if each.names != names or each.window_s != window:
            raise InputError(
                f"features unlike those of {sets[0].data.directory}", where=each.data.directory,
                mend="make them all with one version and one --window",
            )  # fmt: skip
    parts = [
        (s.arrays(split, target), f"{k}/", s.own_answers(split, target), split == "test")
        for k, s in enumerate(sets)
        for split in ("train", "validation", "test")
    ]
    x, y, units, own = (
        np.concatenate(columns)
        for columns in zip(
            *((a[0], a[1], np.char.add(mark, a[2]), said) for a, mark, said, _ in parts), strict=True
        )
    )
    test = np.concatenate([np.full(len(a[1]), held) for a, _, _, held in parts])
    if not test.any() or np.unique(y[~test]).size < 2:
        raise InputError(
            f"{np.unique(units[test]).size} units to judge by, {np.unique(y[~test]).size} classes to learn",
            where=sets[0].data.directory, mend="generate more units and logs",
        )  # fmt: skip
    more = {"groups": units[~test]} if has_fit_parameter(estimator, "groups") else {}
    try:
        estimator.fit(x[~test], y[~test], **more)
        probabilities = np.asarray(estimator.predict_proba(x[test]), dtype=np.float64)
        classes = [str(c) for c in estimator.classes_]
    except Exception as error:
        raise InputError(f"refuses the data ({type(error).__name__}: {error})", where=name) from None
    judged = judgement(y[test], probabilities, classes, own[test], np.unique(units[test]).size)
    data = {s.data.manifest.name: s.data.manifest.sha256 for s in sets}
    stored = StoredClassifier(estimator, list(names), target, window, name, __version__, data, judged.figures)
    return stored, judged


def judgement(true: Any, probabilities: Any, classes: Sequence[str], own: Any, units: int) -> Judgement:
    """Figures of answers against the truth.

    Parameters
    ----------
    true : (n,) labels. probabilities : (n, c) of `classes`. own : (n,) fdd's own answers.

    Examples
    --------
    >>> one = judgement(["a", "b"], np.array([[1.0, 0.0], [0.5, 0.5]]), ["a", "b"], ["a", "a"], 2)
    >>> one.accuracy, one.brier, one.own_accuracy
    (0.5, 0.25, 0.5)
    """
    true, own = np.asarray(true, dtype=np.str_), np.asarray(own, dtype=np.str_)
    said = np.asarray(classes, dtype=np.str_)[probabilities.argmax(axis=1)]
    # A class that was not learnt has probability 0.
    every = sorted({*classes, *true.tolist()})
    full = np.zeros((true.size, len(every)))
    full[:, [every.index(c) for c in classes]] = probabilities
    brier = float(np.mean(np.sum(np.square(full - (true[:, None] == np.array(every))), axis=1)))
    shown = sorted({*true.tolist(), *said.tolist()})
    counts = pd.DataFrame(confusion_matrix(true, said, labels=shown), index=shown, columns=shown)
    return Judgement(
        float(accuracy_score(true, said)), float(f1_score(true, said, average="macro", zero_division=0.0)),
        brier, float(accuracy_score(true, own)),
        float(f1_score(true, own, average="macro", zero_division=0.0)), true.size, units, counts,
    )  # fmt: skip
