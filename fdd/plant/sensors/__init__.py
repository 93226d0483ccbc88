"""The sensors: from what was in the plant to what a log shows, block by block."""

from fdd.plant.sensors.channel import ChannelSensor, digitise, measure_channel
from fdd.plant.sensors.faults import SENSOR_FAULTS, PositionSlip, position_offset, struck_channel
from fdd.plant.sensors.recorder import KNOWN, MEASURED, Recorder, Rows
from fdd.plant.sensors.recording import Lateness, Recording, generator

__all__ = [
    "KNOWN", "MEASURED", "SENSOR_FAULTS", "ChannelSensor", "Lateness", "PositionSlip", "Recorder",
    "Recording", "Rows", "digitise", "generator", "measure_channel", "position_offset", "struck_channel",
]  # fmt: skip
