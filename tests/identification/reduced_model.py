"""Logs made by the filters' own reduced model with known noise: there every claim must hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from estimators.eha import model as eha
from estimators.eha.noise import Noise
from fdd.residuals.tracking import healthy_viscous, model_parameters
from fdd.samples import Samples
from fdd.unit import Unit

TANK = 0.2e6
PERIOD = 1e-3


@dataclass(frozen=True)
class Made:
    """A log, and the states (n, 17) that it was measured from, model units."""

    log: Samples
    states: np.ndarray


def reduced_log(
    unit: Unit, noise: Noise, seconds: float, seed: int, *, speed: float = 60.0, chambers: bool = True
) -> Made:
    """Run `estimators.eha.model.step` with white noise of these levels and measure with theirs."""
    rng = np.random.default_rng(seed)
    q = model_parameters(unit)
    n, h = round(seconds / PERIOD), 1.0
    x = np.zeros(eha.STATES)
    x[eha.LEAK] = 1.0 + noise.initial_leakage * 0.2 * rng.standard_normal()
    x[eha.FRIC], x[eha.VISC] = 1.0, healthy_viscous(unit)
    x[eha.AIR] = 1e3 * (unit.oil.air_fraction + 0.2 * noise.initial_air * rng.standard_normal())
    x[eha.X], x[eha.W] = -50.0, speed * 1e-3
    x[eha.V] = x[eha.W] * q.displacement / q.area_1
    x[eha.P1], x[eha.P2] = 1.6, 1.4
    mu = 1e-3 / q.moving_mass
    spread = np.array([
        mu * noise.force * np.sqrt(1e3 * h), noise.acceleration * 1e-3 * np.sqrt(1e-3 * h),
        noise.flow * 1e9 * np.sqrt(1e-3 * h), noise.flow * 1e9 * np.sqrt(1e-3 * h),
    ])  # fmt: skip
    kicks = rng.standard_normal((n, 4)) * spread
    states, out = np.empty((n, eha.STATES)), np.empty(eha.STATES)
    F, G = np.empty((eha.STATES, eha.STATES)), np.empty((eha.STATES, 4))
    for k in range(n):
        states[k] = x
        eha.step(x, h, 1.0, TANK * 1e-6, np.nan, np.nan, q, out, F, G)
        x = out + G @ kicks[k]
    e = rng.standard_normal((n, 5))
    p1, p2 = states[:, eha.P1] * 1e6, states[:, eha.P2] * 1e6
    columns = {
        "position": states[:, eha.X] * 1e-3 + noise.position * e[:, 0],
        "pump_angle": states[:, eha.TH] + noise.angle * e[:, 1],
        "pressure_accumulator": np.full(n, TANK),
    }
    if chambers:
        columns |= {"pressure_1": p1 + noise.pressure * e[:, 2], "pressure_2": p2 + noise.pressure * e[:, 3]}
    else:
        columns["pressure_difference"] = p1 - p2 + noise.pressure_difference * e[:, 4]
    return Made(Samples(np.arange(n) * PERIOD, columns), states)
