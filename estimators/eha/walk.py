"""How the EHA model's parameters may change: slow walks, closed valves, and sudden faults.

**Walks.** Wear is slow: each parameter walks at random with its own rate, but never gets less certain
than it was at the start, ``dP/dt = q² (1 − P/P₀)``. An hour without excitation costs no more than
that, and the last good value stays. Over a gap both this and the pull below are solved exactly.

**Valves.** A closed check valve stays closed. Its leakage is drawn back to zero at the rate that makes the
walk's stationary spread the initial one, ``τ = 2 σ₀²/q²``, unless it is surely open: the pull weakens
as that of a Cauchy prior does, ``1/(1 + (x/3σ₀)²)`` (West 1984, doi 10.1111/j.2517-6161.1984.tb01317.x).

**Jumps.** A consistent filter moves a parameter by white steps whose variance is what the
covariance loses (innovations approach: Kailath 1968, doi 10.1109/TAC.1968.1099025). So over a window::

    score = Σ (x⁺ − x⁻) / √ Σ (P⁻ − P⁺)        N(0, 1) for each parameter

and a score beyond :data:`JUMP_SIGMAS` says that something changed faster than the walks allow. What it was
is not known yet: one load direction cannot tell leakage across the ports from that of a
valve. All flow parameters are therefore set free together, by a step of the size of a fault, and the data
that follow decide (Willsky and Jones 1976, doi 10.1109/TAC.1976.1101146). While they do not, the
standard deviations say so.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimators.compiled import njit
from estimators.eha import model as eha
from estimators.eha.layout import (
    FLOW_PARAMETERS,
    M_GAINED,
    M_GAINED_LONG,
    M_SCORE,
    M_SHIFT,
    M_SHIFT_LONG,
    M_SPAN,
    M_STREAK,
    M_WINDOWS,
)
from estimators.eha.noise import (
    I_AIR,
    I_FRIC,
    I_GAIN,
    I_INERT,
    I_LEAK,
    I_SKEW,
    I_SPLIT,
    I_STIF,
    I_THROT,
    I_VALVE,
    I_VISC,
    I_ZERO,
    J_AIR,
    J_LEAK,
    J_VALVE,
    N_AIR,
    N_FRIC,
    N_GAIN,
    N_INERT,
    N_LEAK,
    N_LOAD,
    N_SKEW,
    N_SPLIT,
    N_STIF,
    N_THROT,
    N_VALVE,
    N_VISC,
    N_ZERO,
)

Array = NDArray[np.float64]

SHORT = 1e-3  # share of a time constant up to which one explicit step is as good as the exponential
JUMP_SIGMAS = 5.0  # of a consistent filter: once in 20 hours over five parameters and 4.5 windows a second
SCORE_WINDOW = 250.0  # ms: an alarm that early, and long against the hydraulics' 20 ms
LONG_WINDOWS = 8  # of the above: drifts of some seconds show here first
MOST_STREAK = 5  # doublings of the step: a valve torn open is a hundred healthy leakages


# Walking states, index of rate and of initial spread in the noise, and their unit in SI over the model's.
_WALKS = (
    (eha.LEAK, N_LEAK, I_LEAK, 1.0),
    (eha.AIR, N_AIR, I_AIR, 1e3),
    (eha.SPLIT, N_SPLIT, I_SPLIT, 1e3),
    (eha.GAIN, N_GAIN, I_GAIN, 1.0),
    (eha.FRIC, N_FRIC, I_FRIC, 1.0),
    (eha.VISC, N_VISC, I_VISC, 1.0),
    (eha.SKEW, N_SKEW, I_SKEW, 1.0),
    (eha.STIF, N_STIF, I_STIF, 1e-3),
    (eha.THROT, N_THROT, I_THROT, 1.0),
    (eha.INERT, N_INERT, I_INERT, 1.0),
    (eha.ZERO, N_ZERO, I_ZERO, 1e-6),
)
_WALKING, _RATE, _INITIAL = (np.array([row[i] for row in _WALKS]) for i in range(3))
_UNIT = np.array([row[3] for row in _WALKS])


@njit(error_model="numpy")
def walk_rates(c: Array) -> Array:
    """What `walk_parameters` needs of the noise `c`, once for many steps: (2, STATES).

    Variances that the walks add per second, and the inverses of the initial ones; both are zero
    where a state is fixed or walks without that limit.

    Raises
    ------
    ValueError : the valves have no initial spread to be drawn back to.
    """
    if not c[I_VALVE] > 0.0:
        raise ValueError("initial_valve must be above zero")
    rates = np.zeros((2, eha.STATES))
    for k in range(_WALKING.size):
        initial = c[_INITIAL[k]] * _UNIT[k]
        if initial > 0.0:
            rates[0, _WALKING[k]] = (c[_RATE[k]] * _UNIT[k]) ** 2
            rates[1, _WALKING[k]] = 1.0 / initial**2
    rates[0, eha.LOAD] = c[N_LOAD] ** 2
    rates[0, eha.VALVE1] = rates[0, eha.VALVE2] = c[N_VALVE] ** 2
    return rates


@njit(error_model="numpy", _nrt=False)
def walk_parameters(x: Array, P: Array, h: float, unrest: float, c: Array, rates: Array, diag: Array) -> None:
    """Draw the valves back in `x` and `P`, and fill `diag` with the variances that `h` ms add.

    `unrest` is how much more than expected the load moves, see `balance_forces`; `rates` are those
    of `walk_rates`.
    """
    seconds = 1e-3 * h
    third = 1.0 / (3.0 * c[I_VALVE])
    pull = 4.5 * third * third * seconds * rates[0, eha.VALVE1]
    gap = pull > SHORT  # the valves' time constant is the shortest
    for i in range(eha.LEAK):
        diag[i] = 0.0
    for i in range(eha.LEAK, eha.STATES):
        room = max(1.0 - P[i, i] * rates[1, i], 0.0)
        diag[i] = seconds * rates[0, i] * room
        if gap and rates[1, i] > 0.0:
            diag[i] = -math.expm1(-seconds * rates[0, i] * rates[1, i]) * room / rates[1, i]
    diag[eha.LOAD] *= unrest
    # What has grown beyond its healthy size is uncertain in proportion.
    size = max(1.0, x[eha.LEAK]) ** 2
    room = max(size - P[eha.LEAK, eha.LEAK] * rates[1, eha.LEAK], 0.0)
    diag[eha.LEAK] = seconds * rates[0, eha.LEAK] * room
    if gap:
        share = -math.expm1(-seconds * rates[0, eha.LEAK] * rates[1, eha.LEAK])
        diag[eha.LEAK] = share * room / rates[1, eha.LEAK]
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
            diag[j] = (c[I_VALVE] * openness) ** 2 * (1.0 - keep * keep)
        x[j] *= keep
        P[j, j] *= keep
        for i in range(eha.FRIC):  # correlated with nothing beyond
            P[j, i] *= keep
            P[i, j] = P[j, i]


@njit(error_model="numpy", _nrt=False)
def watch_jumps(x: Array, P: Array, before: Array, h: float, c: Array, memory: Array) -> None:
    """Add an update to the scores and, where one passes its limit, set the flow parameters free.

    Parameters
    ----------
    x, P : posterior; P is widened in place after a jump.
    before : (2, FLOW_PARAMETERS) the flow parameters and their variances before the update.
    h : ms since the last sample. c, memory : noise and memory of the tracker.
    """
    for i in range(FLOW_PARAMETERS):
        memory[M_SHIFT + i] += x[eha.LEAK + i] - before[0, i]
        memory[M_GAINED + i] += before[1, i] - P[eha.LEAK + i, eha.LEAK + i]
    memory[M_SPAN] += h
    if memory[M_SPAN] < SCORE_WINDOW - 0.5 * h:
        return
    memory[M_SPAN] = 0.0
    memory[M_WINDOWS] += 1.0
    jumped = False
    for i in range(FLOW_PARAMETERS):
        memory[M_SHIFT_LONG + i] += memory[M_SHIFT + i]
        memory[M_GAINED_LONG + i] += memory[M_GAINED + i]
        memory[M_SCORE + i] = 0.0
        if memory[M_GAINED + i] > 0.0:
            memory[M_SCORE + i] = memory[M_SHIFT + i] / np.sqrt(memory[M_GAINED + i])
        jumped = jumped or abs(memory[M_SCORE + i]) > JUMP_SIGMAS
        memory[M_SHIFT + i] = memory[M_GAINED + i] = 0.0
    if memory[M_WINDOWS] >= LONG_WINDOWS:
        memory[M_WINDOWS] = 0.0
        for i in range(FLOW_PARAMETERS):
            if memory[M_GAINED_LONG + i] > 0.0:
                score = memory[M_SHIFT_LONG + i] / np.sqrt(memory[M_GAINED_LONG + i])
                jumped = jumped or abs(score) > JUMP_SIGMAS
            memory[M_SHIFT_LONG + i] = memory[M_GAINED_LONG + i] = 0.0
    if not jumped:
        memory[M_STREAK] = 0.0
        return
    size = 2.0 ** memory[M_STREAK]
    memory[M_STREAK] = min(memory[M_STREAK] + 1.0, float(MOST_STREAK))
    P[eha.LEAK, eha.LEAK] += (c[J_LEAK] * size) ** 2
    P[eha.VALVE1, eha.VALVE1] += (c[J_VALVE] * size) ** 2
    P[eha.VALVE2, eha.VALVE2] += (c[J_VALVE] * size) ** 2
    P[eha.AIR, eha.AIR] += (c[J_AIR] * 1e3 * size) ** 2
    # Before the alarm the split and the pump's gain took up part of what happened.
    P[eha.SPLIT, eha.SPLIT] += (c[I_SPLIT] * 1e3 * size) ** 2
    P[eha.GAIN, eha.GAIN] += (c[I_GAIN] * size) ** 2
    memory[M_WINDOWS] = 0.0
    for i in range(FLOW_PARAMETERS):
        memory[M_SHIFT_LONG + i] = memory[M_GAINED_LONG + i] = 0.0
