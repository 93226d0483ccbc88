"""Speed of tracker and pipeline: ``pytest tests/benchmarks --benchmark-enable``.

Without that option every benchmark runs once, as a test that it still works. `python -m reports
estimators` has filterpy beside the tracker.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fdd.diagnosis.pipeline import Pipeline
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.residuals.tracking import Channels, Tracking
from fdd.samples import Samples
from fdd.unit import Unit

pytestmark = pytest.mark.slow
METHODS = ["ekf", "svsf"]


@pytest.fixture(scope="module")
def samples() -> Samples:
    return simulate(Unit.load("axis_a"), Scenario(duration=10.0, seed=1, load={"name": "spring"})).samples


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


def test_pipeline(benchmark: Any, samples: Samples) -> None:
    unit = Unit.load("axis_a")

    def run() -> str:
        pipeline = Pipeline(unit)
        pipeline.push(samples)
        return pipeline.finish().verdict

    benchmark.extra_info["samples"] = len(samples)
    assert benchmark(run) in ("healthy", "faulty", "inconclusive")
