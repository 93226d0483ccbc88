"""A leaking run with everything a real log has, and a clock that need not be waited for."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fdd.plant.load import SpringLoad
from fdd.plant.scenario import Scenario
from fdd.plant.simulate import simulate
from fdd.samples import Samples
from fdd.unit import Unit


class FakeClock:
    """Time passes only by sleeping."""

    def __init__(self) -> None:
        self.time = 100.0
        self.slept: list[float] = []

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.time += max(seconds, 0.0)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture(scope="session")
def unit() -> Unit:
    return Unit.load("axis_a")


@pytest.fixture(scope="session")
def leaking(unit: Unit) -> Samples:
    """14 s, leaking from 5 s on, with dropped rows and bursts of NaN."""
    fault = {"fault": "internal_leakage", "severity": 0.9, "onset": 5.0}
    recording = {"dropped": 0.002, "late": 0.001, "nan_bursts_per_minute": 12.0}
    duty = {"name": "steps", "amplitude": 0.04, "hold": 1.0}
    scenario = Scenario(
        duration=14.0, duty=duty, load=SpringLoad(), faults=[fault], recording=recording, seed=11
    )
    return simulate(unit, scenario).samples


@pytest.fixture(scope="session")
def leaking_lines(leaking: Samples) -> bytes:
    """Samples as a machine would stream them: missing values are null or left out by turns."""
    rows = []
    for k in range(len(leaking)):
        row: dict[str, float | None] = {"time": float(leaking.time[k])}
        for name in leaking.channels:
            value = float(leaking[name][k])
            if np.isfinite(value):
                row[name] = value
            elif k % 2:
                row[name] = None
        rows.append(json.dumps(row))
    return ("\n".join(rows) + "\n").encode()
