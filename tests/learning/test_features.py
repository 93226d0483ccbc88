"""Features against answer, truth and a calculation by hand; data sets as learners get them."""

import json
import math
import re
import shutil
from functools import partial

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

from fdd import load_dataset
from fdd.campaign.dataset import split_of
from fdd.diagnosis.pipeline import Pipeline
from fdd.learning.features import FEATURES, Row, features_of, log_features
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit
from tests.refusal import refused

ONSET, SEVERITY = 12.0, 0.8


@pytest.fixture(scope="module")
def leaking() -> Samples:
    scenario = Scenario(
        duration=30.0, seed=4, duty={"name": "steps", "amplitude": 0.04, "hold": 1.0},
        load={"name": "spring"}, faults=[{"fault": "internal_leakage", "severity": SEVERITY, "onset": ONSET}],
    )  # fmt: skip
    return simulate(Unit.load("axis_a"), scenario).samples


@pytest.fixture(scope="module")
def whole(leaking, tiny_model) -> Row:
    return log_features(leaking, Unit.load("axis_a"), tiny_model)[1]


def test_the_fits_are_those_that_the_answer_was_made_of(leaking, whole, tiny_model):
    pipeline = Pipeline(Unit.load("axis_a"), tiny_model)
    pipeline.push(leaking)
    (found, *_) = pipeline.finish().faults
    assert found.fault == "internal_leakage" and found.severity is not None
    assert whole["severity_internal_leakage"] == pytest.approx(found.severity, abs=5e-4)
    low, high = found.severity_interval or (math.nan, math.nan)
    assert low < SEVERITY < high
    # The interval of 80 % (1.2816 standard deviations) holds the model's own doubt besides.
    own = math.log1p((whole["severity_internal_leakage_std"] / found.severity) ** 2)
    spread = math.sqrt(own + tiny_model.calibration.severity_doubt**2)
    assert math.log(high / found.severity) == pytest.approx(1.2816 * spread, abs=2e-3)
    for name in {f.hypothesis.fault for f in pipeline.fitted}:
        leading = max((f for f in pipeline.fitted if f.hypothesis.fault == name), key=lambda f: f.gain)
        told = whole[f"severity_{name}"], whole[f"score_{name}"]
        assert told == (leading.active_amplitude, leading.score)
    assert len({f.hypothesis.fault for f in pipeline.fitted}) < len(pipeline.fitted), "sides and channels"
    told = next(re.search(r"log likelihood ratio ([\d.]+)", s) for s in found.evidence)
    assert told is not None and float(told[1]) == pytest.approx(whole["score_internal_leakage"], abs=0.05)
    others = [whole[n] for n in FEATURES if n.startswith("score_") and n != "score_internal_leakage"]
    assert whole["score_internal_leakage"] > 10.0 and max(others) <= whole["score_internal_leakage"]


def test_what_a_log_does_not_have_is_not_told(leaking, whole, tiny_model):
    few = Samples(leaking.time, {n: leaking[n] for n in ("pump_angle", "position", "pressure_difference")})
    _, row = log_features(few, Unit.load("axis_a"), tiny_model)
    assert row.keys() == whole.keys() == FEATURES.keys()
    has = {n.removeprefix("has_") for n, v in row.items() if n.startswith("has_") and v}
    assert has == {"pump_angle", "position", "pressure_difference"}
    assert math.isnan(row["misfit_torque"]) and math.isnan(row["oil_temperature_mean"])
    assert not math.isnan(whole["misfit_torque"]) and whole["score_internal_leakage"] != 0.0


def test_duty_is_that_of_the_samples(tiny_model):
    """A pump at half of its largest speed for a quarter of the time; a dead channel has no value."""
    unit = Unit.load("axis_a")
    time = np.arange(0.0, 4.0, 1e-3)
    speed = np.where(time < 1.0, 0.5 * unit.drive.max_speed, 0.0)
    samples = Samples(time, {
        "pump_speed": speed, "position": np.linspace(-0.25, 0.25, time.size) * unit.cylinder.stroke,
        "pressure_1": np.full(time.size, 3e5), "pressure_2": np.full(time.size, 5e5),
        "oil_temperature": np.full(time.size, np.nan),
    })  # fmt: skip
    pipeline = Pipeline(unit, tiny_model, keep_trajectories=False)
    pipeline.push(samples)
    row = features_of(pipeline, pipeline.finish(), samples)
    assert row["moving_share"] == pytest.approx(0.25) and row["rate"] == pytest.approx(1000.0)
    assert row["pump_speed_rms"] == pytest.approx(0.25 * unit.drive.max_speed)
    assert row["stroke_share"] == pytest.approx(0.5)
    assert row["pressure_difference_rms"] == pytest.approx(2e5) == row["pressure_difference_p95"]
    assert row["has_oil_temperature"] == 0.0 and math.isnan(row["oil_temperature_mean"])
    assert math.isnan(row["score_internal_leakage"]), "four seconds say nothing"


SPLITS = ("train", "validation", "test")


@given(st.integers(3, 200), st.integers(0, 2**32))
def test_units_are_divided_three_to_one_to_one(count, seed):
    units = [f"unit_{k:03d}" for k in range(count)]
    split = split_of(units, seed)
    assert list(split) == units and split == split_of(units[::-1], seed)
    sizes = [sum(s == name for s in split.values()) for name in SPLITS]
    assert sizes[1] == sizes[2] == max(round(count / 5), 1) and sizes[0] > 0


def test_arrays_are_the_rows_of_a_split(few, few_features):
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


def test_the_truth_is_that_of_the_labels(few):
    data = load_dataset(few)
    labels = json.loads((few / "labels.json").read_text())
    assert data.truth["file"].tolist() == [x["file"] for x in labels]
    for row, label in zip(data.truth.itertuples(), labels, strict=True):
        fault = label["faults"][0] if label["faults"] else None
        assert row.fault == (fault["fault"] if fault else "healthy")
        assert row.severity == (fault["severity"] if fault else 0.0)
        assert row.true_leakage == label["truth_medians"]["leakage"]
    assert "no features; make them with: fdd features" in refused(data.arrays)


def test_a_changed_log_is_seen_before_it_is_read_and_features_of_other_data_are_refused(
    few, tmp_path, few_features
):
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
