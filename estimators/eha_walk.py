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

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimators import eha_model as eha
from estimators.eha_layout import (
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
from estimators.eha_noise import (
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


@njit(cache=True)
def _grown(rate: float, seconds: float, variance: float, initial: float) -> float:
    """Variance that a walk adds in `seconds`, none beyond the initial one."""
    most = initial * initial
    if initial <= 0.0 or variance >= most:
        return 0.0
    added = rate * rate * seconds
    if added > SHORT * most:
        return -(most - variance) * np.expm1(-added / most)
    return added * (1.0 - variance / most)


@njit(cache=True)
def walk_parameters(x: Array, P: Array, h: float, unrest: float, c: Array, diag: Array) -> None:
    """Draw the valves back in `x` and `P`, and fill `diag` with the variances that `h` ms add.

    `unrest` is how much more than expected the load moves, see `balance_forces`.
    """
    seconds = 1e-3 * h
    diag[:] = 0.0
    # What has grown beyond its healthy size is uncertain in proportion.
    size = max(1.0, x[eha.LEAK])
    aerated = max(1.0, 0.3 * x[eha.AIR])
    diag[eha.LEAK] = _grown(c[N_LEAK] * size, seconds, P[eha.LEAK, eha.LEAK], c[I_LEAK] * size)
    rate = 0.5 * (c[N_VALVE] / c[I_VALVE]) ** 2 * seconds
    for j in (eha.VALVE1, eha.VALVE2):
        openness = 1.0 + (x[j] / (3.0 * c[I_VALVE])) ** 2
        pull = rate / openness
        if pull > SHORT:
            keep = np.exp(-pull)
            diag[j] = (c[I_VALVE] * openness) ** 2 * (1.0 - keep * keep)
        else:
            keep = 1.0 - pull
            diag[j] = c[N_VALVE] ** 2 * seconds * openness
        x[j] *= keep
        for i in range(eha.FRIC):  # correlated with nothing beyond
            P[i, j] *= keep
            P[j, i] *= keep
    diag[eha.AIR] = _grown(c[N_AIR] * 1e3, seconds, P[eha.AIR, eha.AIR], c[I_AIR] * 1e3 * aerated)
    diag[eha.SPLIT] = _grown(c[N_SPLIT] * 1e3, seconds, P[eha.SPLIT, eha.SPLIT], c[I_SPLIT] * 1e3)
    diag[eha.ZERO] = _grown(c[N_ZERO] * 1e-6, seconds, P[eha.ZERO, eha.ZERO], c[I_ZERO] * 1e-6)
    diag[eha.SKEW] = _grown(c[N_SKEW], seconds, P[eha.SKEW, eha.SKEW], c[I_SKEW])
    diag[eha.GAIN] = _grown(c[N_GAIN], seconds, P[eha.GAIN, eha.GAIN], c[I_GAIN])
    diag[eha.FRIC] = _grown(c[N_FRIC], seconds, P[eha.FRIC, eha.FRIC], c[I_FRIC])
    diag[eha.VISC] = _grown(c[N_VISC], seconds, P[eha.VISC, eha.VISC], c[I_VISC])
    diag[eha.LOAD] = c[N_LOAD] ** 2 * seconds * unrest
    diag[eha.STIF] = _grown(c[N_STIF] * 1e-3, seconds, P[eha.STIF, eha.STIF], c[I_STIF] * 1e-3)
    diag[eha.THROT] = _grown(c[N_THROT], seconds, P[eha.THROT, eha.THROT], c[I_THROT])
    diag[eha.INERT] = _grown(c[N_INERT], seconds, P[eha.INERT, eha.INERT], c[I_INERT])


@njit(cache=True)
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
    # Before the alarm the split took up part of what happened.
    P[eha.SPLIT, eha.SPLIT] += (c[I_SPLIT] * 1e3 * size) ** 2
    memory[M_WINDOWS] = 0.0
    for i in range(FLOW_PARAMETERS):
        memory[M_SHIFT_LONG + i] = memory[M_GAINED_LONG + i] = 0.0
