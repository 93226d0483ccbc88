"""Recursive estimators with filterpy's interface: NumPy in, NumPy out.

Usable on its own; ``README.md`` in this directory shows how. The EHA's own model and
tracker are in :mod:`estimators.eha`; compiled loops call :mod:`estimators.kernels`.
"""

from estimators.consistency import (
    autocorrelation,
    nees_band,
    nis_band,
    nis_test,
    squared_distance,
    standardised,
    whiteness_test,
)
from estimators.ekf import ExtendedKalmanFilter, jacobian
from estimators.imm import IMM
from estimators.linear_bank import BankRun, run_bank
from estimators.modes import transition_matrix
from estimators.observability import Drift, Observability, Observed
from estimators.svsf import SVSF

__all__ = [
    "IMM",
    "SVSF",
    "BankRun",
    "Drift",
    "ExtendedKalmanFilter",
    "Observability",
    "Observed",
    "autocorrelation",
    "jacobian",
    "nees_band",
    "nis_band",
    "nis_test",
    "run_bank",
    "squared_distance",
    "standardised",
    "transition_matrix",
    "whiteness_test",
]
