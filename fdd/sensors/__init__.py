"""Which channels may be trusted, and since when not: judged before any hydraulics."""

from fdd.sensors.finding import SensorFinding
from fdd.sensors.watch import SensorWatch

__all__ = ["SensorFinding", "SensorWatch"]
