"""Pressure sensor bias: a transducer's zero is off."""

from __future__ import annotations

from fdd.faults.effect import SHARE, Figure
from fdd.faults.entry import Fault
from fdd.faults.signature import Columns, Healthy, Signature

BIAS = 0.073
"""Of the relief setting: 250 kPa of 3.44 MPa."""


def by_torque(unit: Healthy) -> Columns:
    """Bias of Δp of severity 1 in the torque balance: a pressure that is not there takes no current."""
    return {"torque": {"zero": -BIAS * unit.mean("torque", "pressure")}}


FAULT = Fault(
    id="pressure_sensor_bias",
    family="sensor",
    rank=1,
    title="pressure sensor bias",
    thesis="Appendix A",
    plant="a constant added to the pressure measured; or its gain is off, or it shows hysteresis",
    severity="250 kPa on the differential pressure; by the law of gain: 7.3 % of the reading, which is as "
    "much at the relief pressure; by hysteresis: 250 kPa too little as it rises, too much as it falls",
    source="3.6 % of the transducer's range; assumption: as much by the other laws",
    next_check="Open the by-pass at rest and read all pressures: both chambers and the accumulator must "
    "agree, and their difference must be zero.",
    laws={
        "zero": "the same at any pressure",
        "gain": "in proportion to the pressure, about zero gauge pressure",
        "hysteresis": "behind the pressure where it turns, up to the error",
    },
    figures=(
        Figure(
            "pressure_bias",
            250e3,
            (0.0, 1e8),
            "Pa on the pressure measured; 3.6 % of its range; of hysteresis half the loop's width",
            grows="pressure",
        ),
        Figure(
            "pressure_gain", BIAS, SHARE, "rise of the reading, relative; the bias at the relief pressure"
        ),
    ),
    in_measurement=True,
    signatures=(
        Signature(
            "bias dp",
            lambda unit: {"coherence": {"zero": BIAS}},
            signed=False,
            courses=("step",),
            channel="pressure_difference",
        ),
        Signature(
            "bias dp by torque", by_torque, signed=False, courses=("step",), channel="pressure_difference"
        ),
        Signature(
            "bias p1",
            lambda unit: {"coherence": {"zero": -BIAS}, "refeed": {"drop_1": -BIAS}},
            signed=False,
            courses=("step",),
            channel="pressure_1",
        ),
        Signature(
            "bias p2",
            lambda unit: {"coherence": {"zero": BIAS}, "refeed": {"drop_2": -BIAS}},
            signed=False,
            courses=("step",),
            channel="pressure_2",
        ),
    ),
)
