"""Zero of a pressure difference sensor against the chambers' own sensors."""

from __future__ import annotations

import numpy as np

from estimators.compiled import njit
from estimators.eha import model as eha
from estimators.eha.forces import ROBUST
from estimators.eha.layout import Memory
from estimators.linalg import Array

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
