"""Data sets as learners get them: splits, hashes, the card, and tables that are told apart."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

from fdd import load_dataset
from fdd.campaign.dataset import split_of
from fdd.learning.features import FEATURES
from tests.refusal import refused

SPLITS = ("train", "validation", "test")


@given(st.integers(3, 200), st.integers(0, 2**32))
def test_units_are_divided_three_to_one_to_one(count: int, seed: int) -> None:
    units = [f"unit_{k:03d}" for k in range(count)]
    split = split_of(units, seed)
    assert list(split) == units and split == split_of(units[::-1], seed)
    sizes = [sum(s == name for s in split.values()) for name in SPLITS]
    assert sizes[1] == sizes[2] == max(round(count / 5), 1) and sizes[0] > 0


def test_arrays_are_the_rows_of_a_split(few: Path, few_features: Path) -> None:
    data = load_dataset(few, few_features)
    assert data.names == tuple(FEATURES)
    seen: dict[str, set[str]] = {}
    for split in SPLITS:
        x, y, groups = data.arrays(split)
        seen[split] = set(groups)
        rows = data.truth[data.truth["split"] == split]
        assert x.shape == (len(rows), len(FEATURES)) and x.dtype == np.float64
        assert y.tolist() == rows["family"].tolist() and groups.tolist() == rows["unit"].tolist()
    assert [len(seen[s]) for s in SPLITS] == [3, 1, 1] and len(set().union(*seen.values())) == 5
    assert np.isnan(data.arrays()[0][:, data.names.index("misfit_refeed")]).all()
    assert set(data.arrays(target="fault")[1]) == {"healthy", "internal_leakage"}


def test_the_truth_is_that_of_the_labels(few: Path) -> None:
    data = load_dataset(few)
    labels = json.loads((few / "labels.json").read_text())
    assert data.truth["file"].tolist() == [x["file"] for x in labels]
    for row, label in zip(data.truth.itertuples(), labels, strict=True):
        fault = label["faults"][0] if label["faults"] else None
        assert row.fault == (fault["fault"] if fault else "healthy")
        assert row.severity == (fault["severity"] if fault else 0.0)
        assert row.true_leakage == label["truth_medians"]["leakage"]
    assert "no features; make them with: fdd features" in refused(data.arrays)


def test_a_changed_log_is_seen_before_it_is_read(few: Path, tmp_path: Path) -> None:
    shutil.copytree(few, tmp_path / "copy")
    data = load_dataset(tmp_path / "copy")
    data.data.check()
    first, second = data.truth["file"][:2]
    (tmp_path / "copy" / first).write_bytes((tmp_path / "copy" / second).read_bytes())
    for touched in (lambda: data.samples(first), data.data.check):
        assert f"{first}: is not what SHA256SUMS was taken of" in refused(touched)
    data.samples(second)
    (tmp_path / "copy" / first).unlink()
    assert f"{first}: is missing" in refused(data.data.check)


def test_features_of_other_data_are_refused(few: Path, few_features: Path, tmp_path: Path) -> None:
    table = parquet.read_table(few_features)
    about = json.loads(table.schema.metadata[b"fdd"]) | {"data_sha256": "0" * 64}
    other = table.replace_schema_metadata({b"fdd": json.dumps(about)})
    parquet.write_table(other, tmp_path / "other.parquet")
    assert "features of other data" in refused(lambda: load_dataset(few, tmp_path / "other.parquet"))
    parquet.write_table(pa.table({"a": [1.0]}), tmp_path / "plain.parquet")
    (tmp_path / "text.parquet").write_text("no Parquet")
    for name in ("plain", "text", "none"):
        line = refused(partial(load_dataset, few, tmp_path / f"{name}.parquet"))
        assert "fdd features DATASET -o FILE.parquet" in line
