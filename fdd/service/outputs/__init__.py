"""What the service tells the outside: metrics, MQTT, webhooks, JSON lines, recordings and Foxglove."""

from fdd.service.outputs.metrics import Metrics
from fdd.service.outputs.outputs import Outputs

__all__ = ["Metrics", "Outputs"]
