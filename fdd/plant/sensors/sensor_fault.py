"""What every fault of a sensor is: a change of one channel, with a state that goes on from block to block."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.sensors.recording import PERIOD
from fdd.sensor import Sensor

Array = NDArray[np.float64]

USUAL = FaultScales()


class SensorFault:
    """Effect on one channel: `distort` before range and rounding, `replace` after it.

    Parameters
    ----------
    spec : the fault. sensor : of the channel. seed : of the scenario. stream : tells axes apart.
    scales : figures of severity 1.
    """

    channel = "pressure_difference"
    period = PERIOD
    """s, between rows."""

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        self.spec, self.sensor, self.scales = spec, sensor, scales

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """What the sensor gives instead of `values`, before range and rounding.

        Parameters
        ----------
        values : (n,) of the sound sensor, with its noise; they may be overwritten.
        truth : (n,) what is there. time : (n,) s, when the rows are taken. first_row : number of the first.

        Returns
        -------
        (n,), in the channel's SI unit.
        """
        return values

    def replace(self, values: Array, time: Array) -> Array:
        """What the log has instead of the values (n,); they may be overwritten."""
        return values
