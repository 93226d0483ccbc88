"""From samples to residuals: estimators on a unit's profile, then windows of features.

`fdd.residuals.tracking` runs the EKF and the SVSF, `fdd.residuals.features` turns each
window of their trajectories and of the raw signals into a few dimensionless numbers that
are zero on a healthy unit.
"""
