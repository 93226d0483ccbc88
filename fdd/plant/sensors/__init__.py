"""The sensors: from what was in the plant to what a log shows, block by block."""

from fdd.plant.sensors.faults import SENSOR_FAULTS, position_offset, struck_channel
from fdd.plant.sensors.recorder import KNOWN, MEASURED, ChannelSensor, Recorder, Rows, range_of
from fdd.plant.sensors.recording import Lateness, Recording, generator

__all__ = [
    "KNOWN", "MEASURED", "SENSOR_FAULTS", "ChannelSensor", "Lateness", "Recorder", "Recording", "Rows",
    "generator", "position_offset", "range_of", "struck_channel",
]  # fmt: skip
