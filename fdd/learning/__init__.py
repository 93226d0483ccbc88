"""Features of logs and classifiers on them, for experiments of one's own; see docs/research.md."""

from fdd.learning.classifier import FaultClassifier

__all__ = ["FaultClassifier"]
