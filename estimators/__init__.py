"""Recursive estimators with filterpy's interface: NumPy in, NumPy out.

Usable on its own; ``README.md`` in this directory shows how. The EHA's own model and
tracker are modules beside this one; compiled loops call :mod:`estimators.kernels`.
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
from estimators.ekf import ExtendedKalmanFilter
from estimators.jacobians import JacobianCheck, check_jacobian, jacobian
from estimators.svsf import SVSF

__all__ = [
    "SVSF",
    "ExtendedKalmanFilter",
    "JacobianCheck",
    "autocorrelation",
    "check_jacobian",
    "jacobian",
    "nees_band",
    "nis_band",
    "nis_test",
    "squared_distance",
    "standardised",
    "whiteness_test",
]
