"""The steps are short enough: against shorter ones, and against a reference solver of another kind."""

from itertools import pairwise

import numpy as np
import pytest

from fdd.plant import state as s
from reports.plant.cases import Case, Cases
from reports.plant.numerics import against_half_steps, against_radau

CASES = {case.name: case for case in Cases().numerics}


@pytest.mark.parametrize("name", CASES)
def test_half_the_step_changes_no_sensor_by_a_tenth_of_its_noise(name):
    """The numerics alone, without the encoder's steps in the loop; `python -m reports plant` runs longer."""
    difference = against_half_steps(CASES[name].without_encoder_steps(), 4.0)
    assert set(difference.rms) >= {"position", "pressure_difference", "pump_speed", "motor_current"}
    assert difference.worst < 0.1
    assert difference.rms["pressure_difference"] < 1e-3
    # Far finer than noise: 65536 counts a turn, and nothing brings the angle back.
    assert difference.rms["pump_angle"] < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "duration"),
    [
        ("prbs, stiffest bristles", 0.25),
        ("prbs of speed, coupling and check valve", 0.25),
        ("flight, gust, aeration", 0.25),
    ],
)
def test_radau_agrees_within_a_tenth_of_the_sensors(name, duration):
    """SciPy's implicit solver on the same right-hand side and commands, tolerance 1e-10."""
    case = CASES[name]
    states, _ = case.states(duration)
    assert np.ptp(states[:, s.X]) > 1e-4
    difference = against_radau(case, duration)
    assert difference.worst < 0.1
    assert difference.rms["pump_angle"] < 0.5


def _errors(case: Case, refinements: list[float]) -> list[float]:
    reference = case.states(0.5, 32.0)[0]
    pressure = s.SHARED + s.P1
    return [
        float(np.sqrt(np.mean((case.states(0.5, refine)[0] - reference)[:, pressure] ** 2)))
        for refine in refinements
    ]


def test_refining_converges_fast():
    """Each halving takes the error down by far more than a second-order rule's four, on the whole."""
    errors = _errors(Cases().work, [0.5, 1.0, 2.0, 4.0, 8.0])
    assert all(finer < coarser for coarser, finer in pairwise(errors))
    assert errors[0] / errors[-1] > 8.0**4
    assert errors[1] < 1.0
