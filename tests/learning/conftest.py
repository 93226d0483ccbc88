"""A small data set, and features that are drawn, not diagnosed: fast, and their distributions are known."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdd.campaign.dataset import Dataset
from fdd.campaign.generate import generate
from fdd.campaign.loading import table_of, write_features
from fdd.campaign.recipe import Recipe
from fdd.learning.features import FEATURES

RECIPE = {
    "schema": "fdd.recipe/1", "name": "few", "seed": 11, "bases": ["axis_a"], "units": 5, "logs_per_unit": 4,
    "healthy_share": 0.5, "faults": {"internal_leakage": {}}, "duration": [3, 3], "baseline": False,
    "duties": {"steps": 1}, "loads": {"spring": 1}, "licence": "CC-BY-4.0", "at_start_share": 0,
    "recording": {"rate": 200, "channels": ["pump_angle", "position", "pressure_difference"]},
}  # fmt: skip


@pytest.fixture(scope="session")
def few(tmp_path_factory) -> Path:
    """Five units of four logs of 3 s with three channels at 200 Hz; leaks in half of them."""
    folder = tmp_path_factory.mktemp("learning") / "few"
    generate(Recipe(**RECIPE), folder)
    return folder


def drawn_rows(data: Dataset, apart: float, seed: int = 0) -> list[dict[str, Any]]:
    """A row a log: all features normal, the scores shifted by `apart` where there is a leak."""
    rng = np.random.default_rng(seed)
    rows = []
    for entry in data.logs:
        lead = entry.faults[0] if entry.faults else None
        row: dict[str, Any] = dict(zip(FEATURES, rng.normal(size=len(FEATURES)).tolist(), strict=True))
        for name in row:
            row[name] += apart if lead and name.startswith("score_") else 0.0
        row["misfit_refeed"] = float("nan")
        family = entry.family
        rows.append({
            **row, "file": entry.file, "start_s": 0.0, "end_s": 3.0, "unit": entry.unit,
            "fault": lead.fault if lead else "healthy", "faults": "", "family": family, "severity": 0.0,
            "onset_s": None, "structure": "", "load": "", "duty": "", "control": "",
            "answer_verdict": "healthy", "answer_fault": "healthy", "answer_family": "healthy",
            "answer_confidence": 0.5,
        })  # fmt: skip
    return rows


@pytest.fixture(scope="session")
def few_features(few, tmp_path_factory) -> Path:
    """Drawn features of `few`, that a classifier can tell leaks by."""
    data = Dataset.load(few)
    path = tmp_path_factory.mktemp("learning") / "features.parquet"
    write_features(table_of(drawn_rows(data, 30.0), data.manifest, "0" * 64), path)
    return path
