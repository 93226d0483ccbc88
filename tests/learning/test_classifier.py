"""The classifier against scikit-learn and Bayes; what is held out stays so; its files run nothing."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skops.io
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import GradientBoostingClassifier as Stages
from sklearn.ensemble import HistGradientBoostingClassifier as Boosted
from sklearn.ensemble import RandomForestClassifier as Forest
from sklearn.feature_selection import SelectKBest, f_classif
from sklearn.linear_model import LogisticRegression
from sklearn.metrics import brier_score_loss
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from fdd import load_dataset
from fdd.campaign.train import brier, judged, made, train_classifier
from fdd.errors import InputError
from fdd.learning import FaultClassifier
from fdd.learning import stored as module
from fdd.learning.classifier import boosting, logistic
from fdd.learning.stored import SCHEMA, StoredClassifier, load_classifier, save_classifier
from tests.refusal import refused


@pytest.mark.slow
@parametrize_with_checks([FaultClassifier("logistic")])
def test_it_is_an_estimator_of_scikit_learn(estimator, check):
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
def test_probabilities_are_near_those_of_bayes(make):
    x, y = drawn(600, 0)
    unseen, truth = drawn(2000, 1)
    given = make().fit(x, y).predict_proba(unseen)[:, 1]
    right = 1.0 / (1.0 + np.exp(-2.0 * unseen[:, 0] + 2.0))
    brier, best = np.mean((given - truth) ** 2), np.mean((right - truth) ** 2)
    assert brier < best + 0.02 and np.mean(np.abs(given - right)) < 0.09


def test_units_are_not_learnt_from_and_calibrated_by_at_once():
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


def test_held_out_units_are_not_learnt_from_and_what_can_be_told_is(few, few_features):
    data = load_dataset(few, few_features)
    SEEN.clear()
    stored, _ = train_classifier(f"{__name__}:Remembering", [data, data])
    (rows, units), test = SEEN[0], data.truth[data.truth["split"] == "test"]
    assert rows == 2 * (len(data.truth) - len(test)) and stored.figures["rows"] == 2 * len(test)
    held = {f"{k}/{u}" for k in (0, 1) for u in test["unit"]}
    assert len(units) == 8 and not units & held and stored.figures["units"] == 2
    assert stored.figures["brier"] == pytest.approx(0.5) and stored.features == list(data.names)
    assert stored.data == {"few": data.data.manifest.sha256}
    data = load_dataset(few, few_features)
    stored, own = train_classifier("logistic", [data], "fault")
    assert stored.figures["accuracy"] == 1.0 == stored.figures["macro_f1"] and stored.figures["brier"] < 0.5
    assert stored.target == "fault"
    # The drawn answers always say healthy.
    assert own["accuracy"] == np.mean(data.arrays("test", "fault")[1] == "healthy")


def test_figures_are_those_of_scikit_learn():
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
def test_what_is_no_classifier_is_refused(name):
    assert NONE[name] in refused(lambda: made(name))


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
def test_what_was_written_comes_back(estimator, tmp_path):
    estimator.fit(X, Y)
    found = load_classifier(kept(estimator, tmp_path / "c.skops"))
    assert (found.estimator.predict_proba(X) == estimator.predict_proba(X)).all()
    assert found.features == ["a", "b", "c"] and found.data == {"few": "0"}


def test_types_of_others_are_refused_until_their_package_has_an_entry_point(tmp_path, monkeypatch):
    path = kept(Strange().fit(X, Y), tmp_path / "c.skops")
    with pytest.raises(InputError, match=r"holds \S*test_classifier\.Strange, which is not trusted"):
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
def test_nothing_that_acts_is_loaded(wanted, tmp_path):
    path = tmp_path / "c.skops"
    skops.io.dump(plain([f_classif, LogisticRegression()]), path)
    swapped(path, "f_classif", wanted)
    with pytest.raises(InputError, match=rf"{wanted[0]}\.{wanted[1]}, which is not trusted"):
        load_classifier(path)


def test_trees_that_lead_out_of_themselves_are_refused(tmp_path):
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
def test_damaged_files_are_refused_in_one_line(cut, tmp_path):
    data = kept(logistic().fit(X, Y), tmp_path / "c.skops").read_bytes()
    (tmp_path / "c.skops").write_bytes(data[: int(cut * len(data)) if cut < 1 else int(cut)])
    assert "fdd train --classifier wrote" in refused(lambda: load_classifier(tmp_path / "c.skops"))


def test_other_files_of_skops_and_files_too_large_are_refused(tmp_path, monkeypatch):
    skops.io.dump(LogisticRegression(), tmp_path / "bare.skops")
    skops.io.dump({**plain(LogisticRegression()), "schema": "fdd.classifier/9"}, tmp_path / "next.skops")
    for name, words in (("bare", "not a classifier"), ("next", "not of version"), ("none", "no such file")):
        with pytest.raises(InputError, match=words):
            load_classifier(tmp_path / f"{name}.skops")
    path = kept(logistic().fit(X, Y), tmp_path / "c.skops")
    monkeypatch.setattr(module, "MAX_CLASSIFIER_BYTES", 1000)
    with pytest.raises(InputError, match="larger than 1000 bytes"):
        load_classifier(path)
