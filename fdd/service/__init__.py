"""Many axes watched in one process: sources, alarms, store, HTTP, outputs."""
