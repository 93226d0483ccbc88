"""What faults of sensors do to a measurement, each with a state that goes on from block to block.

One class per fault and one table; a new fault is a catalogue entry and a line here. Severity 0
leaves every number as it was, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.plant.compiled import njit
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.sensors.dropout import DROPOUT, DROPOUTS, Dropout, dropout_kind
from fdd.plant.sensors.recording import PERIOD, Recording
from fdd.plant.sensors.sensor_fault import USUAL, SensorFault
from fdd.plant.sensors.slip import SLIP, PositionSlip
from fdd.plant.sensors.streams import generator
from fdd.sensor import Sensor

Array = NDArray[np.float64]

DRIFTED = 50.0
"""s after which a drift has come as far by whatever law."""


class Bias(SensorFault):
    """Zero error of the transmitter, error of its gain, or hysteresis of its diaphragm.

    Hysteresis is the play operator: the reading follows only where the pressure has turned by twice the
    error (Krasnosel'skii and Pokrovskii 1989, doi:10.1007/978-3-642-61302-9). It begins in the middle. The
    noise comes in behind it.
    """

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._follows = np.array([np.nan])

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        severity = self.spec.over(time)
        if self.spec.law == "gain":
            values *= 1.0 + self.scales.pressure_gain * severity
        elif self.spec.law == "hysteresis":
            values += _play(truth, self.scales.pressure_bias * severity, self._follows)
        else:
            values += self.scales.pressure_bias * severity
        return values


@njit(error_model="numpy")
def _play(truth: Array, half: Array, state: Array) -> Array:
    """What a play of ± `half` shows too much."""
    out = np.empty_like(truth)
    follows = state[0]
    for i in range(truth.size):
        if np.isnan(follows):
            follows = truth[i]
        elif not np.isnan(truth[i]):
            follows = min(max(follows, truth[i] - half[i]), truth[i] + half[i])
        out[i] = follows - truth[i]
    state[0] = follows
    return out


class Drift(SensorFault):
    """The zero walks away: the rate follows the severity, so what has drifted stays.

    By the line's law the offset is the severity's integral. The others' rates are in proportion to the
    severity likewise, and their time goes on while there is any; the walk's variance grows evenly.
    """

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._gained, self._severity, self._time, self._drifting = 0.0, 0.0, 0.0, 0.0
        self._rng = generator(seed, f"drift{stream}")

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        severity = self.spec.over(time)
        before = np.concatenate([[self._severity], severity[:-1]])
        gained = before * self._course(np.diff(time, prepend=self._time), before)
        # Carried into the sum as its first term: adding it afterwards would round otherwise.
        gained = np.cumsum(np.concatenate([[self._gained], gained]))[1:]
        if time.size:
            self._gained, self._severity, self._time = gained[-1], severity[-1], time[-1]
        values += self.scales.pressure_drift * gained
        return values

    def _course(self, passed: Array, before: Array) -> Array:
        """How long the line takes for what the law drifts from row to row at severity 1, (n,) s."""
        law = self.spec.law
        if law == "walk":
            return np.sqrt(DRIFTED * passed) * self._rng.standard_normal(passed.size)
        if law not in ("root", "settling"):
            return passed
        drifting = np.cumsum(np.concatenate([[self._drifting], np.where(before > 0.0, passed, 0.0)]))
        self._drifting = drifting[-1]
        if law == "root":
            return np.diff(np.sqrt(DRIFTED * drifting))
        # After three time constants, 95 % of the bound.
        return np.diff(-DRIFTED * np.expm1(-3.0 * drifting / DRIFTED))


class Slip(SensorFault):
    """The position encoder's zero walks, see `PositionSlip`."""

    channel = "position"

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._slip = PositionSlip(spec, seed, stream)

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        # It slips from one millisecond to the next, as the controller sees it.
        each = round(PERIOD / self.period)
        values += np.repeat(self._slip.offset(first_row // each, time.size // each), each)
        return values


SENSOR_FAULTS: dict[str, type[SensorFault]] = {
    "pressure_sensor_bias": Bias,
    "pressure_sensor_drift": Drift,
    SLIP: Slip,
    DROPOUT: Dropout,
}
"""Fault to what it does; faults that are not listed are the plant's."""


def sensor_fault(spec: FaultSpec) -> type[SensorFault] | None:
    """What a fault does to its channel, None for a fault of the plant.

    Raises
    ------
    InputError : a variant that is unknown.

    Examples
    --------
    >>> sensor_fault(FaultSpec(fault="sensor_dropout", severity=1.0, variant="late")).__name__
    'Late'
    """
    return dropout_kind(spec) if spec.fault == DROPOUT else SENSOR_FAULTS.get(spec.fault)


def struck_channel(spec: FaultSpec, recording: Recording | None = None) -> str | None:
    """The channel that a fault falsifies, None for a fault of the plant.

    In a log without differential pressure its faults are those of chamber 1's transducer.

    Examples
    --------
    >>> struck_channel(FaultSpec(fault="pressure_sensor_bias", severity=1.0))
    'pressure_difference'
    """
    kind = sensor_fault(spec)
    if kind is None:
        return None
    channel = DROPOUTS[spec.variant or "missing"][0] if kind is Dropout else kind.channel
    if channel == "pressure_difference" and recording is not None and not recording.has(channel):
        return "pressure_1"
    return channel
