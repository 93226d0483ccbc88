"""Commands for researchers: ``features``, ``train --classifier``, ``diagnose --classifier``; their page."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from fdd.learning.classifier import FaultClassifier
from fdd.learning.features import FEATURES
from fdd.learning.stored import StoredClassifier, save_classifier

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def classifier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Says leakage where the leak's score is above about 5."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 1)) + np.repeat([0.0, 10.0], 100)[:, None]
    model = FaultClassifier().fit(x, np.repeat(["healthy", "leakage"], 100))
    path = tmp_path_factory.mktemp("classifier") / "mine.skops"
    stored = StoredClassifier(model, ["score_internal_leakage"], "family", None, "x", "0", {}, {})
    save_classifier(stored, path)
    return path


def test_a_classifier_speaks_beside_the_answer_and_changes_nothing_in_it(
    run, logs: dict[str, Path], classifier: Path, tmp_path: Path
) -> None:
    page, plain, asked = tmp_path / "p.html", tmp_path / "plain.json", tmp_path / "asked.json"
    assert run("diagnose", logs["parquet"], "--json", plain).exit_code == 0
    common = ("diagnose", logs["parquet"], "--classifier", classifier, "--json", asked, "--report", page)
    result = run(*common)
    assert result.exit_code == 0, result.stderr
    found = json.loads(asked.read_text())
    opinion = found.pop("second_opinion")
    assert opinion["classifier"] == "mine.skops" and opinion["answer"] == "leakage"
    assert opinion["probability"] > 0.9 and sum(opinion["probabilities"].values()) == pytest.approx(1.0)
    assert found["sha256"].pop("classifier")
    assert found == json.loads(plain.read_text())
    words = "The classifier mine.skops takes it for leakage"
    assert words in " ".join(result.stdout.split()) and words in page.read_text().replace("\xa0", " ")
    healthy = json.loads(run("diagnose", logs["healthy"], "--classifier", classifier, "--json", "-").stdout)
    assert healthy["second_opinion"]["answer"] == "healthy"


def test_classifiers_that_do_not_suit_are_refused(
    run, one_line, logs: dict[str, Path], tmp_path: Path
) -> None:
    model = FaultClassifier(folds=0).fit([[0.0], [1.0]], ["healthy", "leakage"])
    for name, features, window in (("windows", ["duration"], 5.0), ("unknown", ["misfit_none"], None)):
        stored = StoredClassifier(model, features, "family", window, "x", "0", {}, {})
        save_classifier(stored, tmp_path / f"{name}.skops")
    common = ("diagnose", logs["parquet"], "--classifier")
    one_line(run(*common, tmp_path / "windows.skops"), "windows of 5 s")
    one_line(run(*common, tmp_path / "unknown.skops"), "misfit_none", "train it anew")
    (tmp_path / "text.skops").write_text("no classifier")
    one_line(run(*common, tmp_path / "text.skops"), "text.skops", "fdd train --classifier wrote")
    one_line(run("train", tmp_path, "--classifier", "none", "-o", tmp_path / "x"), "boosting, logistic")
    one_line(run("features", tmp_path, "-o", tmp_path / "x.parquet"), "not a data set")


@pytest.mark.slow
def test_the_page_for_researchers_is_true(run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its commands and its Python run one after another, as they stand there, in an empty folder."""
    shutil.copytree(ROOT / "datasets", tmp_path / "datasets")
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "research.md").read_text(encoding="utf-8")
    shown: dict[str, object] = {}
    said: list[str] = []
    for kind, block in re.findall(r"^```(sh|python)\n(.*?)^```", text, flags=re.M | re.S):
        if kind == "python" and block.startswith("# mine.py"):
            (tmp_path / "mine.py").write_text(block)
        elif kind == "python":
            exec(compile(block, "research.md", "exec"), shown)
        for line in block.splitlines() if kind == "sh" else ():
            result = run(*shlex.split(line, comments=True)[1:])
            assert result.exit_code == 0, (line, result.stderr)
            said.append(result.stdout)
    assert "unseen" in text and len(said) == 5
    assert re.search(r"accuracy (0\.[5-9]\d|1\.00), macro-F1", said[2]), "gross faults"
    assert "takes it for" in said[3]
    search = shown["search"]
    assert search.score(shown["X_test"], shown["y_test"]) > 0.5  # type: ignore[attr-defined]
    # The same table, by any number of workers.
    assert run("features", "smoke", "-o", "again.parquet", "--workers", 2).exit_code == 0
    assert Path("again.parquet").read_bytes() == Path("smoke/features.parquet").read_bytes()
    rows = parquet.read_table("again.parquet").to_pandas()
    assert list(rows.columns[-len(FEATURES) :]) == list(FEATURES)
