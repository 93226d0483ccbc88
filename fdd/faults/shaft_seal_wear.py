"""Pump shaft seal wear: the case drips to the outside."""

from fdd.faults.entry import Effect, Fault, Figure

FAULT = Fault(
    id="shaft_seal_wear", family="leakage", rank=5, title="pump shaft seal wear", thesis="Table 4.1",
    plant="slow loss from the case drain to the outside",
    severity="1 cm³/min from the case drain to the outside, at 487 kPa in the case",
    source="assumption: a steady drip, which empties an accumulator of 140 cm³ of oil within hours",
    next_check="Look for oil on the shaft between motor and pump, and compare the accumulator's pressure "
    "at rest with that of the last visit.",
    laws={
        "steady": "drips by pressure alone",
        "running": "drips little at rest, the more the faster it turns",
    },
    figures=(
        Figure(
            "shaft_leakage_flow", 1e-6 / 60.0, (0.0, 1e-4), "m³/s to the outside; 1 cm³/min", grows="flow"
        ),
        # The case's at rest: the thesis's mid charge pressure, 482 kPa, and 5 of its valve.
        Figure("shaft_leakage_pressure", 4.87e5, (1e3, 1e7), "Pa in the case at which it is that flow"),
    ),
    effects=tuple(
        Effect(
            parameter, "add", "shaft_leakage_flow", times=times, over="shaft_leakage_pressure", laws=(law,)
        )
        for parameter, times, law in (
            ("shaft_leakage", (), "steady"),
            ("shaft_leakage", (0.25,), "running"),
            ("shaft_speed", (0.75e-2,), "running"),  # the other three quarters at 100 rad/s
        )
    ),
)  # fmt: skip
