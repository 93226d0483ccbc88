"""Sensor dropout: a channel is missing, held or dead, in bursts or for good."""

from __future__ import annotations

from fdd.faults.entry import ASSUMED, Fault

FAULT = Fault(
    id="sensor_dropout",
    family="sensor",
    rank=4,
    title="sensor dropout",
    thesis="Appendix A",
    plant="a loose contact: a channel is missing, held, or reads a broken current loop, in bursts",
    severity="the channel is lost all the time; 0.3: for 30 % of it, in bursts of about 0.1 s; "
    "missing: no value of the differential pressure; held: its last value again; "
    "broken_loop: what 0 mA reads; position_missing: no value of the position; "
    "position_held: its last value again",
    source=ASSUMED,
    next_check="Move the sensor's cable and plugs by hand while its channel is read, and measure its "
    "supply and its loop current at the plug.",
    variants=("missing", "held", "broken_loop", "position_missing", "position_held"),
    in_measurement=True,
)
