"""What the service tells the outside: metrics, MQTT, webhooks, JSON lines and recordings."""
