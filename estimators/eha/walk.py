"""How the EHA model's parameters change, and what corrects them beside measurements: force, gate, bounds.

**Walks.** Wear is slow: each parameter walks at random with its own rate, but never gets less certain than
it was at the start, ``dP/dt = q² (1 − P/P₀)``. An hour without excitation costs no more than that, and the
last good value stays. Over a gap both this and the pull below are solved exactly.

**Valves.** A closed check valve stays closed. Its leakage is drawn back to zero at the rate that makes the
walk's stationary spread the initial one, ``τ = 2 σ₀²/q²``, unless it is surely open: the pull weakens as that
of a Cauchy prior does, ``1/(1 + (x/3σ₀)²)`` (West 1984, doi 10.1111/j.2517-6161.1984.tb01317.x).

**Jumps.** A consistent filter moves a parameter by white steps whose variance is what the covariance loses
(innovations approach: Kailath 1968, doi 10.1109/TAC.1968.1099025). So over a window::

    score = Σ (x⁺ − x⁻) / √ Σ (P⁻ − P⁺)        N(0, 1) for each parameter

and a score beyond :data:`JUMP_SIGMAS` says that something changed faster than the walks allow. What it was is
not known yet: one load direction cannot tell leakage across the ports from a valve's. All flow parameters are
set free together, by a step of the size of a fault, and the data that follow decide (Willsky and Jones 1976,
doi 10.1109/TAC.1976.1101146). While they do not, the standard deviations say so.

**Gate.** How much oil gives shows only while its pressure changes. In a piston at rest what is left is
noise, and a filter learns from noise, too: its estimate of a pressure and the derivative to the compliance
share the same errors, so an hour of standstill lets the free air creep away. While neither chamber's
pressure moved by more than its noise within a second, air and its split keep value and variance, while their
correlations go on (Schmidt's consider filter, Jazwinski 1970, section 8.4, isbn 978-0-12-381550-7).

**Bounds.** Neither a closed check valve's leakage is negative, nor leakage and friction. Cut off at its bound
a state would leave what it had taken from its neighbours with them: while a load pushes one way, leakage
across the ports and a valve's are known by their sum alone, and a valve at -0.2 is a leakage that reads 0.2
too high. So it is moved to its bound along the covariance, ``x ← x + P[:, j] / P[j, j] · (bound − x[j])``:
the most probable point on it (Simon 2010, doi 10.1049/iet-cta.2009.0032). The covariance stays: nothing was
measured.
"""

from __future__ import annotations

import math

import numpy as np

from estimators.compiled import njit
from estimators.eha import model as eha
from estimators.eha.layout import FLOW_PARAMETERS, Memory, Noise, Records
from estimators.eha.update import ROBUST
from estimators.kernels import scalar_update
from estimators.linalg import Array
from estimators.observability import Drift

SHORT = 1e-3  # share of a time constant up to which one explicit step is as good as the exponential
JUMP_SIGMAS = 5.0  # of a consistent filter: once in 20 hours over five parameters and 4.5 windows a second
SCORE_WINDOW = 250.0  # ms: an alarm that early, and long against the hydraulics' 20 ms
LONG_WINDOWS = 8  # of the above: drifts of some seconds show here first
MOST_STREAK = 5  # doublings of the step: a valve torn open is a hundred healthy leakages
FORCE_PERIOD = 20.0  # ms: one force balance each; shorter would count the friction curve's errors twice
FRICTION_LAG = 30.0  # ms
FRICTION_SETTLES = 80.0  # ms of sliding one way before the curve holds: break-away and bristles are over
PARTNER_MISFIT = 0.2  # share of a throttled partner's force that its compressible oil may hold back
FAST, SLOW = 20.0, 500.0  # ms: averages that noise and motion part in
REST = 1000.0  # ms without a pressure change that close the gate

WALKING = (
    (eha.LEAK, "leakage", 1.0), (eha.AIR, "air", 1e3), (eha.SPLIT, "air_split", 1e3), (eha.GAIN, "gain", 1.0),
    (eha.FRIC, "friction", 1.0), (eha.VISC, "viscous_friction", 1.0), (eha.SKEW, "viscous_skew", 1.0),
    (eha.STIF, "stiffness", 1e-3), (eha.THROT, "throttle", 1.0), (eha.INERT, "inertia", 1.0),
    (eha.ZERO, "zero", 1e-6),
)  # fmt: skip
"""States that walk no further than their initial spread: state, field of `Noise`, SI unit in the model's."""

