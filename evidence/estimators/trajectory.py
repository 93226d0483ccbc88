"""What really happened in a run, in the estimators' model units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimators.eha import layout
from estimators.eha import model as eha
from fdd.residuals.tracking import estimates
from fdd.unit import Unit

Array = NDArray[np.float64]

QUANTITIES = ("leakage", "bulk_modulus", "coulomb_friction", "viscous_friction")
"""What is tracked and reported, in this order everywhere."""
TRACKED = (eha.LEAK, eha.AIR, eha.FRIC, eha.VISC)
"""The state behind each."""


@dataclass(frozen=True)
class Trajectory:
    """A true run.

    Attributes
    ----------
    states : (n, STATES) in the units of `estimators.eha.model`, one row per sample.
    accumulator : (n,) MPa. viscosity : (n,) over the reference's.
    """

    states: Array
    accumulator: Array
    viscosity: Array

    def __len__(self) -> int:
        return int(self.states.shape[0])


def quantities(
    states: Array, variances: Array, viscosity: Array, unit: Unit, model: eha.Parameters
) -> tuple[Array, Array]:
    """The tracked quantities and their standard deviations in SI, as `fdd.residuals.tracking.estimates`.

    Parameters
    ----------
    states, variances : (n, STATES). viscosity : (n,).
    unit, model : the profile that the estimators have, and its parameter array.

    Returns
    -------
    values, stds : (4, n) each, in the order of `QUANTITIES`.
    """
    records = np.zeros(states.shape[0], layout.RECORD)
    records["state"] = states
    records["variance"] = variances
    records["viscosity"] = viscosity
    values, stds = estimates(records, unit, model)
    return np.array([values[q] for q in QUANTITIES]), np.array([stds[q] for q in QUANTITIES])
