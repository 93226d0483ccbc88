"""Pressure sensor drift: a transducer's zero walks away."""

from fdd.faults.entry import Amount, Fault, Figure, zero_signatures

FAULT = Fault(
    id="pressure_sensor_drift", family="sensor", rank=2, title="pressure sensor drift", thesis="Appendix A",
    plant="a ramp, or another course that grows, is added to the pressure measured",
    severity="5 kPa/s on the differential pressure, 250 kPa within 50 s; by the other laws as much by then: "
    "the root's 35 kPa after 1 s, the walk's rms, 95 % of where it settles",
    amounts=(
        Amount(5, " kPa/s", "pressure"),
        Amount(250, " kPa", "pressure"),
        Amount(35, " kPa", "pressure"),
    ),
    source="assumption: 250 kPa within 50 s, by whatever law",
    laws={
        "line": "as much in each second",
        "root": "fast at first, with the square root of time",
        "walk": "a random walk",
        "settling": "towards a bound, with a time constant of 17 s",
    },
    next_check="Open the by-pass at rest and read the pressure difference every minute for a quarter of "
    "an hour: it must stay at zero.",
    figures=(
        # 3.6 % of the transducer's range within 50 s, by any law.
        Figure("pressure_drift", 5e3, (0.0, 1e7), "Pa/s on the pressure measured", grows="pressure"),
    ),
    in_measurement=True,
    # Severity 1 reaches the bias of severity 1 within 50 s: the drift's course is that time's unit.
    signatures=zero_signatures("drift", 0.073, "drift"),  # over the relief pressure
)  # fmt: skip
