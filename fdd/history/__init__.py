"""Several logs of one unit: what changed between two of them, and where a unit is going over its life."""
