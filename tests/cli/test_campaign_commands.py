"""Commands for researchers: ``generate``, ``features``, ``train``, ``diagnose --classifier``; their page."""

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from pyarrow import parquet

from fdd.campaign.dataset import Dataset
from fdd.learning.classifier import FaultClassifier
from fdd.learning.features import FEATURES
from fdd.learning.stored import StoredClassifier, save_classifier
from fdd.unit import Unit

ROOT = Path(__file__).parents[2]
RECIPE = """
schema: fdd.recipe/1
units: 40
logs_per_unit: 9
healthy_share: 1
duration: [3, 3]
baseline: false
"""


def test_units_logs_and_twins_replace_those_of_the_recipe(run, ran, one_line, tmp_path):
    recipe = tmp_path / "few.yaml"
    recipe.write_text(RECIPE, encoding="utf-8")
    common = ("generate", recipe, "-o", tmp_path / "few", "--workers", 1, "--units", 1, "--logs")
    ran(*common, 2)
    data = Dataset.load(tmp_path / "few")
    assert len(data.logs) == 2 and data.recipe.units == 1 and data.recipe.logs_per_unit == 2
    one_line(run(*common, 3), "another recipe")
    one_line(run("generate", recipe, "-o", tmp_path / "many", "--units", 100_000), "units")
    faulty = RECIPE.replace("healthy_share: 1", "healthy_share: 0\nfaults: {pressure_sensor_bias: {}}")
    recipe.write_text(faulty + "twins: true\n", encoding="utf-8")
    for name, options, made in (("recipe", [], 1), ("none", ["--no-twins"], 0), ("asked", ["--twins"], 1)):
        where = ("-o", tmp_path / name, "--workers", 1, "--units", 1, "--logs", 1)
        ran("generate", recipe, *where, *options)
        data = Dataset.load(tmp_path / name)
        assert data.recipe.twins is bool(made) and sum(e.twin is not None for e in data.logs) == made
        assert len(list((tmp_path / name).rglob("twin_*"))) == made


@pytest.mark.parametrize("volume", [None, 0])
def test_a_base_whose_accumulator_has_no_size(run, one_line, tmp_path, volume):
    """As one would write a partner down: its gas volume left out, or 0."""
    plain = yaml.safe_load(Unit.load("axis_b").to_yaml())
    del plain["accumulator"]["gas_volume"]
    plain["accumulator"] |= {} if volume is None else {"gas_volume": volume}
    base, recipe = tmp_path / "partner.yaml", tmp_path / "recipe.yaml"
    base.write_text(yaml.safe_dump(plain), encoding="utf-8")
    recipe.write_text(f"{RECIPE}bases: [{base}]\n", encoding="utf-8")
    where = ("-o", tmp_path / "out", "--workers", 1, "--units", 1, "--logs", 1)
    one_line(run("generate", recipe, *where), "partner.yaml", "accumulator.gas_volume")


def test_what_cannot_be_generated_or_trained_on_is_refused(run, one_line, tmp_path, monkeypatch):
    (tmp_path / "set").mkdir()
    one_line(run("train", tmp_path / "set", "-o", tmp_path / "model"), str(tmp_path / "set"))
    one_line(run("train", tmp_path / "none", "-o", tmp_path / "model"), "none")
    (tmp_path / "twins.yaml").write_text(RECIPE + "twins: maybe\n", encoding="utf-8")
    one_line(run("generate", tmp_path / "twins.yaml", "-o", tmp_path / "x"), "twins.yaml", "twins", "maybe")
    command = ("generate", ROOT / "datasets" / "smoke.yaml", "-o", tmp_path / "x", "--engine")
    one_line(run(*command, "cloud"), "cloud")
    monkeypatch.setitem(sys.modules, "ray", None)
    one_line(run(*command, "ray"), "install fdd[ray]")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["set", "twins.yaml"]


@pytest.fixture(scope="module")
def classifier(tmp_path_factory) -> Path:
    """Says leakage where the leak's score is above about 5."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 1)) + np.repeat([0.0, 10.0], 100)[:, None]
    model = FaultClassifier().fit(x, np.repeat(["healthy", "leakage"], 100))
    path = tmp_path_factory.mktemp("classifier") / "mine.skops"
    stored = StoredClassifier(model, ["score_internal_leakage"], "family", None, "x", "0", {}, {})
    save_classifier(stored, path)
    return path


def test_a_classifier_speaks_beside_the_answer_and_changes_nothing_in_it(ran, logs, classifier, tmp_path):
    page, plain, asked = tmp_path / "p.html", tmp_path / "plain.json", tmp_path / "asked.json"
    ran("diagnose", logs["parquet"], "--json", plain)
    common = ("diagnose", logs["parquet"], "--classifier", classifier, "--json", asked, "--report", page)
    result = ran(*common)
    found = json.loads(asked.read_text())
    opinion = found.pop("second_opinion")
    assert opinion["classifier"] == "mine.skops" and opinion["answer"] == "leakage"
    assert opinion["probability"] > 0.9 and sum(opinion["probabilities"].values()) == pytest.approx(1.0)
    assert found["sha256"].pop("classifier")
    assert found == json.loads(plain.read_text())
    words = "The classifier mine.skops takes it for leakage"
    assert words in " ".join(result.stdout.split()) and words in page.read_text().replace("\xa0", " ")
    healthy = json.loads(ran("diagnose", logs["healthy"], "--classifier", classifier, "--json", "-").stdout)
    assert healthy["second_opinion"]["answer"] == "healthy"


def test_classifiers_that_do_not_suit(run, one_line, logs, tmp_path):
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
def test_the_page_for_researchers_is_true(ran, tmp_path, monkeypatch):
    """Its commands and its Python run one after another, as they stand there, in an empty folder."""
    shutil.copytree(ROOT / "datasets", tmp_path / "datasets")
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "research.md").read_text(encoding="utf-8")
    shown, said = dict[str, object](), list[str]()
    for kind, block in re.findall(r"^```(sh|python)\n(.*?)^```", text, flags=re.M | re.S):
        if kind == "python" and block.startswith("# mine.py"):
            (tmp_path / "mine.py").write_text(block)
        elif kind == "python":
            exec(compile(block, "research.md", "exec"), shown)
        for line in block.splitlines() if kind == "sh" else ():
            result = ran(*shlex.split(line, comments=True)[1:])
            said.append(result.stdout)
    assert "unseen" in text and len(said) == 5
    assert re.search(r"accuracy (0\.[5-9]\d|1\.00), macro-F1", said[2]), "gross faults"
    assert "takes it for" in said[3]
    assert shown["search"].score(shown["X_test"], shown["y_test"]) > 0.5
    ran("features", "smoke", "-o", "again.parquet", "--workers", 2)
    assert Path("again.parquet").read_bytes() == Path("smoke/features.parquet").read_bytes(), "by any workers"
    rows = parquet.read_table("again.parquet").to_pandas()
    assert list(rows.columns[-len(FEATURES) :]) == list(FEATURES)
