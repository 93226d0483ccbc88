"""Frequency responses against systems whose answer is known in closed form."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from reports.thesis.runs import (
    TransferFunction,
    empirical_response,
    fit_output_error,
    held_input,
    response_at,
    velocity,
)

T = 1e-3
LOW = TransferFunction((1.08e-2, 2.562, 242.6), (1.0, 144.8, 1.66e4, 6.50e5), 0.01)
"""Eq. 6.12 of the thesis."""


@pytest.fixture(scope="module")
def command() -> np.ndarray:
    rng = np.random.default_rng(5)
    time = np.arange(8000) * T
    return 47.0 * np.sin(2 * np.pi * (0.1 + 60.0 * time / 8.0) * time) + 8.0 * rng.choice([-1.0, 1.0], 8000)


def integrated_output(model: TransferFunction, command: np.ndarray) -> np.ndarray:
    """∫ output by exact discretisation of model/s for the held command: no part of the code under test."""
    top, bottom, _ = cont2discrete(
        (np.array(model.numerator), np.polymul(model.denominator, [1.0, 0.0])), T, method="zoh"
    )
    late = round(model.delay / T)
    held = np.concatenate([np.zeros(late), command[: command.size - late]])
    return lfilter(np.ravel(top), bottom, held)


def test_the_thesis_model_is_found_again_with_its_delay(command):
    """From positions of a simulated eq. 6.12, differenced and filtered like a log's."""
    output = velocity(integrated_output(LOW, command))
    given = held_input(command)
    fits = {d: fit_output_error(given, output, zeros=2, poles=3, delay=d * T) for d in (9, 10, 11)}
    best = max(fits, key=lambda d: fits[d][1])
    assert best == 10
    model, fit = fits[10]
    assert fit > 0.999
    np.testing.assert_allclose(np.sort_complex(model.poles), np.sort_complex(LOW.poles), rtol=0.01)
    assert model.gain == pytest.approx(LOW.gain, rel=1e-3)
    # 16.77 Hz of eq. 6.12, which the thesis prints as 16.8.
    assert model.bandwidth_hz() == pytest.approx(16.8, abs=0.1)


def test_single_sine_and_etfe_give_the_response(command):
    frequency, response = empirical_response(
        held_input(command), velocity(integrated_output(LOW, command)), width_hz=0.5
    )
    for hz in (5.0, 12.0, 20.0):
        near = int(np.argmin(np.abs(frequency - hz)))
        assert abs(response[near] / LOW.at(hz) - 1.0) < 0.05
        time = np.arange(3000) * T
        sine = np.sin(2 * np.pi * hz * time)
        output = velocity(integrated_output(LOW, sine))
        part = slice(1000, 2800)
        single = response_at(held_input(sine)[part], output[part], hz)
        assert abs(single / complex(LOW.at(hz)) - 1.0) < 0.01
