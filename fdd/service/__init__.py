"""Many axes in one process: sources, fleet, alarms, store, HTTP and outputs."""
