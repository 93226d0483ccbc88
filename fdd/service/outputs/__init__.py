"""What the service tells the outside: metrics, MQTT, webhooks and recordings."""
