"""What faults of sensors do to a measurement, each with a state that goes on from block to block.

One class per fault and one table; a new fault is a catalogue entry and a line here. Severity 0
leaves every number as it was, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.plant.compiled import njit
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.sensors.recording import PERIOD, Recording
from fdd.plant.sensors.slip import SLIP, PositionSlip
from fdd.plant.sensors.streams import generator
from fdd.sensor import Sensor

Array = NDArray[np.float64]

USUAL = FaultScales()
CONTACT_TIME = 0.1
"""s, of a loose contact: it stays open for this time on average at small severity (assumption)."""
DROPOUTS = {
    "missing": ("pressure_difference", "nan"),
    "held": ("pressure_difference", "held"),
    "broken_loop": ("pressure_difference", "dead"),
    "position_missing": ("position", "nan"),
    "position_held": ("position", "held"),
}
"""Variant of `sensor_dropout` to the channel that it strikes and what is there meanwhile: NaN, the last
value again, or what a current loop at 0 mA reads."""


class SensorFault:
    """Effect on one channel: `offset` before range and rounding, `replace` after it.

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

    def offset(self, time: Array, first_row: int) -> Array | None:
        """What is added to the rows taken at `time` (n,) s, (n,); None for nothing."""
        return None

    def replace(self, values: Array, time: Array) -> Array:
        """What the log has instead of the values (n,); they may be overwritten."""
        return values


class Bias(SensorFault):
    """A constant: zero error of the transmitter."""

    def offset(self, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        return self.scales.pressure_bias * self.spec.over(time)


class Drift(SensorFault):
    """A ramp: the rate follows the severity, the offset is its integral, so what has drifted stays."""

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._gained, self._severity, self._time = 0.0, 0.0, 0.0

    def offset(self, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        severity = self.spec.over(time)
        before = np.concatenate([[self._severity], severity[:-1]])
        gained = before * np.diff(time, prepend=self._time)
        # Carried into the sum as its first term: adding it afterwards would round otherwise.
        gained = np.cumsum(np.concatenate([[self._gained], gained]))[1:]
        if time.size:
            self._gained, self._severity, self._time = gained[-1], severity[-1], time[-1]
        return self.scales.pressure_drift * gained


class Slip(SensorFault):
    """The position encoder's zero walks, see `PositionSlip`."""

    channel = "position"

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._slip = PositionSlip(spec, seed, stream)

    def offset(self, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        # It slips from one millisecond to the next, as the controller sees it.
        each = round(PERIOD / self.period)
        return np.repeat(self._slip.offset(first_row // each, time.size // each), each)


class Dropout(SensorFault):
    """A loose contact: the channel is lost for the share of time that the severity says.

    Two states, with the chances in a row of ``severity/m`` to be lost and ``(1 - severity)/m`` to come back,
    m rows being `CONTACT_TIME`: in the long run exactly that share is lost, in bursts.

    Raises
    ------
    InputError : the variant's channel has no current loop, or the variant is unknown.
    """

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self.channel, self._shows = _dropout(spec)
        self._dead = np.nan
        if self._shows == "dead":
            if sensor.loop is None:
                raise InputError(
                    f"fault {spec.fault}: {self.channel} has no current loop that could break",
                    mend="give the unit's sensor a loop, or use variant missing",
                )
            self._dead = -sensor.loop.offset
        self._rng = generator(seed, f"dropout{stream}")
        # Whether it is lost, and the last value that was seen.
        self._state = np.array([0.0, np.nan])

    def replace(self, values: Array, time: Array) -> Array:
        """See `SensorFault`."""
        severity, drawn = self.spec.over(time), self._rng.random(time.size)
        rows = CONTACT_TIME / self.period
        _drop(values, severity, drawn, rows, self._shows == "held", self._dead, self._state)
        return values


@njit(error_model="numpy")
def _drop(
    values: Array, severity: Array, drawn: Array, rows: float, held: bool, instead: float, state: Array
) -> None:
    lost, last = state[0] > 0.0, state[1]
    for i in range(values.size):
        if severity[i] <= 0.0:
            lost = False
        elif lost:
            lost = drawn[i] >= (1.0 - severity[i]) / rows
        else:
            lost = drawn[i] < severity[i] / rows
        if lost:
            values[i] = last if held else instead
        else:
            last = values[i]
    state[0], state[1] = 1.0 if lost else 0.0, last


def _dropout(spec: FaultSpec) -> tuple[str, str]:
    variant = spec.variant or "missing"
    if variant not in DROPOUTS:
        raise InputError(
            f"fault {spec.fault}: variant {variant!r} is not possible",
            mend=f"use one of: {', '.join(DROPOUTS)}",
        )
    return DROPOUTS[variant]


SENSOR_FAULTS: dict[str, type[SensorFault]] = {
    "pressure_sensor_bias": Bias,
    "pressure_sensor_drift": Drift,
    SLIP: Slip,
    "sensor_dropout": Dropout,
}
"""Fault to what it does; faults that are not listed are the plant's."""


def struck_channel(spec: FaultSpec, recording: Recording | None = None) -> str | None:
    """The channel that a fault falsifies, None for a fault of the plant.

    In a log without differential pressure its faults are those of chamber 1's transducer.

    Examples
    --------
    >>> struck_channel(FaultSpec(fault="pressure_sensor_bias", severity=1.0))
    'pressure_difference'
    """
    kind = SENSOR_FAULTS.get(spec.fault)
    if kind is None:
        return None
    channel = _dropout(spec)[0] if kind is Dropout else kind.channel
    if channel == "pressure_difference" and recording is not None and not recording.has(channel):
        return "pressure_1"
    return channel
