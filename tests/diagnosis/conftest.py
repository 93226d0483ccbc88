"""One unit with a baseline, and a few simulated logs of it that all tests of the pipeline share."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest

from fdd.diagnosis.baseline import add_baseline
from fdd.diagnosis.findings import Diagnosis
from fdd.diagnosis.pipeline import Pipeline
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit

LOADS: dict[str, dict[str, Any]] = {
    "spring": {"name": "spring"}, "push": {"name": "constant"}, "pull": {"name": "constant", "level": -1000.0},
    "gust": {"name": "gust"},
}  # fmt: skip
ONSET_S = 17.3
DURATION_S = 32.0
HEALTHY = ((1, "spring"), (2, "push"), (3, "pull"))

Log = Callable[..., Samples]
Answer = Callable[[Samples], Diagnosis]


@cache
def simulated(seed: int, load: str, fault: str = "", severity: float = 0.7, side: int | None = None) -> Samples:
    """One log of axis A; from `ONSET_S` on with a fault."""
    faults = (
        [{"fault": fault, "severity": severity, "onset": ONSET_S, "side": side}] if fault else []
    )
    scenario = Scenario(duration=DURATION_S, load=LOADS[load], seed=seed, faults=faults)
    return simulate(Unit.load("axis_a"), scenario).samples


@pytest.fixture(scope="session")
def log() -> Log:
    return simulated


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
