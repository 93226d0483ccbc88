"""One unit with a baseline, and what the pipeline says of its logs: shared by all tests of the pipeline."""

from collections.abc import Callable

import pytest
from simulated_logs import HEALTHY, simulated

from fdd import Diagnosis, Pipeline, Samples, Unit
from fdd.diagnosis.baseline import add_baseline

Answer = Callable[[Samples], Diagnosis]


@pytest.fixture(scope="session")
def unit() -> Unit:
    """Axis A with the baseline of three healthy logs."""
    return add_baseline(Unit.load("axis_a"), [simulated(seed, load) for seed, load in HEALTHY])


@pytest.fixture(scope="session")
def leaking() -> Samples:
    return simulated(11, "spring", "internal_leakage")


@pytest.fixture(scope="session")
def answer(unit: Unit) -> Answer:
    """What the pipeline says of a whole log; asked once for each log."""
    known: dict[int, tuple[Samples, Diagnosis]] = {}

    def asked(samples: Samples) -> Diagnosis:
        if id(samples) not in known:
            pipeline = Pipeline(unit, keep_trajectories=False)
            pipeline.push(samples)
            known[id(samples)] = samples, pipeline.finish()
        return known[id(samples)][1]

    return asked
