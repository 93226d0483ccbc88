"""Many axes in one process: sources, alarms, store, HTTP and outputs (`fdd serve`)."""
