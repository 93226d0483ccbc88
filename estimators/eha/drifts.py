"""How far the EHA tracker lets its parameters walk, for `estimators.observability`, from its records."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from estimators.eha import model as eha
from estimators.eha.noise import Noise
from estimators.observability import Drift

Array = NDArray[np.float64]


def drifts(records: layout.Records, noise: Noise, scales: dict[int, Array]) -> dict[int, Drift]:
    """Walks of leakage, air and friction at each record, the laws of `estimators.eha.walk.walk_parameters`.

    Parameters
    ----------
    records : (n,) `RECORD` of the tracker. noise : the tracker's.
    scales : state (`eha.LEAK`, `eha.AIR`, `eha.FRIC` or `eha.VISC`) to (n,) what one of it is in the unit of
        the quantity that is watched.

    Returns
    -------
    State to its drift, in the quantity's unit.

    Examples
    --------
    >>> record = np.zeros(1, layout.RECORD)
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
