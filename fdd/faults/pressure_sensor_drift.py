"""Pressure sensor drift: a transducer's zero walks away."""

from __future__ import annotations

from fdd.faults.effect import Figure
from fdd.faults.entry import Fault

FAULT = Fault(
    id="pressure_sensor_drift",
    family="sensor",
    rank=2,
    title="pressure sensor drift",
    thesis="Appendix A",
    plant="a ramp added to the pressure measured",
    severity="5 kPa/s on the differential pressure",
    source="250 kPa within 50 s",
    next_check="Open the by-pass at rest and read the pressure difference every minute for a quarter of "
    "an hour: it must stay at zero.",
    figures=(
        Figure(
            "pressure_drift",
            5e3,
            (0.0, 1e7),
            "Pa/s on the pressure measured; 3.6 % of the transducer's range within 50 s",
            grows="pressure",
        ),
    ),
    in_measurement=True,
)
