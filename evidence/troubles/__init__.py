"""Faults of the service's own, each tried on the real `fdd serve`: what was said, and what was lost."""
