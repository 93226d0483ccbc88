"""Position sensor slip: the encoder's head slips in its clamp."""

from fdd.faults.entry import ASSUMED, Fault

FAULT = Fault(
    id="position_sensor_slip", family="sensor", rank=3, title="position sensor slip", thesis="Appendix A",
    plant="the encoder's head slips in its clamp: its zero walks, in the log and for the controller",
    severity="about once a second by 0.5 to 1.5 mm to either side, within 5 mm",
    source=ASSUMED,
    next_check="Mark the encoder's head and its clamp, drive to the same hard stop several times and "
    "compare the position read there.",
    in_measurement=True,
)  # fmt: skip
