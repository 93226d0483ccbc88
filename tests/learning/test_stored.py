"""Classifiers in files: they come back as they were; what could run or crash something is refused."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skops.io
from sklearn.ensemble import GradientBoostingClassifier as Stages
from sklearn.ensemble import HistGradientBoostingClassifier as Boosted
from sklearn.ensemble import RandomForestClassifier as Forest
from sklearn.feature_selection import SelectKBest, f_classif
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline

from fdd.errors import InputError
from fdd.learning import stored as module
from fdd.learning.classifier import boosting, logistic
from fdd.learning.stored import SCHEMA, StoredClassifier, load_classifier, save_classifier
from tests.refusal import refused

RNG = np.random.default_rng(0)
X = RNG.normal(size=(60, 3))
Y = np.where(X[:, 0] + 0.1 * RNG.normal(size=60) > 0.0, "leakage", "healthy")


class Strange(LogisticRegression):
    """Of a package that no entry point names."""


def kept(estimator: Any, path: Path) -> Path:
    stored = StoredClassifier(estimator, ["a", "b", "c"], "family", None, "made", "0.1.0", {"few": "0"}, {})
    save_classifier(stored, path)
    return path


def plain(estimator: Any) -> dict[str, Any]:
    return {
        "schema": SCHEMA, "estimator": estimator, "features": ["a"], "target": "family", "window_s": None,
        "name": "x", "fdd": "0", "data": {}, "figures": {},
    }  # fmt: skip


ESTIMATORS = [
    logistic(), boosting(), Forest(5, random_state=0), Boosted(max_iter=3, min_samples_leaf=5),
    make_pipeline(SelectKBest(f_classif, k=2), LogisticRegression()),
]  # fmt: skip


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_what_was_written_comes_back(estimator: Any, tmp_path: Path) -> None:
    estimator.fit(X, Y)
    found = load_classifier(kept(estimator, tmp_path / "c.skops"))
    assert (found.estimator.predict_proba(X) == estimator.predict_proba(X)).all()
    assert found.features == ["a", "b", "c"] and found.data == {"few": "0"}


def test_types_of_others_are_refused_until_their_package_has_an_entry_point(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = kept(Strange().fit(X, Y), tmp_path / "c.skops")
    with pytest.raises(InputError, match=r"holds \S*test_stored\.Strange, which is not trusted"):
        load_classifier(path)
    monkeypatch.setattr(module, "packages", lambda: {Strange.__module__.partition(".")[0]})
    assert isinstance(load_classifier(path).estimator, Strange)


def swapped(path: Path, old: str, new: tuple[str, str, str]) -> None:
    """Let a file say another module, name and loader where it says a class."""
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    state = json.loads(parts["schema.json"])
    (node,) = [n for n in state["content"]["estimator"]["content"] if n.get("__class__") == old]
    node["__module__"], node["__class__"], node["__loader__"] = new
    node.update({"content": []} if new[2] == "ListNode" else {})
    parts["schema.json"] = json.dumps(state).encode()
    with zipfile.ZipFile(path, "w") as file:
        for name, data in parts.items():
            file.writestr(name, data)


@pytest.mark.parametrize(
    "wanted",
    [
        ("posix", "system", "FunctionNode"),
        ("fdd.files", "write_text", "FunctionNode"),
        ("sklearn.datasets._base", "clear_data_home", "FunctionNode"),  # removes a folder
        ("sklearn.datasets._base", "clear_data_home", "ListNode"),  # which calls it
        ("fdd.learning.classifier", "FaultClassifier", "ListNode"),  # a class may be loaded, but not called
        ("sklearn.datasets._base", "Path", "ObjectNode"),  # found there, but not scikit-learn's
        ("fdd.learning.stored", "Pipeline", "ObjectNode"),
    ],
)
def test_nothing_that_acts_is_loaded(wanted: tuple[str, str, str], tmp_path: Path) -> None:
    path = tmp_path / "c.skops"
    skops.io.dump(plain([f_classif, LogisticRegression()]), path)
    swapped(path, "f_classif", wanted)
    with pytest.raises(InputError, match=rf"{wanted[0]}\.{wanted[1]}, which is not trusted"):
        load_classifier(path)


def test_trees_that_lead_out_of_themselves_are_refused(tmp_path: Path) -> None:
    """Such a tree would end the process at the first answer."""
    path = tmp_path / "c.skops"
    forest, boosted = Forest(3, random_state=0).fit(X, Y), Boosted(max_iter=2, min_samples_leaf=5).fit(X, Y)
    stages = Stages(n_estimators=2).fit(X, Y)
    for each in (forest, stages):
        load_classifier(kept(each, path))
    nodes, tree = boosted._predictors[1][0].nodes, forest.estimators_[2].tree_
    for estimator, array, value in (
        (boosted, nodes["left"], 10**6), (boosted, nodes["left"], 0), (boosted, nodes["feature_idx"], 3),
        (forest, tree.children_right, 10**6), (forest, tree.feature, 7),
    ):  # fmt: skip
        before, array[0] = array[0], value
        with pytest.raises(InputError, match=r"not a classifier \(ValueError\)"):
            load_classifier(kept(estimator, path))
        array[0] = before
    stages.estimators_[1, 0].n_features_in_, stages.estimators_[1, 0].tree_.feature[0] = 10**7, 10**6
    with pytest.raises(InputError, match=r"not a classifier \(ValueError\)"):
        load_classifier(kept(stages, path))


@pytest.mark.parametrize("cut", [0, 100, 0.5, 0.98])
def test_damaged_files_are_refused_in_one_line(cut: float, tmp_path: Path) -> None:
    data = kept(logistic().fit(X, Y), tmp_path / "c.skops").read_bytes()
    (tmp_path / "c.skops").write_bytes(data[: int(cut * len(data)) if cut < 1 else int(cut)])
    assert "fdd train --classifier wrote" in refused(lambda: load_classifier(tmp_path / "c.skops"))


def test_other_files_of_skops_and_files_too_large_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    skops.io.dump(LogisticRegression(), tmp_path / "bare.skops")
    skops.io.dump({**plain(LogisticRegression()), "schema": "fdd.classifier/9"}, tmp_path / "next.skops")
    for name, words in (("bare", "not a classifier"), ("next", "not of version"), ("none", "no such file")):
        with pytest.raises(InputError, match=words):
            load_classifier(tmp_path / f"{name}.skops")
    path = kept(logistic().fit(X, Y), tmp_path / "c.skops")
    monkeypatch.setattr(module, "MAX_CLASSIFIER_BYTES", 1000)
    with pytest.raises(InputError, match="larger than 1000 bytes"):
        load_classifier(path)
