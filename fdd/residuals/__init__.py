"""From samples to residuals: estimators and balances on a unit's profile."""
