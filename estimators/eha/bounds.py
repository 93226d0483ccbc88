"""Physical bounds of the EHA model's parameters, as a projection that the other states follow.

A closed check valve passes no oil, so its leakage is not negative; leakage and friction are not
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
from estimators.linalg import Array

LOWEST = np.full(eha.STATES, -np.inf)
HIGHEST = np.full(eha.STATES, np.inf)
for _state, _low, _high in (
    (eha.LEAK, 0.02, 300.0),
    (eha.VALVE1, 0.0, 300.0),
    (eha.VALVE2, 0.0, 300.0),
    (eha.AIR, -2.0, 100.0),
    (eha.SPLIT, -30.0, 30.0),
    (eha.GAIN, -0.1, 0.1),
    (eha.FRIC, 0.02, 10.0),
    (eha.VISC, -2e3, 5e4),
    (eha.THROT, -2e4, 1e7),
    (eha.INERT, -10.0, 3e3),
):
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
        if moved == 0.0:
            continue
        if P[j, j] > 0.0:
            for i in range(eha.LEAK, eha.STATES):
                x[i] += P[i, j] / P[j, j] * moved
    for j in range(eha.LEAK, eha.STATES):  # one bound's correction may pass another's
        x[j] = min(max(x[j], LOWEST[j]), HIGHEST[j])
