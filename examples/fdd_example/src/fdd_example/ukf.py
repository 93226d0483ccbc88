"""filterpy's unscented Kalman filter as a tracker, over a small model of its own.

What the pump has moved less what leaked either moved the piston or is squeezed: out of one chamber, into the
other, so that each takes half of the pressure difference p. Both lie above the accumulator's pressure once
their check valves have filled them.

    dm/dt = D ω - L p,    A x = m - c V p / 2

The load is unknown: p walks, and is measured.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from fdd.residuals.added_tracker import Tracker
from fdd.unit import Unit

Array = NDArray[np.float64]

CM3, MPA, FAST = 1e-6, 1e6, 100.0
"""Units of the states (FAST: rad/s), so that all of them are near one."""
LOAD = 5.0
"""MPa/s by which the pressure may walk."""
LOST = 0.02
"""cm³ of oil in a period that the model does not account for: ripple, valves that open, lines."""
WALKS = (0.03, 0.02)
"""Relative changes of leakage and compliance in a second."""


def make(unit: Unit, channels: tuple[str, ...], period: float) -> Tracker:
    """The tracker of a unit, at `period` s between measurements."""
    cylinder = unit.cylinder
    area = 0.5 * (cylinder.area_1 + cylinder.area_2)
    pumped = unit.pump.displacement * FAST * period / CM3
    leakage, modulus = unit.pump.total_leakage, unit.oil.bulk_modulus
    squeezed = 0.25 * (cylinder.volume_1 + cylinder.volume_2) / modulus

    def moved(state: Array, dt: float, u: Array) -> Array:
        oil, pressure, leak, soft, before = state
        now = u[0] / FAST  # a row is a mean, so what lies between two is the mean of both
        oil += 0.5 * (before + now) * pumped - leak * leakage * pressure * MPA * dt / CM3
        return np.array([oil, pressure, leak, soft, now])

    def measured(state: Array) -> Array:
        oil, pressure, _, soft, _ = state
        return np.array([(oil * CM3 - soft * squeezed * pressure * MPA) / area, pressure * MPA])

    points = MerweScaledSigmaPoints(5, alpha=0.5, beta=2.0, kappa=0.0)
    ukf = UnscentedKalmanFilter(5, 2, period, hx=measured, fx=moved, points=points)
    ukf.P = np.diag(np.square([1.0, 0.1, 0.3, 0.2, 0.1]))
    walks = np.array([LOAD * period, *(np.array(WALKS) * np.sqrt(period))])
    ukf.Q = np.diag(np.square([LOST, *walks, 1e-3]))
    position, pressure = unit.sensor("position").noise, unit.sensor("pressure_difference").noise
    ukf.R = np.diag(np.square([max(position, 2e-5), max(pressure, 1e3)]))

    def start(u: Array, z: Array) -> None:
        oil = area * z[0] + squeezed * z[1]
        ukf.x = np.array([oil / CM3, z[1] / MPA, 1.0, 1.0, u[0] / FAST])

    return Tracker(
        ukf,
        inputs=("pump_speed",),
        measurements=("position", "pressure_difference"),
        start=start,
        quantities={
            "leakage": lambda state: leakage * state[2],
            "bulk_modulus": lambda state: modulus / state[3],  # at the chambers' pressure: a small model
        },
    )