LOWEST = np.full(eha.STATES, -np.inf)
HIGHEST = np.full(eha.STATES, np.inf)
for _state, _low, _high in (
    (eha.LEAK, 0.02, 300.0), (eha.VALVE1, 0.0, 300.0), (eha.VALVE2, 0.0, 300.0), (eha.AIR, -2.0, 100.0),
    (eha.SPLIT, -30.0, 30.0), (eha.GAIN, -0.1, 0.1), (eha.FRIC, 0.02, 10.0), (eha.VISC, -2e3, 5e4),
    (eha.THROT, -2e4, 1e7), (eha.INERT, -10.0, 3e3),
):  # fmt: skip
    LOWEST[_state], HIGHEST[_state] = _low, _high


def walk_rates(c: Noise) -> Array:
    """What `walk_parameters` needs of the noise `c`, once for many steps: (2, STATES).

    Variances that the walks add per second, and the inverses of the initial ones; both are zero
    where a state is fixed or walks without that limit.
    """
    if not c.initial_valve > 0.0:
        raise ValueError("initial_valve must be above zero")
    rates = np.zeros((2, eha.STATES))
    for state, name, unit in WALKING:
        rate, initial = getattr(c, name) * unit, getattr(c, f"initial_{name}") * unit
        if initial > 0.0:
            rates[0, state] = rate * rate
            rates[1, state] = 1.0 / (initial * initial)
    rates[0, eha.LOAD] = c.load * c.load
    rates[0, [eha.VALVE1, eha.VALVE2]] = c.valve * c.valve
    return rates


@njit(error_model="numpy", _nrt=False)
def walk_parameters(x: Array, P: Array, h: float, unrest: float, c: Noise, rates: Array, diag: Array) -> None:
    """Draw the valves back in `x` and `P`, and fill `diag` with the variances that `h` ms add. `unrest` is
    how much more than expected the load moves, see `balance_forces`; `rates` are those of `walk_rates`."""
    seconds = 1e-3 * h
    third = 1.0 / (3.0 * c.initial_valve)
    pull = 4.5 * third * third * seconds * rates[0, eha.VALVE1]
    gap = pull > SHORT  # the valves' time constant is the shortest
    for i in range(eha.LEAK):
        diag[i] = 0.0
    for i in range(eha.LEAK, eha.STATES):
        # Leakage that has grown beyond its healthy size is uncertain in proportion.
        size = max(1.0, x[i]) ** 2 if i == eha.LEAK else 1.0
        room = max(size - P[i, i] * rates[1, i], 0.0)
        diag[i] = seconds * rates[0, i] * room
        if gap and rates[1, i] > 0.0:
            diag[i] = -math.expm1(-seconds * rates[0, i] * rates[1, i]) * room / rates[1, i]
    diag[eha.LOAD] *= unrest
    if 0.3 * x[eha.AIR] > 1.0:
        most = (0.3 * x[eha.AIR]) ** 2 / rates[1, eha.AIR]
        room = max(1.0 - P[eha.AIR, eha.AIR] / most, 0.0)
        diag[eha.AIR] = seconds * rates[0, eha.AIR] * room
        if gap:
            diag[eha.AIR] = -math.expm1(-seconds * rates[0, eha.AIR] / most) * room * most
    for j in (eha.VALVE1, eha.VALVE2):
        openness = 1.0 + (x[j] * third) ** 2
        keep = 1.0 - pull / openness
        diag[j] *= openness
        if gap:
            keep = math.exp(-pull / openness)
            diag[j] = (c.initial_valve * openness) ** 2 * (1.0 - keep * keep)
        x[j] *= keep
        P[j, j] *= keep
        for i in range(eha.FRIC):  # correlated with nothing beyond
            P[j, i] *= keep
            P[i, j] = P[j, i]


@njit(error_model="numpy", _nrt=False)
def _beyond(shift: float, gained: float) -> bool:
    """Whether a score is beyond its limit."""
    return gained > 0.0 and abs(shift / np.sqrt(gained)) > JUMP_SIGMAS


