"""What the service tells the outside: metrics, MQTT, webhooks, JSON lines and recordings."""

from fdd.service.outputs.delivery import Outputs
from fdd.service.outputs.metrics import Metrics

__all__ = ["Metrics", "Outputs"]
