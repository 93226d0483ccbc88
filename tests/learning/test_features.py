"""Features against the answer that they come from, against truth, and against a hand's calculation."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from fdd.diagnosis.model import Model
from fdd.diagnosis.pipeline import Pipeline
from fdd.learning.features import FEATURES, Row, features_of, log_features
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit

ONSET, SEVERITY = 12.0, 0.8


@pytest.fixture(scope="module")
def leaking() -> Samples:
    scenario = Scenario(
        duration=30.0, seed=4, duty={"name": "steps", "amplitude": 0.04, "hold": 1.0},
        load={"name": "spring"}, faults=[{"fault": "internal_leakage", "severity": SEVERITY, "onset": ONSET}],
    )  # fmt: skip
    return simulate(Unit.load("axis_a"), scenario).samples


@pytest.fixture(scope="module")
def whole(leaking: Samples, tiny_model: Model) -> Row:
    return log_features(leaking, Unit.load("axis_a"), tiny_model)[1]


def test_the_fits_are_those_that_the_answer_was_made_of(
    leaking: Samples, whole: Row, tiny_model: Model
) -> None:
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


def test_what_a_log_does_not_have_is_not_told(leaking: Samples, whole: Row, tiny_model: Model) -> None:
    few = Samples(leaking.time, {n: leaking[n] for n in ("pump_angle", "position", "pressure_difference")})
    _, row = log_features(few, Unit.load("axis_a"), tiny_model)
    assert row.keys() == whole.keys() == FEATURES.keys()
    has = {n.removeprefix("has_") for n, v in row.items() if n.startswith("has_") and v}
    assert has == {"pump_angle", "position", "pressure_difference"}
    assert math.isnan(row["misfit_torque"]) and math.isnan(row["oil_temperature_mean"])
    assert not math.isnan(whole["misfit_torque"]) and whole["score_internal_leakage"] != 0.0


def test_duty_is_that_of_the_samples(tiny_model: Model) -> None:
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
