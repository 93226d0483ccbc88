"""Onset, families' probabilities, ambiguity groups and severities."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fdd.diagnosis.isolability import ambiguity_group
from fdd.diagnosis.model import Model
from fdd.diagnosis.sequential import PageTest
from fdd.diagnosis.verdict import evidence, family_probabilities, onset_time, severity
from fdd.faults import CATALOGUE, FAMILIES, faults_of
from fdd.residuals.features import FEATURES
from fdd.unit import Unit


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.load()


@pytest.mark.parametrize("change", [6, 20, 41])
def test_onset_is_where_the_windows_change(change: int) -> None:
    times = 4.0 + 0.5 * np.arange(60)
    healthy = np.where(np.arange(60) < change, 0.95, 0.05)
    assert onset_time(times, healthy, 0.0) == pytest.approx(times[change] - 1.25)


def test_onset_of_a_fault_from_the_start() -> None:
    times = 4.0 + 0.5 * np.arange(30)
    assert onset_time(times, np.full(30, 0.05), 1.0) == 1.0


@pytest.mark.parametrize("statistic", [0.0, 5.0, 30.0])
def test_probabilities_are_a_distribution(model: Model, statistic: float) -> None:
    test = PageTest(8.0, hop_s=0.0)
    for k in range(40):
        test.step(statistic / 20.0, float(k))
    rng = np.random.default_rng(0)
    windows = rng.dirichlet(np.ones(len(model.classes)), size=10)
    found = family_probabilities(model, windows, test)
    assert tuple(found) == FAMILIES
    assert sum(found.values()) == pytest.approx(1.0)
    assert all(0.0 <= p <= 1.0 for p in found.values())
    assert (found["healthy"] > 0.5) == (not test.alarmed)


@pytest.mark.parametrize("family", [f for f in FAMILIES if f not in ("healthy",)])
@pytest.mark.parametrize("channels", [("pressure_difference",), ("pressure_1", "pressure_2")])
def test_ambiguity_groups_are_of_the_catalogue(family: str, channels: tuple[str, ...]) -> None:
    group = ambiguity_group(family, channels)
    assert group and set(group) <= set(CATALOGUE)
    assert set(group) <= set(faults_of(family))


def test_fewer_sensors_never_narrow_a_group() -> None:
    full = ("pressure_1", "pressure_2", "pressure_accumulator", "motor_current")
    for family in FAMILIES[1:]:
        assert set(ambiguity_group(family, full)) <= set(ambiguity_group(family, ("pressure_difference",)))


@pytest.mark.parametrize(
    ("fault", "feature", "value", "expected"),
    [
        ("internal_leakage", "leakage", math.log(1.0 + 0.5 * 12.0 / 6.52), 0.5),
        ("seal_wear", "friction", -0.65, 1.0),
        ("seal_wear", "friction", 0.5, 0.5),
        ("pressure_sensor_bias", "redundancy", -2.5, 0.5),
        ("internal_leakage", "leakage", -0.3, 0.0),
    ],
)
def test_severity_is_on_the_catalogues_scale(fault: str, feature: str, value: float, expected: float) -> None:
    features = np.zeros(len(FEATURES))
    features[FEATURES.index(feature)] = value
    assert severity(fault, features, Unit.load("axis_a")) == pytest.approx(expected, abs=0.01)


def test_evidence_has_figures(model: Model) -> None:
    features = np.zeros(len(FEATURES))
    features[FEATURES.index("compliance")] = math.log(2.0)
    sentences = evidence(model, features)
    assert "2.00 times as compliant" in sentences[0]
    assert all(any(c.isdigit() for c in s) for s in sentences)
