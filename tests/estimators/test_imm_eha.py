"""The bank on an electro-hydrostatic actuator whose leakage switches between published levels.

Parameters and input are those of the McMaster prototype (Gadsden, Song and Habibi 2013,
doi 10.1109/TMECH.2013.2253616; the minor leak could not be checked against the source). The plant shares them
with the filters, and no code: it integrates pressure, motion and Coulomb friction with sticking at
50 kHz, where the filters take one Euler step of the third-order model at 1 kHz.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from estimators import IMM, SVSF, ExtendedKalmanFilter, transition_matrix

AREA, DISPLACEMENT, VOLUME, BULK_MODULUS, MASS, PERIOD = 1.52e-3, 5.57e-7, 1.08e-3, 2.07e8, 7.376, 1e-3
QUADRATIC, VISCOUS, COULOMB = 6.589e4, 2.144e3, 436.0  # N s²/m², N s/m, N
# Normal, minor, major: coefficient in m³/(s Pa) and the offset in m³/s that turns with the pressure.
LEAKAGE = [(4.78e-12, 2.41e-6), (2.52e-11, 1.38e-5), (6.01e-11, 1.47e-5)]
STIFFNESS = AREA * BULK_MODULUS / VOLUME
NOISE = np.array([1e-6, 2e-3, 7e3])  # m, m/s, Pa


def simulated(speed: np.ndarray, mode: np.ndarray, substeps: int = 50) -> np.ndarray:
    """Position, speed and differential pressure at each ms; a semi-implicit step every 20 µs."""
    x = v = p = 0.0
    h = PERIOD / substeps
    rows = np.empty((speed.size, 3))
    for k in range(speed.size):
        coefficient, offset = LEAKAGE[mode[k]]
        for _ in range(substeps):
            leak = coefficient * p + offset * math.tanh(p / 1e4)
            p += h * BULK_MODULUS / VOLUME * (DISPLACEMENT * speed[k] - AREA * v - leak)
            free = v + h / MASS * (AREA * p - QUADRATIC * v * abs(v) - VISCOUS * v)
            # Coulomb friction can stop the rod in this step, not turn it: what cannot break away sticks.
            v = math.copysign(max(abs(free) - h * COULOMB / MASS, 0.0), free)
            x += h * v
        rows[k] = x, v, p
    return rows


def friction(v: float) -> float:
    return QUADRATIC * v * abs(v) + VISCOUS * v + COULOMB * np.sign(v)


def pressure(x: np.ndarray) -> float:
    return (MASS * x[2] + friction(x[1])) / AREA


def mode_filter(kind: type, coefficient: float, offset: float, **options) -> ExtendedKalmanFilter:
    """States position, speed, acceleration; position, speed and differential pressure are measured."""

    def f(x, u, dt):
        flow = DISPLACEMENT * u - AREA * x[1] - coefficient * pressure(x) - offset * np.sign(pressure(x))
        jerk = STIFFNESS / MASS * flow - (2.0 * QUADRATIC * abs(x[1]) + VISCOUS) / MASS * x[2]
        return x + dt * np.array([x[1], x[2], jerk])

    def F(x, u, dt):
        slope = 2.0 * QUADRATIC * abs(x[1]) + VISCOUS
        by_speed = -STIFFNESS / MASS * (AREA + coefficient * slope / AREA)
        by_speed -= 2.0 * QUADRATIC * np.sign(x[1]) * x[2] / MASS
        by_acceleration = -STIFFNESS * coefficient / AREA - slope / MASS
        return np.eye(3) + dt * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, by_speed, by_acceleration]])

    def H(x):
        slope = 2.0 * QUADRATIC * abs(x[1]) + VISCOUS
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, slope / AREA, MASS / AREA]]

    def h(x):
        return [x[0], x[1], pressure(x)]

    kf = kind(3, 3, f=f, h=h, F_jacobian=F, H_jacobian=H, **options)
    kf.x, kf.P, kf.R = np.zeros(3), [1e-6, 1e-3, 1.0], NOISE**2
    # 0.1 m/s² a step for what the model leaves out: the friction that turns over at a reversal.
    kf.Q = np.array([1e-8, 1e-4, 0.1]) ** 2
    return kf


@cache
def recording() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pump speed (rad/s), true mode and true trajectory: normal, major at 1.5 s, minor at 2.75 s."""
    time = PERIOD * np.arange(4000)
    speed = 100.0 * np.sign(np.sin(np.pi * time))
    mode = np.repeat([0, 2, 1], [1500, 1250, 1250])
    return speed, mode, simulated(speed, mode)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (ExtendedKalmanFilter, {}),
        # Layers that nine samples of ten leave, so that the SVSF's own gain is at work.
        (SVSF, {"psi": [2e-6, 0.2, 4e6], "boundary_layer": "variable"}),
    ],
)
def test_a_plant_that_switches_modes_is_followed(kind, options) -> None:
    speed, mode, truth = recording()
    z = truth + NOISE * np.random.default_rng(0).normal(size=truth.shape)
    filters = [mode_filter(kind, *level, **options) for level in LEAKAGE]
    bank = IMM(filters, None, transition_matrix([10.0, 10.0, 10.0], PERIOD))
    probability, x, switched = np.empty(mode.size), np.empty((mode.size, 3)), 0
    for k in range(mode.size):
        bank.predict(speed[k], PERIOD)
        bank.update(z[k])
        probability[k], x[k] = bank.mu[mode[k]], bank.x
        switched += kind is SVSF and bank.filters[mode[k]].switched
    # Odds of 10000 to 1 against a switch are overcome within 20 samples, at 9 to 1 for the new mode.
    for k in (1500, 2750):
        assert np.argmax(probability[k:] > 0.9) + 1 <= 20
    # More than 200 ms after the start, a reversal (each s) or a switch it is sure and right.
    k = np.arange(mode.size)
    since = np.minimum(k % 1000, np.minimum((k - 1500) % 4000, (k - 2750) % 4000))
    settled = since > 200
    assert probability[settled].min() > 0.5
    assert probability[settled].mean() > 0.999
    assert probability.mean() > 0.95
    measured = np.sqrt(np.mean((z - truth)[settled, 1] ** 2))
    assert np.sqrt(np.mean((x - truth)[settled, 1] ** 2)) < 0.15 * measured
    assert (switched > 500) == (kind is SVSF)
