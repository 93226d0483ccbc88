"""A trained classifier in a file, and what it says of a log that fdd has diagnosed.

It is kept by skops, which runs no code of the file, and checked before use.

Types in it must be scikit-learn's, fdd's own or of a package that an installed entry point of the group
``fdd.classifiers`` names. Trees are checked besides: scikit-learn follows their indices without looking.
"""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from fdd.bounds import MAX_CLASSIFIER_BYTES
from fdd.diagnosis.findings import Diagnosis, SecondOpinion
from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.learning.features import FEATURES, features_of
from fdd.packages import CLASSIFIERS, additions
from fdd.samples import Samples

SCHEMA = "fdd.classifier/1"
LOADERS = {"ObjectNode", "TypeNode", "TreeNode"}
FUNCTIONS = ("sklearn.feature_selection.", "sklearn.metrics.")
MEND = "give a file that fdd train --classifier wrote"


@dataclass(frozen=True)
class StoredClassifier:
    """A classifier, fitted, with `predict_proba` and `classes_`, and what has to be known to use it."""

    estimator: Any
    features: list[str]
    """Names of X's columns, in order."""
    target: str
    """``family`` or ``fault``."""
    window_s: float | None
    """None; older files may be of rows shorter than a log."""
    name: str
    fdd: str
    data: dict[str, str]
    """SHA-256 of the data sets, by name."""
    figures: dict[str, float]
    """On held-out units."""


def save_classifier(stored: StoredClassifier, path: str | Path) -> None:
    """Write a classifier whole or not at all.

    Raises InputError: it cannot be written, or holds what skops cannot keep.
    """
    skops = _skops()
    plain = {"schema": SCHEMA, **{name: getattr(stored, name) for name in stored.__dataclass_fields__}}
    with whole_file(path) as temporary:
        try:
            skops.dump(plain, temporary, compression=zipfile.ZIP_DEFLATED)
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError(f"cannot be kept by skops ({error})", where=stored.name) from None


def load_classifier(path: str | Path) -> StoredClassifier:
    """Read a classifier.

    Raises InputError: no such file, too large, damaged, of types that are not trusted, or not one of fdd's.
    """
    skops = _skops()
    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", where=path, mend=MEND)
    try:
        with zipfile.ZipFile(path) as file:
            size = sum(part.file_size for part in file.infolist())
            if size > MAX_CLASSIFIER_BYTES:
                raise InputError(f"larger than {MAX_CLASSIFIER_BYTES} bytes", where=path, mend=MEND)
            state = json.loads(file.read("schema.json"))
        asked = sorted(skops.get_untrusted_types(file=path))
        for name in asked:
            if not _trusted(name, _loaders(state, name)):
                mend = f"install the package whose entry point {CLASSIFIERS} made it, or {MEND}"
                raise InputError(f"holds {name}, which is not trusted", where=path, mend=mend)
        plain = skops.load(path, trusted=asked)
        if plain.pop("schema") != SCHEMA:
            raise InputError(f"not of version {SCHEMA}", where=path, mend=MEND)
        stored = StoredClassifier(**plain)
        _check_trees(stored.estimator)
        return stored
    except (InputError, MemoryError):
        raise
    except Exception as error:  # whatever a damaged file makes of skops and of the types in it
        raise InputError(f"not a classifier ({type(error).__name__})", where=path, mend=MEND) from None


def require_usable(stored: StoredClassifier, where: str) -> None:
    """Refuse a classifier that a log's features do not suit.

    Raises InputError: of windows, or of features that this version does not have.
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
    """What a classifier, in the file `name`, says of a diagnosed log; else see `features_of`.

    Raises InputError: it cannot take the features, or gives no probabilities.
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


def _skops() -> Any:
    try:
        import skops.io
    except ModuleNotFoundError:
        problem = "classifiers in files need the package skops"
        raise InputError(problem, mend="install fdd[research]") from None
    return skops.io


def packages() -> set[str]:
    """Packages that installed entry points name, beside fdd."""
    return {a.point.module.partition(".")[0] for a in additions(CLASSIFIERS)} - {"fdd"}


def _loaders(state: Any, name: str) -> set[str]:
    """How a file wants a type to be used."""
    found, left = set(), [state]
    while left:
        node = left.pop()
        if isinstance(node, dict):
            if f"{node.get('__module__')}.{node.get('__class__')}" == name:
                found.add(str(node.get("__loader__")))
            node = list(node.values())
        left += node if isinstance(node, list) else []
    return found


def _trusted(name: str, loaders: set[str]) -> bool:
    """Whether a type may be loaded: by its own module, not the one that a file says it is found in; a class
    must not be called, as skops's nodes of lists and functions do."""
    if name == "numpy.dtype":
        return loaders == {"DTypeNode"}  # which is made of an empty array
    module, _, last = name.rpartition(".")
    own = ("sklearn.", "fdd.learning.", *(f"{package}." for package in packages()))
    if not f"{module}.".startswith(own):
        return False
    found = getattr(import_module(module), last, None)
    home = f"{getattr(found, '__module__', '')}."
    if isinstance(found, type):
        return loaders <= LOADERS and home.startswith(own)
    # Scikit-learn's other functions fetch data sets and remove folders.
    acts = isinstance(found, FunctionType) and loaders == {"FunctionNode"}
    return acts and home.startswith((*FUNCTIONS, *own[1:]))


def _check_trees(root: Any) -> None:
    """Raise ValueError of trees whose indices lead out of them."""
    seen: set[tuple[int, int]] = set()
    left: list[tuple[Any, int]] = [(root, 0)]
    while left:
        part, features = left.pop()
        kind = type(part).__name__
        features = features if kind == "TreePredictor" else int(getattr(part, "n_features_in_", features))
        if (id(part), features) in seen or isinstance(part, type):
            continue
        seen.add((id(part), features))
        # Those of gradient boosting are followed without a look at what each says of its features.
        boosted = kind.startswith("GradientBoosting") and hasattr(part, "estimators_")
        stages = part.estimators_.flat if boosted else ()
        if any(tree.n_features_in_ != features for tree in stages):
            raise ValueError("a tree has other features than its ensemble")
        if kind == "Tree" and hasattr(part, "children_left"):
            split = part.children_left != -1
            children = np.stack([part.children_left, part.children_right])[:, split]
            _check_nodes(children, part.feature[split], split, features)
        elif kind == "TreePredictor":
            split = part.nodes["is_leaf"] == 0
            inner = part.nodes[split]
            children = np.stack([inner["left"], inner["right"]]).astype(np.int64)
            _check_nodes(children, inner["feature_idx"], split, features)
            sets = inner["bitset_idx"][inner["is_categorical"] != 0]
            if (sets >= len(part.raw_left_cat_bitsets)).any():
                raise ValueError("a tree's categories lie outside of it")
        if isinstance(part, np.ndarray):
            part = part.ravel().tolist() if part.dtype == object else ()
        elif not isinstance(part, list | tuple | set):
            part = (part if isinstance(part, dict) else getattr(part, "__dict__", {})).values()
        left += [(inside, features) for inside in part]


def _check_nodes(children: Any, feature: Any, split: Any, features: int) -> None:
    """Children come after their node, so that none is its own ancestor, and features are among those seen."""
    if ((children <= np.flatnonzero(split)) | (children >= split.size)).any():
        raise ValueError("a tree's nodes lead out of it")
    if ((feature < 0) | (feature >= features)).any():
        raise ValueError("a tree asks for features that there are not")
