"""What faults of sensors do to a measurement, each with a state that goes on from block to block.

Severity 0 leaves every number as it was, bit for bit.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.errors import InputError
from fdd.plant import PERIOD, Array
from fdd.plant.compiled import njit
from fdd.plant.faults import FaultScales, FaultSpec
from fdd.plant.sensors.recording import Recording, generator
from fdd.sections import Sensor

USUAL = FaultScales()
DRIFTED = 50.0
"""s after which a drift has come as far by whatever law."""
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
SLIP = "position_sensor_slip"
SLIPS_PER_SECOND = 1.0
SLIP_STEP = 1e-3
"""m, mean size of a slip at severity 1: with one a second, 1 % of the travel at 0.1 m/s."""
PLAY = 5e-3
"""m; the reader head's clamp ends the walk on either side (assumption), so that strokes stay possible."""
_AT_ONCE, _DRAWS = 256, 18
"""Slips that are drawn at once, and how often: an hour, the longest run, takes 3600 of these 4608."""


class SensorFault:
    """Effect of a fault on its channel's sensor: `distort` before range and rounding, `replace` after it.

    `seed` is the scenario's, `stream` tells axes apart, `scales` are the figures of severity 1, `period` (s)
    lies between rows.
    """

    channel = "pressure_difference"
    purpose = ""
    """Of its random stream."""
    first_state: tuple[float, float] = (np.nan, np.nan)
    """What its compiled loop, where it has one, remembers at first."""

    def __init__(
        self, spec: FaultSpec, sensor: Sensor, seed: int, stream: str = "", scales: FaultScales = USUAL,
        period: float = PERIOD,
    ) -> None:  # fmt: skip
        self.spec, self.sensor, self.scales, self.period = spec, sensor, scales, period
        self.seed, self.stream = seed, stream
        self._rng = generator(seed, f"{self.purpose}{stream}")
        self._state = np.array(self.first_state)

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        """What the sensor gives instead of `values` (n,), which may change, before range and rounding.

        Of the `truth` (n,) that is there at `time` (n,) s, from row `first_row` on.
        """
        return values

    def replace(self, values: Array, time: Array) -> Array:
        """What the log has instead of the values (n,); they may be overwritten."""
        return values


class Bias(SensorFault):
    """Zero error of the transmitter, error of its gain, or hysteresis of its diaphragm.

    Hysteresis is the play operator: the reading follows only where the pressure has turned by twice the
    error (Krasnosel'skii and Pokrovskii 1989, doi:10.1007/978-3-642-61302-9). It begins in the middle.
    """

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        severity = self.spec.over(time)
        if self.spec.law == "gain":
            values *= 1.0 + self.scales.pressure_gain * severity
        elif self.spec.law == "hysteresis":
            values += _play(truth, self.scales.pressure_bias * severity, self._state)
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

    purpose = "drift"
    _gained = _severity = _time = _drifting = 0.0

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
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


@lru_cache(maxsize=8)
def slips(spec: FaultSpec, seed: int, stream: str = "") -> tuple[NDArray[np.int64], Array]:
    """Milliseconds at which a slipping position encoder's zero jumps, and where it is from then on (m).

    The reader head, or the rail that couples it to the rod (thesis A.1.2, figure A.4), slips in its clamp: at
    times of a Poisson process the zero jumps by ``severity·SLIP_STEP`` times 0.5 to 1.5, to either
    side, and stays where it then is; walls at ± `PLAY` reflect it. It depends on time and seed alone, not on
    the motion, so that plant and log can each ask for it. An assumption: the thesis tells of no slip.
    """
    rng = generator(seed, f"position slip{stream}")
    rows, offsets, time, offset = [0], [0.0], 0.0, 0.0
    for _ in range(_DRAWS):
        times = np.cumsum(np.append(time, rng.exponential(1.0 / SLIPS_PER_SECOND, _AT_ONCE)))[1:]
        sizes, sides = rng.random(_AT_ONCE), rng.random(_AT_ONCE)
        struck = np.ceil(times / PERIOD).astype(np.int64)
        severity = spec.over(np.asarray(struck * PERIOD, dtype=np.float64))
        steps = severity * SLIP_STEP * (0.5 + sizes) * np.where(sides < 0.5, 1.0, -1.0)
        for step in steps.tolist():
            offset += step
            if abs(offset) > PLAY:
                offset = (2.0 * PLAY - abs(offset)) * (1.0 if offset > 0.0 else -1.0)
            offsets.append(offset)
        rows += struck.tolist()
        time = float(times[-1])
    return np.array(rows), np.array(offsets)


