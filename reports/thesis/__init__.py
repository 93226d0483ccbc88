"""The thesis's own experiments, chapters 5 to 7, on its simulated prototype, beside its numbers."""