@njit(error_model="numpy", _nrt=False)
def watch_jumps(x: Array, P: Array, before: Array, h: float, c: Noise, memory: Memory) -> None:
    """Add an update to the scores and, where one passes its limit, set the flow parameters free.

    The posterior `P` is then widened in place. `before` (2, FLOW_PARAMETERS) has the flow parameters and
    their variances before the update, `h` is ms since the last sample.
    """
    for i in range(FLOW_PARAMETERS):
        memory.shift[i] += x[eha.LEAK + i] - before[0, i]
        memory.gained[i] += before[1, i] - P[eha.LEAK + i, eha.LEAK + i]
    memory.score_span += h
    if memory.score_span < SCORE_WINDOW - 0.5 * h:
        return
    memory.score_span = 0.0
    memory.windows += 1.0
    jumped, long = False, memory.windows >= LONG_WINDOWS
    for i in range(FLOW_PARAMETERS):
        memory.shift_long[i] += memory.shift[i]
        memory.gained_long[i] += memory.gained[i]
        jumped = jumped or _beyond(memory.shift[i], memory.gained[i])
        jumped = jumped or (long and _beyond(memory.shift_long[i], memory.gained_long[i]))
        memory.shift[i] = memory.gained[i] = 0.0
    if long or jumped:
        memory.windows = 0.0
        for i in range(FLOW_PARAMETERS):
            memory.shift_long[i] = memory.gained_long[i] = 0.0
    if not jumped:
        memory.streak = 0.0
        return
    size = 2.0**memory.streak
    memory.streak = min(memory.streak + 1.0, float(MOST_STREAK))
    P[eha.LEAK, eha.LEAK] += (c.jump_leakage * size) ** 2
    P[eha.VALVE1, eha.VALVE1] += (c.jump_valve * size) ** 2
    P[eha.VALVE2, eha.VALVE2] += (c.jump_valve * size) ** 2
    P[eha.AIR, eha.AIR] += (c.jump_air * 1e3 * size) ** 2
    # Before the alarm the split and the pump's gain took up part of what happened.
    P[eha.SPLIT, eha.SPLIT] += (c.initial_air_split * 1e3 * size) ** 2
    P[eha.GAIN, eha.GAIN] += (c.initial_gain * size) ** 2


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
def keep_compliance(x: Array, P: Array, before: Array, covariance: float) -> None:
    """Put air and split back to what they were: values and variances as `watch_jumps` takes them."""
    for i in (eha.AIR, eha.SPLIT):
        x[i], P[i, i] = before[0, i - eha.LEAK], before[1, i - eha.LEAK]
    P[eha.AIR, eha.SPLIT] = P[eha.SPLIT, eha.AIR] = covariance


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


def drifts(records: Records, noise: Noise, scales: dict[int, Array]) -> dict[int, Drift]:
    """Walks of leakage, air and friction at each record by `walk_parameters`' laws, for an `Observability`.

    Of the (n,) `records` and the `noise` of a tracker. `scales` and what is given go by state (`eha.LEAK`,
    `eha.AIR`, `eha.FRIC` or `eha.VISC`): (n,) what one of it is in the unit of the quantity that is watched.

    Examples
    --------
    >>> from estimators.eha.layout import RECORD
    >>> record = np.zeros(1, RECORD)
    >>> record["state"][0, eha.LEAK] = 2.0           # twice the healthy leakage
    >>> leak = drifts(record, Noise(), {eha.LEAK: np.array([6.5e-12])})[eha.LEAK]
    >>> np.sqrt(leak.rate), np.sqrt(leak.ceiling)            # 2 * 2 % per root second, at most 2 * 30 %
    (array([2.6e-13]), array([3.9e-12]))
    """
    leak = np.maximum(records["state"][:, eha.LEAK], 1.0)
    air = np.maximum(0.3 * records["state"][:, eha.AIR], 1.0)
    # A record gives friction's deviations times the load's unrest; the walk does not know of it.
    unrest = np.maximum(records["unrest"], 1.0)
    one = np.ones(records.shape[0])
    laws = {
        eha.LEAK: (noise.leakage * leak, noise.initial_leakage * leak, one),
        eha.AIR: (noise.air * 1e3 * one, noise.initial_air * 1e3 * air, one),
        eha.FRIC: (noise.friction * one, noise.initial_friction * one, unrest),
        eha.VISC: (noise.viscous_friction * one, noise.initial_viscous_friction * one, unrest),
    }
    found = {}
    for state, scale in scales.items():
        rate, most, wider = laws[state]
        unit = scale * wider
        found[state] = Drift(rate=(rate * unit) ** 2, ceiling=(most * unit) ** 2, scale=unit)
    return found
