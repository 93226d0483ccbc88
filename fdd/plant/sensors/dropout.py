"""A channel that is lost, noisy, stuck, saturated or late: the ways of `sensor_dropout`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.plant.compiled import njit
from fdd.plant.faults.scales import FaultScales
from fdd.plant.faults.spec import FaultSpec
from fdd.plant.sensors.sensor_fault import USUAL, SensorFault
from fdd.plant.sensors.streams import generator
from fdd.sensor import Sensor

Array = NDArray[np.float64]

DROPOUT = "sensor_dropout"
CONTACT_TIME = 0.1
"""s, of a loose contact: it stays open for this time on average at small severity (assumption)."""
DROPOUTS = {
    "missing": ("pressure_difference", "nan"),
    "held": ("pressure_difference", "held"),
    "broken_loop": ("pressure_difference", "dead"),
    "position_missing": ("position", "nan"),
    "position_held": ("position", "held"),
}
"""Variant of a loose contact to the channel that it strikes and what is there meanwhile: NaN, the last
value again, or what a current loop at 0 mA reads."""


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
        self.channel, self._shows = DROPOUTS[spec.variant or "missing"]
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


class Noisy(SensorFault):
    """White noise from behind the transducer, as by a broken shield: no band limit holds it."""

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._rng = generator(seed, f"noisy{stream}")

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        values += self.scales.noise_pressure * self.spec.over(time) * self._rng.standard_normal(time.size)
        return values


class Sticking(SensorFault):
    """The reading stays until the pressure is beyond a band about where it stuck, then sticks anew there."""

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        # Where it stuck: the pressure and the reading.
        self._state = np.array([np.nan, np.nan])

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        _stick(values, truth, self.scales.sticking_pressure * self.spec.over(time), self._state)
        return values


class Clipped(SensorFault):
    """The amplifier saturates: the reading ends at a limit that falls with the severity."""

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """See `SensorFault`."""
        severity = self.spec.over(time)
        limit = np.where(severity > 0.0, self.scales.clipping_pressure * (1.0 - severity), np.inf)
        return np.minimum(values, limit)


class Late(SensorFault):
    """Samples wait on their way: the last one is repeated meanwhile, then the log has caught up.

    Each that comes through is followed by a wait drawn evenly between zero and the longest. Of what is read
    the age is a third of the longest wait on average, and never more than the longest.
    """

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL
    ) -> None:
        super().__init__(spec, sensor, seed, stream, scales)
        self._rng = generator(seed, f"late samples{stream}")
        # Until when it waits, and what is repeated.
        self._state = np.array([-np.inf, np.nan])

    def replace(self, values: Array, time: Array) -> Array:
        """See `SensorFault`."""
        wait = self.scales.late_time * self.spec.over(time) * self._rng.random(time.size)
        _wait(values, time, wait, self._state)
        return values


DEGRADED: dict[str, type[SensorFault]] = {
    "noisy": Noisy,
    "sticking": Sticking,
    "clipped": Clipped,
    "late": Late,
}
"""Variants of a channel that is there and wrong."""


def dropout_kind(spec: FaultSpec) -> type[SensorFault]:
    """What the variant of a `sensor_dropout` does.

    Raises
    ------
    InputError : the variant is unknown.
    """
    variant = spec.variant or "missing"
    if variant in DROPOUTS:
        return Dropout
    if variant not in DEGRADED:
        raise InputError(
            f"fault {spec.fault}: variant {variant!r} is not possible",
            mend=f"use one of: {', '.join([*DROPOUTS, *DEGRADED])}",
        )
    return DEGRADED[variant]


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


@njit(error_model="numpy")
def _stick(values: Array, truth: Array, band: Array, state: Array) -> None:
    at, shown = state[0], state[1]
    for i in range(values.size):
        # Written so that it moves where either is NaN, too.
        stays = band[i] > 0.0 and abs(truth[i] - at) <= band[i]
        if not stays:
            at, shown = truth[i], values[i]
        values[i] = shown
    state[0], state[1] = at, shown


@njit(error_model="numpy")
def _wait(values: Array, time: Array, wait: Array, state: Array) -> None:
    until, shown = state[0], state[1]
    for i in range(values.size):
        if wait[i] <= 0.0 or time[i] >= until:
            until, shown = time[i] + wait[i], values[i]
        values[i] = shown
    state[0], state[1] = until, shown
