"""Gate on the adaptation of the oil's compliance: no pressure change, no learning.

How much oil gives shows only while its pressure changes. In a piston at rest what is left is noise, and a
filter learns from noise, too: its estimate of a pressure and the derivative to the compliance share the same
errors, so an hour of standstill lets the free air creep away. While neither chamber's pressure moved by
more than its noise within a second, air and its split are therefore taken as they are: they keep value and
variance, while their correlations go on as they would (Schmidt's consider filter, Jazwinski 1970,
section 8.4, isbn 978-0-12-381550-7).
"""

from __future__ import annotations

from estimators.compiled import njit
from estimators.eha import model as eha
from estimators.eha.layout import Memory
from estimators.eha.noise import Noise
from estimators.eha.update import Array

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
