"""The HTTP service: API, events and page."""
