"""What one rig needs: a fault, a log format, a tracker, a classifier (docs/extending.md of fdd)."""
