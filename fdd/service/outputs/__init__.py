"""What the service tells the outside: metrics, MQTT, webhooks, JSON lines and recordings."""

from fdd.service.outputs.metrics import Metrics
from fdd.service.outputs.outputs import Outputs
from fdd.service.outputs.recorder import Recorder

__all__ = ["Metrics", "Outputs", "Recorder"]
