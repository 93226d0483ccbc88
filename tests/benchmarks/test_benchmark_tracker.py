"""Speed, side by side with peers in one run: ``pytest tests/benchmarks --benchmark-enable``.

Without that option every benchmark runs once, as a test that it still works. The peers must do the same
work: filterpy's filter and the C++ program end where the tracker does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from estimators.eha import bounds, layout, model, walk
from estimators.eha.tracker import EhaTracker
from fdd.diagnosis.pipeline import Pipeline
from fdd.plant.scenario import Recording, Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import Channels, Tracking
from fdd.samples import Samples
from fdd.unit import Unit
from reports.estimators import speed
from reports.estimators.speed.cpp import Program, Unavailable
from reports.estimators.speed.peers import run_filterpy

pytestmark = pytest.mark.slow
METHODS = ["ekf", "svsf"]


@pytest.fixture(scope="module")
def samples() -> Samples:
    return simulate(Unit.load("axis_a"), Scenario(duration=10.0, seed=1, load={"name": "spring"})).samples


@pytest.fixture(scope="module")
def program() -> Program:
    """The C++ peer, optimised a little: that is enough to compare results, and compiles faster."""
    try:
        return Program(flags=("-std=c++17", "-O1"))
    except Unavailable as missing:
        pytest.skip(str(missing))


@pytest.mark.parametrize("method", METHODS)
def test_tracker(benchmark: Any, samples: Samples, method: str) -> None:
    tracking = Tracking(Unit.load("axis_a"), Channels.of(samples), 1e-3)
    block, tracker = tracking.block(samples), tracking.trackers[method]
    start = tracker.state()
    tracker.push(block)

    def run() -> None:
        tracker.restore(start)
        tracker.push(block)

    benchmark.extra_info["samples"] = len(samples)
    benchmark(run)
    assert np.isfinite(tracker.x).all()


def test_filterpy_of_the_same_size(benchmark: Any) -> None:
    """It starts where the tracker is, does the same work, and ends where the tracker does."""
    trackers, block = speed.log(3.0)
    tracker = trackers["ekf"]
    tracker.push(block[: speed.WARM_UP])
    rest = block[speed.WARM_UP : speed.WARM_UP + 500]
    benchmark.extra_info["samples"] = len(rest)
    peer = benchmark(lambda: run_filterpy(tracker, rest))
    tracker.push(rest)
    spread = np.sqrt(np.diag(tracker.P))
    np.testing.assert_allclose((peer.x - tracker.x) / spread, 0.0, atol=1e-6)
    np.testing.assert_allclose(peer.variances, np.diag(tracker.P), rtol=1e-6)


def missing_and_late(method: str, without: tuple[str, ...] = ()) -> tuple[EhaTracker, np.ndarray]:
    """A log with dropped, late and missing samples, and what tracks it."""
    recording = Recording(dropped=0.05, late=0.02, nan_bursts_per_minute=60.0)
    leak = {"fault": "internal_leakage", "severity": 0.6, "onset": 3.0}
    scenario = Scenario(duration=10.0, duty={"name": "sines"}, faults=[leak], recording=recording)
    samples = simulate(Unit.load("axis_a"), scenario).samples
    channels = Channels(tuple(name for name in Channels.of(samples).names if name not in without))
    tracking = Tracking(Unit.load("axis_a"), channels, 1e-3, decimation=1)
    return tracking.trackers[method], tracking.block(samples)


def ends_where_the_tracker_does(
    program: Program, tracker: EhaTracker, block: np.ndarray, dense: bool
) -> np.ndarray:
    """Records of the tracker, after comparing."""
    found = program.run(tracker, block, dense=dense)
    records = tracker.push(block)
    spread = np.sqrt(np.diag(tracker.P))
    # To 1e-9 of themselves, or of their standard deviation where they are near zero.
    assert (np.abs(found.x - tracker.x) <= 1e-9 * np.abs(tracker.x) + 1e-8 * spread).all()
    np.testing.assert_allclose(found.variances, np.diag(tracker.P), rtol=1e-8)
    assert found.log_likelihood == pytest.approx(records["log_likelihood"].sum(), rel=1e-8)
    return records


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_cpp_ends_where_the_tracker_does(program: Program, method: str, dense: bool) -> None:
    tracker, block = missing_and_late(method)
    assert np.isnan(block[:, [layout.POSITION, layout.PRESSURE_1]]).any()
    records = ends_where_the_tracker_does(program, tracker, block, dense)
    scores = records["score"]
    assert np.abs(scores).max() > walk.JUMP_SIGMAS  # the leak set the parameters free
    valves = records["state"][:, model.VALVE1]
    assert (valves == bounds.LOWEST[model.VALVE1]).any()


@pytest.mark.parametrize("method", METHODS)
def test_cpp_follows_with_the_fewest_sensors(program: Program, method: str) -> None:
    """Speed instead of the angle, the pressures' difference instead of both; fixed states stay."""
    tracker, block = missing_and_late(
        method, ("pump_angle", "pressure_1", "pressure_2", "pressure_accumulator")
    )
    ends_where_the_tracker_does(program, tracker, block, dense=False)
    assert tracker.P[model.SPLIT, model.SPLIT] == 0.0


def test_table_has_every_peer_or_says_why_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(*_: object) -> Program:
        raise Unavailable("no C++ compiler on this machine")

    monkeypatch.setattr(speed, "Program", absent)
    table = speed.measure(2.0, repeats=1, peer_samples=200)
    rows = {row.name: row for row in table.rows}
    assert rows["EKF"].ratio == 1.0
    assert rows["filterpy EKF"].ratio > 10.0
    assert np.isnan(rows["C++ EKF"].microseconds)
    assert rows["C++ EKF"].note == table.compiler == "no C++ compiler on this machine"


def test_pipeline(benchmark: Any, samples: Samples) -> None:
    unit = Unit.load("axis_a")

    def run() -> str:
        pipeline = Pipeline(unit)
        pipeline.push(samples)
        return pipeline.finish().verdict

    benchmark.extra_info["samples"] = len(samples)
    assert benchmark(run) in ("healthy", "faulty", "inconclusive")
