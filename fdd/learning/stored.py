"""A trained classifier in a file: kept by skops, which runs no code of the file, and checked before use.

Types in it must be scikit-learn's, fdd's own or of a package that an installed entry point of the group
``fdd.classifiers`` names. Trees are checked besides: scikit-learn follows their indices without looking.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from fdd.bounds import MAX_CLASSIFIER_BYTES
from fdd.errors import InputError
from fdd.files import whole_file
from fdd.packages import CLASSIFIERS, additions

SCHEMA = "fdd.classifier/1"
OWN = ("sklearn.", "fdd.learning.")
FUNCTIONS = ("sklearn.feature_selection.", "sklearn.metrics.", "fdd.learning.")
"""Where functions may come from: scikit-learn's others fetch data sets and remove folders."""
LOADERS = {"ObjectNode", "TypeNode", "TreeNode"}
"""How skops may make instances of classes: not by calling them."""
MEND = "give a file that fdd train --classifier wrote"


@dataclass(frozen=True)
class StoredClassifier:
    """A classifier and what has to be known to use it.

    Attributes
    ----------
    estimator : fitted, with `predict_proba` and `classes_`. features : names of X's columns, in order.
    target : what it tells: ``family`` or ``fault``. window_s : of the rows that it was trained on; None:
        whole logs. name : as it was asked for. fdd : version. data : SHA-256 of the data sets, by name.
    figures : on held-out units.
    """

    estimator: Any
    features: list[str]
    target: str
    window_s: float | None
    name: str
    fdd: str
    data: dict[str, str]
    figures: dict[str, float]


def save_classifier(stored: StoredClassifier, path: str | Path) -> None:
    """Write a classifier whole or not at all.

    Raises
    ------
    InputError : it cannot be written, or holds what skops cannot keep.
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

    Raises
    ------
    InputError : no such file, too large, damaged, of types that are not trusted, or not one of fdd's.
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
        refused = sorted(skops.get_untrusted_types(file=path))
        trusted = [name for name in refused if _trusted(name, _loaders(state, name))]
        for name in refused:
            if name not in trusted:
                raise InputError(
                    f"holds {name}, which is not trusted", where=path,
                    mend=f"install the package whose entry point {CLASSIFIERS} made it, or {MEND}",
                )  # fmt: skip
        plain = skops.load(path, trusted=trusted)
        if plain.pop("schema") != SCHEMA:
            raise InputError(f"not of version {SCHEMA}", where=path, mend=MEND)
        stored = StoredClassifier(**plain)
        _check_trees(stored.estimator)
    except InputError:
        raise
    except MemoryError:
        raise
    except Exception as error:  # whatever a damaged file makes of skops and of the types in it
        raise InputError(f"not a classifier ({type(error).__name__})", where=path, mend=MEND) from None
    return stored


def _skops() -> Any:
    """The module that keeps classifiers.

    Raises
    ------
    InputError : it is not installed.
    """
    try:
        import skops.io
    except ModuleNotFoundError:
        raise InputError(
            "classifiers in files need the package skops", mend="install fdd[research]"
        ) from None
    return skops.io


def packages() -> set[str]:
    """Packages that installed entry points name, beside fdd."""
    return {a.point.module.partition(".")[0] for a in additions(CLASSIFIERS)} - {"fdd"}


def _loaders(state: Any, name: str) -> set[str]:
    """How a file wants a type to be used."""
    return {
        str(node.get("__loader__"))
        for node in _nodes(state)
        if f"{node.get('__module__')}.{node.get('__class__')}" == name
    }


def _nodes(state: Any) -> Iterator[dict[str, Any]]:
    left = [state]
    while left:
        node = left.pop()
        if isinstance(node, dict):
            yield node
            left += node.values()
        elif isinstance(node, list):
            left += node


def _trusted(name: str, loaders: set[str]) -> bool:
    """Whether a type may be loaded: by its own module, not the one that a file says it is found in."""
    if name == "numpy.dtype":
        return loaders == {"DTypeNode"}  # which is made of an empty array
    module, _, last = name.rpartition(".")
    installed = tuple(f"{package}." for package in packages())
    if not f"{module}.".startswith((*OWN, *installed)):
        return False
    found = getattr(import_module(module), last, None)
    home = f"{getattr(found, '__module__', '')}."
    if isinstance(found, type):
        return loaders <= LOADERS and home.startswith((*OWN, *installed))
    return (
        loaders == {"FunctionNode"}
        and isinstance(found, FunctionType)
        and home.startswith((*FUNCTIONS, *installed))
    )


def _check_trees(root: Any) -> None:
    """Refuse trees whose indices lead out of them.

    Raises
    ------
    ValueError : such a tree.
    """
    seen: set[int] = set()
    left: list[tuple[Any, int]] = [(root, 0)]
    while left:
        part, features = left.pop()
        if id(part) in seen:
            continue
        seen.add(id(part))
        features = int(getattr(part, "n_features_in_", features))
        if type(part).__name__ == "Tree" and hasattr(part, "children_left"):
            split = part.children_left != -1
            _check_nodes(part.children_left[split], part.children_right[split], part.feature[split],
                         np.flatnonzero(split), part.node_count, features)  # fmt: skip
        elif type(part).__name__ == "TreePredictor":
            nodes = part.nodes
            split = nodes["is_leaf"] == 0
            inner = nodes[split]
            _check_nodes(inner["left"], inner["right"], inner["feature_idx"], np.flatnonzero(split),
                         nodes.size, features)  # fmt: skip
            sets = inner["bitset_idx"][inner["is_categorical"] != 0]
            if sets.size and sets.max() >= len(part.raw_left_cat_bitsets):
                raise ValueError("a tree's categories lie outside of it")
        if isinstance(part, dict):
            inside: Any = part.values()
        elif isinstance(part, np.ndarray):
            inside = part.ravel().tolist() if part.dtype == object else ()
        elif isinstance(part, list | tuple):
            inside = part
        else:
            inside = () if isinstance(part, type) else getattr(part, "__dict__", {}).values()
        left += [(x, features) for x in inside]


def _check_nodes(one: Any, other: Any, feature: Any, own: Any, count: int, features: int) -> None:
    """Children come after their node, so that none is its own ancestor, and features are among those seen."""
    for child in (one.astype(np.int64), other.astype(np.int64)):
        if child.size and ((child <= own).any() or child.max() >= count):
            raise ValueError("a tree's nodes lead out of it")
    if feature.size and (feature.min() < 0 or feature.max() >= features):
        raise ValueError("a tree asks for features that there are not")
