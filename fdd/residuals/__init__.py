"""From samples to residuals: estimators and balances on a unit's profile.

`fdd.residuals.tracking` runs the EKF and the SVSF. `fdd.residuals.bins` averages samples to bins of 10 ms,
`fdd.residuals.balances` makes regression rows of them, and `fdd.residuals.balance_history` keeps the normal
equations of frames of 0.5 s.
"""
