"""The recorder: blocks of the plant's truth in, blocks of the log out, the same bits however it is cut."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.plant.faults.spec import FaultScales, FaultSpec
from fdd.plant.sensors.channel import RATE, ChannelSensor, range_of
from fdd.plant.sensors.faults import USUAL, SensorFault, sensor_fault, struck_channel
from fdd.plant.sensors.recording import Losses, NanBursts, Recording, generator
from fdd.samples import Samples
from fdd.unit import Unit

Array = NDArray[np.float64]

MEASURED = (
    "pump_angle", "position", "pressure_difference", "pressure_1", "pressure_2", "pressure_accumulator",
    "motor_current", "oil_temperature", "load_force",
)  # fmt: skip
"""Channels that a sensor gives. Pump speed is the angle's count difference; set-points are known."""
KNOWN = ("command", "position_setpoint")
"""Channels that the controller itself gives: rounded, never missing."""


@dataclass(frozen=True)
class Rows:
    """A block of what was recorded, all rows still there.

    Stamps (n,) s; channel to (n,) values, NaN where a burst or a fault took them; whether the log has it.
    """

    time: Array
    columns: dict[str, Array]
    kept: NDArray[np.bool_]

    def samples(self) -> Samples:
        """The rows that the log has."""
        if self.kept.all():
            return Samples(self.time, self.columns)
        return Samples(self.time[self.kept], {c: v[self.kept] for c, v in self.columns.items()})


class Recorder:
    """Measures a run block by block: sensors, their faults, and what the recording loses.

    Parameters
    ----------
    unit : its sensors.
    faults : those of sensors act here, the others are left alone.
    recording : how the log is taken; rows that are late come late from the plant (see `Lateness`).
    seed : of the scenario.
    stream : tells the axes of one scenario apart, as " axis_b"; "" for the only one. Noise, bursts and faults
        are each axis's own; dropped rows and stamps are all axes' in common (one computer samples them).
    scales : figures of severity 1.

    Raises
    ------
    InputError : a fault that this unit's sensors cannot have.
    """

    def __init__(
        self, unit: Unit, faults: list[FaultSpec], recording: Recording, seed: int, stream: str = "",
        scales: FaultScales = USUAL,
    ) -> None:  # fmt: skip
        self.unit, self.recording = unit, recording
        channels = [c for c in MEASURED if c != "load_force" or recording.load_force]
        rate = 1.0 / recording.period if recording.each > 1 else RATE
        self._sensors = {
            c: ChannelSensor(unit.sensor(c), generator(seed, f"sensor {c}{stream}"), rate) for c in channels
        }
        speed = unit.sensor("pump_speed")
        counts = unit.sensor("pump_angle").resolution / recording.period
        # A difference of counts is on their grid already; rounding it to a printed one would shift it.
        own_grid = counts > 0.0 and abs(speed.resolution / counts - 1.0) < 0.01
        step = 0.0 if own_grid else speed.resolution
        self._speed = ChannelSensor(
            speed.model_copy(update={"bandwidth_hz": None, "resolution": step}),
            generator(seed, f"sensor pump_speed{stream}"),
            rate,
        )
        self._faults: dict[str, list[SensorFault]] = {}
        for spec in faults:
            kind, channel = sensor_fault(spec), struck_channel(spec, recording)
            if kind is not None and channel in self._sensors:
                effect = kind(spec, unit.sensor(channel), seed, stream, scales, recording.period)
                self._faults.setdefault(channel, []).append(effect)
        self._losses = Losses(recording, seed)
        self._bursts = NanBursts(recording, seed, [*self._sensors, "pump_speed"], stream)
        self._angle = 0.0
        self.row = 0

    def measure(self, truth: Mapping[str, Array], time: Array) -> Rows:
        """Record the next n rows, with the channels in the order known, measured, known.

        Parameters
        ----------
        truth : column (n,) of each channel of `MEASURED` (``load_force`` only where it is measured), and
            of `KNOWN` where there are any.
        time : (n,) s, when each row was taken.

        Raises
        ------
        InputError : a channel is missing from the truth.
        """
        time = np.ascontiguousarray(time, dtype=np.float64)
        absent = [c for c in self._sensors if c not in truth]
        if absent:
            raise InputError(f"the truth lacks {', '.join(absent)}", mend="give all measured channels")
        columns: dict[str, Array] = {}
        if "command" in truth:
            columns["command"] = range_of(self.unit.sensor("command")).digitise(truth["command"])
        for channel, sensor in self._sensors.items():
            columns[channel] = self._one(channel, sensor, truth, time)
            if channel == "pump_angle":
                counted = self.recording.speed == "counts"
                speed = self._count_difference(columns[channel]) if counted else truth["pump_speed"]
                columns["pump_speed"] = self._speed.range.digitise(self._speed.observe(speed, time))
        for channel, effects in self._faults.items():
            for effect in effects:
                columns[channel] = effect.replace(columns[channel], time)
        self._bursts.blank(columns, time.size)
        if "position_setpoint" in truth:
            columns["position_setpoint"] = np.array(truth["position_setpoint"], dtype=np.float64)
        columns = {name: values for name, values in columns.items() if self.recording.has(name)}
        stamps, kept = self._losses.next(time)
        if self.recording.keeps_every > 1:
            kept = kept & (np.arange(self.row, self.row + time.size) % self.recording.keeps_every == 0)
        self.row += time.size
        return Rows(stamps, columns, kept)

    def _one(self, channel: str, sensor: ChannelSensor, truth: Mapping[str, Array], time: Array) -> Array:
        """One channel before what is lost of it."""
        there = np.ascontiguousarray(truth[channel], dtype=np.float64)
        value = sensor.observe(there, time, truth["pump_angle"])
        for effect in self._faults.get(channel, ()):
            value = effect.distort(value, there, time, self.row)
        return sensor.range.digitise(value)

    def _count_difference(self, angle: Array) -> Array:
        """Counts since the last sample over a nominal period: a late row shows too much speed."""
        if not angle.size:
            return angle
        before = angle[0] if self.row == 0 else self._angle
        self._angle = float(angle[-1])
        return np.asarray(np.diff(angle, prepend=before) / self.recording.period)
