"""Friction and load from the mean force balance of an EHA's cylinder."""

from __future__ import annotations

import numpy as np

from estimators.compiled import njit
from estimators.eha import model as eha
from estimators.eha.layout import Memory
from estimators.eha.noise import Noise
from estimators.kernels import scalar_update
from estimators.linalg import Array

FORCE_PERIOD = 20.0  # ms: one force balance each; shorter would count the friction curve's errors twice
FRICTION_LAG = 30.0  # ms
FRICTION_SETTLES = 80.0  # ms of sliding one way before the curve holds: break-away and bristles are over
PARTNER_MISFIT = 0.2  # share of a throttled partner's force that its compressible oil may hold back
ROBUST = 5.0  # innovations beyond this many sigmas are weighed down (Huber)


@njit()
def balance_forces(
    x: Array, P: Array, h: float, curve: float, q: eha.Parameters, c: Noise, memory: Memory
) -> None:
    """Measure friction and load by the mean force over `FORCE_PERIOD`, where the piston slid one way.

    ``A₁p₁ − A₂p₂ − M dv/dt = φ curve(v) + B v + b |v| + F + k x + c v|v| + m dv/dt`` in the mean. The errors
    of a friction curve last for many samples, so they are averaged first and count once; step by step they
    would be taken for white noise and make friction look far better known than it is.

    Parameters
    ----------
    x, P : posterior; friction and load states are corrected in place, once a period.
    h : ms since the last sample. curve : healthy friction at the velocity of `x`, N.
    q, c, memory : parameters, noise and memory of the tracker.
    """
    v = x[eha.V]
    if memory.force_span == 0.0:
        memory.force = memory.velocity = memory.position = memory.friction = memory.square_velocity = 0.0
        memory.first_velocity = v
        direction = 1.0 if v > 0.0 else -1.0
        if direction != memory.direction:
            memory.slid = 0.0
        memory.direction = direction
    if v * memory.direction < q.sliding_velocity:
        memory.slid = -FORCE_PERIOD
    memory.force += (q.area_1 * x[eha.P1] - q.area_2 * x[eha.P2]) * h
    memory.velocity += v * h
    memory.position += x[eha.X] * h
    memory.square_velocity += v * abs(v) * h
    memory.friction += curve * h
    memory.force_span += h
    if memory.force_span < FORCE_PERIOD - 0.5 * h:
        return
    span = memory.force_span
    memory.force_span = 0.0
    memory.slid += span
    if memory.slid < FRICTION_SETTLES:
        return
    acceleration = (v - memory.first_velocity) / span * 1e3
    row = np.zeros(eha.STATES)  # what the mean force says of each state
    row[eha.FRIC] = memory.friction / span
    row[eha.VISC] = memory.velocity / span
    row[eha.SKEW] = abs(row[eha.VISC])
    row[eha.LOAD] = 1.0
    row[eha.STIF] = memory.position / span
    row[eha.THROT] = memory.square_velocity / span
    row[eha.INERT] = acceleration
    y = memory.force / span - q.moving_mass * acceleration
    # Friction follows velocity with a lag of some tens of milliseconds (Armstrong-Hélouvry et al. 1994,
    # doi 10.1016/0005-1098(94)90209-7), so where the curve changed within the period it fits worse.
    start = eha.friction_curve(memory.first_velocity, q)[0]
    lag = FRICTION_LAG / span * (curve - start)
    # A throttled partner answers through its own compressible oil: its force lags too.
    partner = PARTNER_MISFIT * x[eha.THROT] * memory.square_velocity / span
    variance = (c.force_mean**2 + lag * lag + partner * partner) * max(memory.unrest, 1.0) ** 2
    s = variance
    for i in range(eha.FRIC, eha.STATES):
        y -= row[i] * x[i]
        for j in range(eha.FRIC, eha.STATES):
            s += row[i] * P[i, j] * row[j]
    # (Squared below: what moves a restless load lasts for several periods, so they repeat each other.)
    # Loads differ: how fast the load moves, and what the force balance is worth, follow from its own
    # innovations over some seconds.
    ratio = y * y / s
    memory.unrest = min(max(memory.unrest * np.exp(0.02 * (min(ratio, 9.0) - 1.0)), 0.01), 1e4)
    if ratio > ROBUST * ROBUST:
        variance += s * (ratio / ROBUST**2 - 1.0)
    gain, scratch = np.empty(eha.STATES), np.empty(eha.STATES)
    scalar_update(P, row, variance, gain, scratch)
    for i in range(eha.STATES):
        x[i] += gain[i] * y
