"""The volume balances of several logs of one unit, referred to one temperature and one pressure."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fdd.identification.record import Record
from fdd.identification.sensors import effective_noise
from fdd.identification.volume_steps import SMOOTHING, VolumeSteps, volume_steps
from fdd.unit import Unit


class LogBalances:
    """What all logs are referred to, and their rows.

    Attributes
    ----------
    records : the logs. temperature : mean oil temperature (°C), None where it is not measured.
    pressure : Pa gauge at which compressibility is referred; by default the usual one.
    noise : Pa, of the smoothed chamber pressures.
    """

    def __init__(self, records: list[Record], pressure: float | None = None) -> None:
        self.records = records
        known = [float(np.mean(r.temperature)) for r in records if r.temperature is not None]
        self.temperature = float(np.mean(known)) if known else None
        if pressure is None:
            pressure = float(np.median(np.concatenate([_reference_level(r) for r in records])))
        self.pressure = max(pressure, 0.0)

    @cached_property
    def noise(self) -> tuple[float, float]:
        """White noise of the chamber pressures that is left after the balance's window."""
        left = []
        for channel in ("pressure_1", "pressure_2"):
            found = [effective_noise(getattr(r, channel), r.period) for r in self.records]
            known = [x for x in found if x is not None]
            left.append(min(known, default=0.0) / np.sqrt(self.records[0].rows(SMOOTHING)))
        return left[0], left[1]

    def reference_temperature(self, unit: Unit) -> float:
        """°C that leakage is referred to: the logs' mean, else the profile's."""
        return unit.oil.reference_temperature if self.temperature is None else self.temperature

    def parts(self, unit: Unit) -> list[VolumeSteps]:
        """The rows of each log, counted with a profile's volumes."""
        return [
            volume_steps(
                r, unit, reference_temperature=self.reference_temperature(unit),
                reference_pressure=self.pressure, noise=self.noise,
            )
            for r in self.records
        ]  # fmt: skip

    def steps(self, unit: Unit) -> VolumeSteps:
        """The rows of all logs."""
        return VolumeSteps.join(self.parts(unit))


def _reference_level(record: Record) -> NDArray[np.float64]:
    """(n,) Pa at which the oil's compressibility is referred: the accumulator's, else the chambers' mean."""
    if record.accumulator_measured or not record.chambers_measured:
        return record.accumulator
    return 0.5 * (record.pressure_1 + record.pressure_2)
