"""Healthy logs of random units, simulated and identified once for the whole folder."""

from __future__ import annotations

import pytest
from made_units import SEEDS, Case, calibration_logs, random_unit

from fdd.identification.identify import identify_unit
from fdd.unit import Unit


@pytest.fixture(scope="session")
def cases() -> dict[int, Case]:
    made = {}
    for seed in SEEDS:
        truth, base = random_unit(seed), Unit.load("axis_a")
        logs = calibration_logs(truth, seed)
        made[seed] = Case(truth, base, logs, identify_unit(logs, base, name=f"unit {seed}"))
    return made


@pytest.fixture(params=SEEDS)
def case(request: pytest.FixtureRequest, cases: dict[int, Case]) -> Case:
    return cases[request.param]
