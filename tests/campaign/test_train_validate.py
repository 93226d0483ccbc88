"""What is learnt from scored logs, against the distributions they were drawn from; metrics on a tiny set."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdd.campaign.dataset import Dataset
from fdd.campaign.generate import generate
from fdd.campaign.recipe import Recipe
from fdd.campaign.train import LEAST_LOGS, ScoredLog, learnt
from fdd.campaign.validate import Outcome, outcomes_csv, report_text, summary, validate
from fdd.diagnosis.model import Model
from fdd.errors import InputError

RECIPE = """
schema: fdd.recipe/1
name: tiny
seed: 3
bases: [axis_a]
units: 1
logs_per_unit: 2
faults: {internal_leakage: {}}
healthy_share: 0.5
profiles: {step: 1}
duties: {steps: 1}
loads: {spring: 1}
severity: [0.9, 1.0]
duration: [40, 41]
onset: [0.3, 0.4]
baseline: true
format: parquet
"""


def scored(family: str, score: float) -> ScoredLog:
    return ScoredLog("unit", "", family, "", score, 360.0)


def drawn(seed: int = 0) -> list[ScoredLog]:
    """A peak each tenth of an hour; exponential, with mean 2 for healthy logs and 12 for faulty ones."""
    rng = np.random.default_rng(seed)
    healthy = [scored("healthy", s) for s in rng.exponential(2.0, 4000)]
    return healthy + [scored("leakage", s) for s in rng.exponential(12.0, 1000)]


@pytest.mark.parametrize("rate", [2.0, 0.5, 0.05])
def test_the_threshold_is_passed_at_the_rate_asked_for(rate: float) -> None:
    model = learnt(drawn(), "made up")
    # Ten peaks an hour above 0, each above s with exp(-s/2).
    assert model.tail.threshold(rate) == pytest.approx(2.0 * np.log(10.0 / rate), rel=0.1)
    assert model.tail.hours == pytest.approx(400.0)


def test_probabilities_are_those_of_even_odds_before_the_log() -> None:
    """Bayes on the densities drawn from: a log of either kind is as likely before its score is known."""
    calibration = learnt(drawn(), "made up").calibration
    for score in (2.0, 4.0, 6.0, 10.0):
        healthy, faulty = np.exp(-score / 2.0) / 2.0, np.exp(-score / 12.0) / 12.0
        right = faulty / (healthy + faulty)
        assert calibration.probability(score) == pytest.approx(right, abs=0.08), score


def test_too_few_logs_teach_nothing() -> None:
    few = [scored("healthy", 1.0)] * (LEAST_LOGS - 1) + [scored("leakage", 9.0)] * 20
    with pytest.raises(InputError, match=f"{LEAST_LOGS - 1} healthy and 20 faulty"):
        learnt(few, "made up")


def test_the_metrics_of_made_up_outcomes() -> None:
    nothing = {(m, n): (0.02, 0.5) for m in ("ekf", "svsf") for n in ("leakage", "bulk_modulus")}
    right = Outcome(
        "a",
        "leakage",
        0.5,
        10.0,
        "spring",
        "steps",
        "faulty",
        "leakage",
        "pump_wear",
        0.9,
        10.5,
        12.0,
        0.4,
        nothing,
    )
    nan = float("nan")
    quiet = replace(right, file="b", family="healthy", onset_s=nan, severity=nan, answer="", detected_s=nan)
    wrong, early = replace(right, answer="friction"), replace(right, detected_s=9.0)
    text = summary([right, wrong, early, quiet])
    assert "right family: **33 %** of 3 faulty logs" in text
    assert "alarms on 1 healthy logs: **0**; before the onset of 3 faulty ones: 1" in text
    assert "| leakage | 3 | 2 | 1 (33 %) | 1 | 2 | 2.0 s | 0.5 s |" in text
    assert "| 80 to 95 % | 3 | 90 % | 67 % |" in text


@pytest.fixture(scope="module")
def tiny_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("validate")
    (folder / "recipe.yaml").write_text(RECIPE)
    generate(Recipe.load(folder / "recipe.yaml"), folder / "set", workers=1)
    return folder / "set"


def test_validation_compares_each_log_with_its_truth(
    tiny_set: Path, tiny_model: Model, tmp_path: Path
) -> None:
    tiny_model.save(tmp_path / "model.json")
    outcomes = validate(tiny_set, str(tmp_path / "model.json"), workers=1)
    healthy, leaking = sorted(outcomes, key=lambda o: o.family == "leakage")
    assert healthy.family == "healthy" and healthy.verdict == "healthy" and healthy.answer == ""
    assert leaking.family == "leakage" == leaking.answer and not leaking.early
    assert abs(leaking.answered_onset_s - leaking.onset_s) < 1.0
    for outcome in outcomes:
        for key, (error, share) in outcome.errors.items():
            assert not share or error < 0.05, key
    rows = list(csv.DictReader(io.StringIO(outcomes_csv(outcomes))))
    assert [r["file"] for r in rows] == [o.file for o in outcomes]
    assert summary(outcomes) in report_text(outcomes, Dataset.load(tiny_set))


def test_a_model_that_is_none_is_refused_before_any_work(tiny_set: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such model file"):
        validate(tiny_set, str(tmp_path / "none.json"), workers=1)
