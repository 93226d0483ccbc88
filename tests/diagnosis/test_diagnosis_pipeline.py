"""The pipeline's promises: cuts into blocks and restarts change nothing, and it finds what is there."""

from __future__ import annotations

import io
import itertools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fdd.diagnosis.pipeline import Pipeline
from fdd.errors import InputError
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit


@pytest.fixture(scope="module")
def unit() -> Unit:
    return Unit.load("axis_a")


@pytest.fixture(scope="module")
def leaking(unit: Unit) -> Samples:
    fault = {"fault": "internal_leakage", "severity": 0.8, "onset": 12.0}
    scenario = Scenario(duration=26.0, seed=11, load={"name": "spring"}, faults=[fault])
    return simulate(unit, scenario).samples


@pytest.fixture(scope="module")
def healthy(unit: Unit) -> Samples:
    return simulate(unit, Scenario(duration=26.0, seed=12, load={"name": "spring"})).samples


def answer(pipeline: Pipeline) -> str:
    return pipeline.finish().model_dump_json(by_alias=True)


def pushed(unit: Unit, samples: Samples, cuts: list[int]) -> Pipeline:
    pipeline = Pipeline(unit)
    edges = [0, *sorted(cuts), len(samples)]
    for start, stop in itertools.pairwise(edges):
        pipeline.push(samples.rows(start, stop))
    return pipeline


def test_finds_a_leak(unit: Unit, leaking: Samples) -> None:
    pipeline = Pipeline(unit)
    live = pipeline.push(leaking)
    found = pipeline.finish()
    assert found.verdict == "faulty"
    (fault,) = found.faults
    assert fault.family == "leakage"
    assert fault.fault == "internal_leakage"
    assert "pump_wear" in fault.ambiguity
    assert abs(fault.onset_s - 12.0) < 2.0
    assert 12.0 < fault.detected_s < 20.0
    assert fault.severity == pytest.approx(0.8, abs=0.2)
    assert [f.detected_s for f in live] == [fault.detected_s]
    assert sum(found.probabilities.values()) == pytest.approx(1.0, abs=1e-3)
    assert fault.evidence and "leakage" in fault.evidence[0].lower()


def test_quiet_on_a_healthy_log(unit: Unit, healthy: Samples) -> None:
    pipeline = Pipeline(unit)
    assert pipeline.push(healthy) == []
    assert pipeline.finish().verdict == "healthy"


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(st.integers(1, 25_000), max_size=12))
def test_blocks_do_not_matter(unit: Unit, leaking: Samples, cuts: list[int]) -> None:
    whole = pushed(unit, leaking, [])
    parts = pushed(unit, leaking, [c for c in cuts if c < len(leaking)])
    assert answer(parts) == answer(whole)
    one, other = whole.trajectories(), parts.trajectories()
    for name in ("time", "window_time", "features", "statistic"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for method in one.estimates:
        for name in one.estimates[method]:
            np.testing.assert_array_equal(one.estimates[method][name], other.estimates[method][name])


def test_single_samples_are_blocks_too(unit: Unit, healthy: Samples) -> None:
    short = healthy.rows(0, 7_000)
    whole = pushed(unit, short, [])
    single = pushed(unit, short, list(range(1, 900)))
    assert answer(single) == answer(whole)


@pytest.mark.parametrize("at", [100, 5_000, 16_000])
def test_goes_on_after_a_restart(unit: Unit, leaking: Samples, at: int) -> None:
    whole = pushed(unit, leaking, [])
    before = Pipeline(unit)
    before.push(leaking.rows(0, at))
    file = io.BytesIO()
    np.savez(file, **before.state())
    file.seek(0)
    after = Pipeline(unit)
    with np.load(file, allow_pickle=False) as saved:
        after.restore(dict(saved))
    after.push(leaking.rows(at, len(leaking)))
    assert answer(after) == answer(whole)


def test_the_answer_tells_what_the_trajectories_end_with(unit: Unit, leaking: Samples) -> None:
    pipeline = pushed(unit, leaking, [])
    found, over_time = pipeline.finish().estimates, pipeline.trajectories()
    for name, estimate in found.items():
        assert estimate.observable == bool(over_time.observable[name][-1])
        for told, column in (
            (estimate.held, over_time.held), (estimate.held_std, over_time.held_std),
            (estimate.information_std, over_time.information_std),
        ):  # fmt: skip
            last = column[name][-1]
            assert told == (pytest.approx(last, rel=1e-4) if np.isfinite(last) else None)
    assert found["leakage"].held == found["leakage"].value and found["leakage"].age_s == 0.0


def test_state_of_another_unit_is_refused(unit: Unit, healthy: Samples) -> None:
    pipeline = pushed(unit, healthy.rows(0, 3_000), [])
    with pytest.raises(InputError, match="axis_a"):
        Pipeline(Unit.load("axis_b")).restore(pipeline.state())


def test_fault_from_the_first_second(unit: Unit) -> None:
    fault = {"fault": "aeration", "severity": 0.8, "onset": 0.0}
    samples = simulate(unit, Scenario(duration=20.0, seed=3, load={"name": "spring"}, faults=[fault])).samples
    pipeline = Pipeline(unit)
    pipeline.push(samples)
    found = pipeline.finish()
    assert [f.family for f in found.faults] == ["aeration"]
    assert found.faults[0].onset_s < 4.0


def test_survives_a_hole_in_the_log(unit: Unit, leaking: Samples) -> None:
    parts = [leaking.rows(0, 6_000), leaking.rows(10_000, len(leaking))]
    pipeline = Pipeline(unit)
    for part in parts:
        pipeline.push(part)
    found = pipeline.finish()
    assert [f.family for f in found.faults] == ["leakage"]


def test_inputs_are_not_changed(unit: Unit, healthy: Samples) -> None:
    short = healthy.rows(0, 4_000)
    before = {n: short[n].copy() for n in short.channels}
    text = unit.to_yaml()
    pushed(unit, short, [1_000])
    assert unit.to_yaml() == text
    for name, column in before.items():
        np.testing.assert_array_equal(short[name], column)


def test_blocks_must_be_in_order(unit: Unit, healthy: Samples) -> None:
    pipeline = pushed(unit, healthy.rows(0, 2_000), [])
    with pytest.raises(InputError, match="time order"):
        pipeline.push(healthy.rows(1_000, 3_000))


def test_missing_channels_are_named(unit: Unit) -> None:
    time = np.arange(2_000) * 1e-3
    samples = Samples(time, {"position": np.zeros(2_000), "pump_speed": np.zeros(2_000)})
    with pytest.raises(InputError, match=r"pressure_difference \(or pressure_1"):
        Pipeline(unit).push(samples)


def test_too_little_data_is_inconclusive(unit: Unit, healthy: Samples) -> None:
    found = pushed(unit, healthy.rows(0, 3_000), []).finish()
    assert found.verdict == "inconclusive"
    assert "a verdict needs" in found.quality.notes[0]


def test_monitor_memory_is_bounded(unit: Unit, healthy: Samples) -> None:
    pipeline = Pipeline(unit, keep_trajectories=False)
    sizes = []
    for part in healthy.blocks(1_000):
        pipeline.push(part)
        sizes.append(sum(a.nbytes for k, a in pipeline.state().items() if not k.startswith("window")))
    assert sizes[-1] < 1.5 * sizes[8]
