"""What corrects the EHA tracker beside its measurement update: mean force, sensor pairs, gate and bounds.

**Gate.** How much oil gives shows only while its pressure changes. In a piston at rest what is left is
noise, and a filter learns from noise, too: its estimate of a pressure and the derivative to the compliance
share the same errors, so an hour of standstill lets the free air creep away. While neither chamber's
pressure moved by more than its noise within a second, air and its split are therefore taken as they are: they
keep value and variance, while their correlations go on as they would (Schmidt's consider filter, Jazwinski
1970, section 8.4, isbn 978-0-12-381550-7).

**Bounds.** A closed check valve passes no oil, so its leakage is not negative; leakage and friction are not
either. Cutting such a state off at its bound would leave what it had taken from its neighbours with
them: while a load pushes one way, leakage across the ports and a valve's are known by their sum
alone, and a valve at -0.2 is a leakage that reads 0.2 too high. The state is therefore moved
to its bound along the covariance,

``x ← x + P[:, j] / P[j, j] · (bound − x[j])``,

which is the most probable point on the bound (Simon 2010, doi 10.1049/iet-cta.2009.0032). The
covariance stays: nothing was measured.
"""

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

    The posterior `x`, `P` is corrected in place, once a period; `h` is ms since the last sample, `curve` the
    healthy friction at the velocity of `x`, N.
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


PAIRS = 20  # samples averaged before one update


@njit()
def compare_sensors(x: Array, P: Array, gap: float, variance: float, memory: Memory) -> None:
    """Let `gap` = Δp − (p₁ − p₂), MPa, of white noise `variance`, tell the zero, `PAIRS` samples at a time.

    The zero stands alone in the covariance: the redundant sensor is not let into the pressures, for its
    gain error, one percent or so, would pull them about under load, and which of the sensors is
    off nobody knows. Differences beyond five standard deviations are weighed down (Huber).
    """
    if np.isnan(gap):
        return
    memory.gap += gap
    memory.pairs += 1.0
    if memory.pairs < PAIRS:
        return
    error = memory.gap / memory.pairs - x[eha.ZERO]
    noise = variance / memory.pairs
    memory.gap = memory.pairs = 0.0
    prior = P[eha.ZERO, eha.ZERO]
    s = prior + noise
    if error * error > ROBUST * ROBUST * s:
        noise += s * (error * error / (s * ROBUST * ROBUST) - 1.0)
        s = prior + noise
    x[eha.ZERO] += prior / s * error
    P[eha.ZERO, eha.ZERO] = prior * noise / s


FAST, SLOW = 20.0, 500.0  # ms: averages that noise and motion part in
REST = 1000.0  # ms without a pressure change that close the gate


@njit(error_model="numpy", _nrt=False)
def pressures_rest(x: Array, h: float, c: Noise, memory: Memory) -> bool:
    """Whether neither chamber's pressure moved within the last second; `h` ms since the last call.

    The fast average has a seventh of the pressure noise or less, so the limit, that noise itself, is
    seven of its standard deviations.
    """
    memory.still += h
    fast, slow = min(h / FAST, 1.0), min(h / SLOW, 1.0)
    for i in range(2):
        memory.fast[i] += fast * (x[eha.P1 + i] - memory.fast[i])
        memory.slow[i] += slow * (x[eha.P1 + i] - memory.slow[i])
        if abs(memory.fast[i] - memory.slow[i]) > c.pressure * 1e-6:
            memory.still = 0.0
    return memory.still > REST


@njit(error_model="numpy", _nrt=False)
def keep_compliance(x: Array, P: Array, kept: Array) -> None:
    """Put air and split back to `kept` (2, 3): values, then their variances and covariance."""
    x[eha.AIR], x[eha.SPLIT] = kept[0, 0], kept[0, 1]
    P[eha.AIR, eha.AIR], P[eha.SPLIT, eha.SPLIT] = kept[1, 0], kept[1, 1]
    P[eha.AIR, eha.SPLIT] = P[eha.SPLIT, eha.AIR] = kept[1, 2]


LOWEST = np.full(eha.STATES, -np.inf)
HIGHEST = np.full(eha.STATES, np.inf)
for _state, _low, _high in (
    (eha.LEAK, 0.02, 300.0), (eha.VALVE1, 0.0, 300.0), (eha.VALVE2, 0.0, 300.0), (eha.AIR, -2.0, 100.0),
    (eha.SPLIT, -30.0, 30.0), (eha.GAIN, -0.1, 0.1), (eha.FRIC, 0.02, 10.0), (eha.VISC, -2e3, 5e4),
    (eha.THROT, -2e4, 1e7), (eha.INERT, -10.0, 3e3),
):  # fmt: skip
    LOWEST[_state], HIGHEST[_state] = _low, _high


@njit()
def keep_in_bounds(x: Array, P: Array) -> None:
    """Bring parameters that left their bounds back, in place, and what is correlated with them along."""
    inside = True
    for j in range(eha.LEAK, eha.STATES):
        inside = inside and LOWEST[j] <= x[j] <= HIGHEST[j]
    if inside:
        return
    for j in range(eha.LEAK, eha.STATES):
        moved = min(max(x[j], LOWEST[j]), HIGHEST[j]) - x[j]
        if moved != 0.0 and P[j, j] > 0.0:
            for i in range(eha.LEAK, eha.STATES):
                x[i] += P[i, j] / P[j, j] * moved
    for j in range(eha.LEAK, eha.STATES):  # one bound's correction may pass another's
        x[j] = min(max(x[j], LOWEST[j]), HIGHEST[j])
