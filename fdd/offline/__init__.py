"""Diagnosis of whole logs: what `fdd.diagnose` and ``fdd diagnose`` share."""
