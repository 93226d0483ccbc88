"""Recursive estimators with filterpy's interface: NumPy in, NumPy out.

Usable on its own; ``README.md`` in this directory shows how. The EHA's own model and
tracker are in :mod:`estimators.eha`; compiled loops call :mod:`estimators.kernels`.
"""

from estimators.ekf import ExtendedKalmanFilter, jacobian
from estimators.observability import Drift, Observability, Observed
from estimators.svsf import SVSF

__all__ = ["SVSF", "Drift", "ExtendedKalmanFilter", "Observability", "Observed", "jacobian"]
