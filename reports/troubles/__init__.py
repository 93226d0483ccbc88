"""What troubles the service itself, tried on the real process."""
