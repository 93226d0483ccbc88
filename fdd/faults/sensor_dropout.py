"""Sensor dropout: a channel is missing, held or dead, all the time or in bursts, or noisy, stuck or late."""

from fdd.faults.entry import ASSUMED, Amount, Fault, Figure

_PRESSURE = (0.0, 1e8)

FAULT = Fault(
    id="sensor_dropout", family="sensor", rank=4, title="sensor dropout", thesis="Appendix A",
    plant="a loose contact: a channel is missing, held, or reads a broken current loop, in bursts; or a "
    "channel is noisy, sticks, saturates or comes late",
    severity="the channel is lost all the time; 0.3: for 30 % of it, in bursts of about 0.1 s; "
    "missing: no value of the differential pressure; held: its last value again; "
    "broken_loop: what 0 mA reads; position_missing: no value of the position; "
    "position_held: its last value again; wrong all the time, noisy: white noise of 345 kPa rms on "
    "the differential pressure; sticking: it moves once the pressure is 250 kPa from where it stuck; "
    "clipped: it ends at zero, at 0.5 at half the relief pressure; late: it is up to 20 ms old",
    amounts=(Amount(345, " kPa", "pressure"), Amount(250, " kPa", "pressure")),
    source=ASSUMED,
    next_check="Move the sensor's cable and plugs by hand while its channel is read, and measure its "
    "supply and its loop current at the plug.",
    variants=(
        "missing", "held", "broken_loop", "position_missing", "position_held",
        "noisy", "sticking", "clipped", "late",
    ),
    figures=(
        # 5 % and 3.6 % of the transducer's range, and the relief pressure (assumptions).
        Figure("noise_pressure", 345e3, _PRESSURE, "Pa, standard deviation of each sample", grows="pressure"),
        Figure("sticking_pressure", 250e3, _PRESSURE, "Pa that it takes to move", grows="pressure"),
        Figure("clipping_pressure", 3.44e6, _PRESSURE, "Pa, limit that falls to zero", grows="pressure"),
        Figure("late_time", 20e-3, (0.0, 10.0), "s, the longest wait of a sample (assumption)"),
    ),
    in_measurement=True,
)  # fmt: skip