def position_offset(faults: list[FaultSpec], first_row: int, n: int, seed: int, stream: str = "") -> Array:
    """What slipping adds to the position encoder's reading in n milliseconds from `first_row` on, (n,) m,
    both the controller's and the log's; zero without the fault."""
    total, wanted = np.zeros(n), np.arange(first_row, first_row + n)
    for spec in faults:
        if spec.fault == SLIP:
            rows, offsets = slips(spec, seed, stream)
            total += offsets[np.searchsorted(rows, wanted, side="right") - 1]
    return total


class Slip(SensorFault):
    """The position encoder's zero walks, see `slips`."""

    channel = "position"

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        # It slips from one millisecond to the next, as the controller sees it.
        each = round(PERIOD / self.period)
        slipped = position_offset([self.spec], first_row // each, time.size // each, self.seed, self.stream)
        values += np.repeat(slipped, each)
        return values


class Dropout(SensorFault):
    """A loose contact: the channel is lost for the share of time that the severity says.

    Two states, with the chances in a row of ``severity/m`` to be lost and ``(1 - severity)/m`` to come back,
    m rows being `CONTACT_TIME`: in the long run exactly that share is lost, in bursts.

    Refuses a broken loop, with an `InputError`, where the channel has none.
    """

    purpose = "dropout"
    first_state = (0.0, np.nan)

    def __init__(self, spec: FaultSpec, sensor: Sensor, *more: Any) -> None:
        super().__init__(spec, sensor, *more)
        self.channel, self._shows = DROPOUTS[spec.variant or "missing"]
        self._dead = np.nan
        if self._shows == "dead":
            if sensor.loop is None:
                problem = f"fault {spec.fault}: {self.channel} has no current loop that could break"
                raise InputError(problem, mend="give the unit's sensor a loop, or use variant missing")
            self._dead = -sensor.loop.offset

    def replace(self, values: Array, time: Array) -> Array:
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


class Noisy(SensorFault):
    """White noise from behind the transducer, as by a broken shield: no band limit holds it."""

    purpose = "noisy"

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        values += self.scales.noise_pressure * self.spec.over(time) * self._rng.standard_normal(time.size)
        return values


class Sticking(SensorFault):
    """The reading stays until the pressure is beyond a band about where it stuck, then sticks anew there."""

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        _stick(values, truth, self.scales.sticking_pressure * self.spec.over(time), self._state)
        return values


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


class Clipped(SensorFault):
    """The amplifier saturates: the reading ends at a limit that falls with the severity."""

    def distort(self, values: Array, truth: Array, time: Array, first_row: int) -> Array:
        severity = self.spec.over(time)
        limit = np.where(severity > 0.0, self.scales.clipping_pressure * (1.0 - severity), np.inf)
        return np.minimum(values, limit)


class Late(SensorFault):
    """Samples wait on their way: the last one is repeated meanwhile, then the log has caught up.

    Each that comes through is followed by a wait drawn evenly between zero and the longest. Of what is read
    the age is a third of the longest wait on average, and never more than the longest.
    """

    purpose = "late samples"
    first_state = (-np.inf, np.nan)

    def replace(self, values: Array, time: Array) -> Array:
        wait = self.scales.late_time * self.spec.over(time) * self._rng.random(time.size)
        _wait(values, time, wait, self._state)
        return values


@njit(error_model="numpy")
def _wait(values: Array, time: Array, wait: Array, state: Array) -> None:
    until, shown = state[0], state[1]
    for i in range(values.size):
        if wait[i] <= 0.0 or time[i] >= until:
            until, shown = time[i] + wait[i], values[i]
        values[i] = shown
    state[0], state[1] = until, shown


DEGRADED: dict[str, type[SensorFault]] = {
    "noisy": Noisy, "sticking": Sticking, "clipped": Clipped, "late": Late,
}  # fmt: skip
"""Variants of a channel that is there and wrong."""

SENSOR_FAULTS: dict[str, type[SensorFault]] = {
    "pressure_sensor_bias": Bias, "pressure_sensor_drift": Drift, SLIP: Slip, DROPOUT: Dropout,
}  # fmt: skip
"""Fault to what it does; faults that are not listed are the plant's."""


def sensor_fault(spec: FaultSpec) -> type[SensorFault] | None:
    """What a fault does to its channel, None for a fault of the plant."""
    usual = SENSOR_FAULTS.get(spec.fault)
    return DEGRADED.get(spec.variant or "", usual) if spec.fault == DROPOUT else usual


def struck_channel(spec: FaultSpec, recording: Recording | None = None) -> str | None:
    """The channel that a fault falsifies, None for a fault of the plant; chamber 1's pressure in a log
    without the difference."""
    kind = sensor_fault(spec)
    if kind is None:
        return None
    channel = DROPOUTS[spec.variant or "missing"][0] if kind is Dropout else kind.channel
    if channel == "pressure_difference" and recording is not None and not recording.has(channel):
        return "pressure_1"
    return channel
