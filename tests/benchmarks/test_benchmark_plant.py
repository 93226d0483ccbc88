"""Speed of the plant: ``pytest tests/benchmarks --benchmark-enable``; peers: ``python -m reports plant``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fdd.plant.simulate import raw_blocks, simulate
from reports.plant.cases import Cases
from reports.plant.numerics import METHODS, integrate

pytestmark = pytest.mark.slow
CASES = {case.name: case for case in Cases().speed}


@pytest.mark.parametrize("name", CASES)
def test_simulate(benchmark: Any, name: str) -> None:
    case = CASES[name]
    scenario = case.scenario(5.0, whole=False)
    benchmark.extra_info["simulated_s"] = 5.0
    out = benchmark(simulate, case.unit, scenario, partner=case.partner)
    assert np.isfinite(out.truth["position"]).all()


@pytest.mark.parametrize("name", ["sines", "two axes, sines"])
def test_integration(benchmark: Any, name: str) -> None:
    case = CASES[name]
    benchmark.extra_info["simulated_s"] = 5.0

    def run() -> bool:
        return all(bool(np.isfinite(block.states).all()) for block in raw_blocks(case.prepared(5.0)))

    assert benchmark(run)


@pytest.mark.parametrize("method", METHODS)
def test_peer(benchmark: Any, method: str) -> None:
    """The same right-hand side, a tenth of a second; where nothing is timed, less."""
    case, (seconds, tolerance) = Cases().work, (0.1, 1e-6) if benchmark.enabled else (0.02, 1e-2)
    _, commands = case.states(seconds)
    benchmark.extra_info["simulated_s"] = seconds
    states, _ = benchmark(integrate, case, commands, method, tolerance, 1.0, seconds)
    assert np.isfinite(states).all()
