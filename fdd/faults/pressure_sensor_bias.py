"""Pressure sensor bias: a transducer's zero is off."""

from fdd.faults.entry import SHARE, Amount, Fault, Figure, zero_signatures

_BIAS = 0.073
"""Of the relief setting: 250 kPa of 3.44 MPa."""

FAULT = Fault(
    id="pressure_sensor_bias", family="sensor", rank=1, title="pressure sensor bias", thesis="Appendix A",
    plant="a constant added to the pressure measured; or its gain is off, or it shows hysteresis",
    severity="250 kPa on the differential pressure; by the law of gain: 7.3 % of the reading, which is as "
    "much at the relief pressure; by hysteresis: 250 kPa too little as it rises, too much as it falls",
    amounts=(Amount(250, " kPa", "pressure"),),
    source="3.6 % of the transducer's range; assumption: as much by the other laws",
    next_check="Open the by-pass at rest and read all pressures: both chambers and the accumulator must "
    "agree, and their difference must be zero.",
    laws={
        "zero": "the same at any pressure",
        "gain": "in proportion to the pressure, about zero gauge pressure",
        "hysteresis": "behind the pressure where it turns, up to the error",
    },
    figures=(
        # 3.6 % of the transducer's range.
        Figure(
            "pressure_bias", 250e3, (0.0, 1e8), "Pa; of hysteresis half the loop's width", grows="pressure"
        ),
        Figure("pressure_gain", _BIAS, SHARE, "rise of the reading, relative"),
    ),
    in_measurement=True,
    signatures=zero_signatures("bias", _BIAS, "step"),
)  # fmt: skip
