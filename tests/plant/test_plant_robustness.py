"""Whatever the rig allows stays within physics; `python -m reports plant` tries two thousand."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from fdd.plant import state as s
from fdd.plant.simulate import raw_blocks
from reports.plant import wild as robustness
from reports.plant.wild import draw_wild, try_wild


@settings(max_examples=12, phases=[Phase.generate])  # a smaller number is no simpler scenario
@given(seed=st.integers(0, 10**6))
def test_wild_runs_stay_within_physics(seed):
    outcome = try_wild(seed, duration=2.0)
    assert outcome.failures == []
    assert outcome.lowest_pressure > 0.0


@pytest.mark.parametrize("seed", [1730, 1955, 1048])
def test_wild_runs_that_once_failed(seed):
    """1730: one connect line alone stacks relief settings. 1955: a degraded motor ran away. 1048: corners
    that too few nodes of the energy's quadrature miss."""
    assert try_wild(seed).failures == []


def test_the_check_sees_what_is_wrong():
    """A negative pressure, a piston outside and a runaway motor are each told."""
    wild = draw_wild(5)
    ready = wild.prepared()
    raw = next(iter(raw_blocks(ready, block=wild.scenario.rows)))
    sound = raw.states.copy()
    for column, value, told in (
        (s.SHARED + s.P1, -1e6, "absolute pressure"),
        (s.X, 1.0, "beyond the stop"),
        (s.SHARED + s.SPEED, 5e3, "motor"),
        (s.SHARED + s.P1, np.nan, "NaN"),
    ):
        raw.states[:] = sound
        raw.states[-1, column] = value
        failures = robustness._checked(5, wild, ready, raw).failures
        assert any(told in failure for failure in failures), told
