"""Settings that all tests share."""

from __future__ import annotations

import pytest
from hypothesis import settings

from fdd.diagnosis.model import AlarmTail, Calibration, Model

# The same examples on every run, and no deadlines: the first call of a compiled function takes seconds.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def tiny_model() -> Model:
    """A model of round numbers for tests of what stands around the evidence; no word on accuracy."""
    return Model(
        data="made up for tests",
        tail=AlarmTail(height=3.0, rate_per_hour=4.0, scale=1.0, hours=1.0),
        calibration=Calibration(midpoint=3.0, slope=1.0),
    )
