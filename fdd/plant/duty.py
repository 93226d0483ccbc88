"""Duties: what the actuator is asked to do, as one set-point per millisecond.

In position control the set-point is a position: `offset` plus a shape of `amplitude` metres. In
speed control it is a pump speed: the shape times `speed` rad/s, and the piston starts at `offset`.
Every duty rests for `lead_in` seconds first.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.signal import butter, sosfilt

from fdd.errors import InputError
from fdd.plant import PERIOD, AnyProgramme, Array, Programme, Ranges, Validated

Seconds = Annotated[float, Field(gt=0.0, le=600.0)]
Frequency = Annotated[float, Field(gt=0.0, le=100.0)]


class Duty(Validated):
    """What every duty has.

    Attributes
    ----------
    amplitude : m, largest departure from `offset` in position control.
    speed : rad/s, largest set-point in speed control.
    offset : m, middle of the motion, where the piston starts.
    lead_in : s at rest at the start.
    """

    usual: ClassVar[Ranges] = {}
    """Ranges that a campaign draws from."""

    amplitude: Annotated[float, Field(ge=0.0, le=2.0)] = 0.05
    speed: Annotated[float, Field(ge=0.0, le=2000.0)] = 100.0
    offset: Annotated[float, Field(ge=-2.0, le=2.0)] = 0.0
    lead_in: Annotated[float, Field(ge=0.0, le=600.0)] = 0.5

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        """The motion between -1 and 1, (n,) for (n,) seconds since the end of the rest."""
        return np.zeros_like(time)

    def setpoint(self, n: int, position: bool, rng: np.random.Generator) -> Array:
        """The set-point, (n,), m in position control and rad/s in speed control."""
        time = self.moving(n)
        shape = np.zeros(n)
        shape[n - time.size :] = self.shape(time, rng)
        return self.offset + self.amplitude * shape if position else self.speed * shape

    def moving(self, n: int) -> Array:
        """Seconds since the end of the rest, of those of n milliseconds that come after it."""
        return np.arange(n - min(round(self.lead_in / PERIOD), n), dtype=np.float64) * PERIOD


class Standstill(Duty):
    """Nothing moves: the position is held, or the pump commanded to stand."""

    name: Literal["standstill"] = "standstill"
    amplitude: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0


class Steps(Duty):
    """Steps to random levels, each held for a random time around `hold`."""

    usual: ClassVar[Ranges] = {"amplitude": (0.005, 0.1), "speed": (30.0, 280.0), "hold": (0.5, 4.0)}
    name: Literal["steps"] = "steps"
    hold: Seconds = 2.0

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        return _held(time, self.hold, rng, lambda k: rng.uniform(-1.0, 1.0, k))


class Sines(Duty):
    """A sum of sines of random phase, scaled to the amplitude."""

    usual: ClassVar[Ranges] = {
        "amplitude": (0.002, 0.08), "speed": (30.0, 250.0), "low_hz": (0.05, 0.5), "high_hz": (1.0, 10.0),
    }  # fmt: skip
    name: Literal["sines"] = "sines"
    low_hz: Frequency = 0.2
    high_hz: Frequency = 3.0
    count: Annotated[int, Field(ge=1, le=32)] = 4
    tilt: Annotated[float, Field(ge=0.0, le=3.0)] = 1.0
    """Amplitude of each goes with frequency to minus this power."""

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        frequencies = np.geomspace(self.low_hz, max(self.high_hz, self.low_hz), self.count)
        weights = frequencies**-self.tilt
        phases = rng.uniform(0.0, 2.0 * np.pi, self.count)
        total = np.zeros_like(time)
        for frequency, weight, phase in zip(frequencies, weights, phases, strict=True):
            total += weight / weights.sum() * np.sin(2.0 * np.pi * frequency * time + phase)
        start = 1.0 - np.exp(-((time / 0.2) ** 2))  # no jump at the end of the rest
        return np.asarray(total * start)


class Sweep(Duty):
    """A logarithmic chirp, repeated."""

    usual: ClassVar[Ranges] = {
        "amplitude": (0.002, 0.03), "speed": (30.0, 150.0), "stop_hz": (5.0, 50.0), "period": (10.0, 40.0),
    }  # fmt: skip
    name: Literal["sweep"] = "sweep"
    start_hz: Frequency = 0.1
    stop_hz: Frequency = 20.0
    period: Seconds = 20.0

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        rate = np.log(self.stop_hz / self.start_hz) / self.period
        if abs(rate) < 1e-9:
            return np.asarray(np.sin(2.0 * np.pi * self.start_hz * time))
        within = np.mod(time, self.period)
        return np.asarray(np.sin(2.0 * np.pi * self.start_hz / rate * np.expm1(rate * within)))


class Prbs(Duty):
    """A random telegraph between the amplitude and its negative."""

    usual: ClassVar[Ranges] = {"amplitude": (0.002, 0.03), "speed": (20.0, 200.0), "bit": (0.05, 0.6)}
    name: Literal["prbs"] = "prbs"
    bit: Seconds = 0.2

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        bits = rng.integers(0, 2, int(time.size * PERIOD / self.bit) + 1).astype(np.float64) * 2.0 - 1.0
        return bits[np.minimum((time / self.bit).astype(np.int64), bits.size - 1)]


class Sawtooth(Duty):
    """Out slowly and back fast, without rest."""

    usual: ClassVar[Ranges] = {
        "amplitude": (0.01, 0.1), "speed": (40.0, 250.0), "period": (3.0, 15.0), "rise": (0.3, 0.85),
    }  # fmt: skip
    name: Literal["sawtooth"] = "sawtooth"
    period: Seconds = 8.0
    rise: Annotated[float, Field(gt=0.02, lt=0.98)] = 0.7
    """Share of the period on the way out."""

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        phase = np.mod(time / self.period + 0.5 * self.rise, 1.0)
        return np.asarray(np.interp(phase, [0.0, self.rise, 1.0], [-1.0, 1.0, -1.0]))


class Strokes(Duty):
    """Strokes at constant velocity with a rest at each end (trapezoids)."""

    usual: ClassVar[Ranges] = {"amplitude": (0.02, 0.11), "rate": (0.01, 0.09), "dwell": (0.1, 2.0)}
    name: Literal["strokes"] = "strokes"
    rate: Annotated[float, Field(gt=0.0, le=2.0)] = 0.03
    """m/s; for speed control see `ConstantSpeed`."""
    dwell: Seconds = 0.5

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        stroke = 2.0 * max(self.amplitude, 1e-6) / self.rate
        corners = np.cumsum([0.0, 0.5 * stroke, self.dwell, stroke, self.dwell, 0.5 * stroke])
        levels = [0.0, 1.0, 1.0, -1.0, -1.0, 0.0]
        return np.asarray(np.interp(np.mod(time, corners[-1]), corners, levels))


class Flight(Duty):
    """A control surface in cruise: positions held, small corrections all the time, now and then a move."""

    usual: ClassVar[Ranges] = {
        "amplitude": (0.01, 0.08), "speed": (20.0, 120.0), "hold": (2.0, 8.0), "corrections": (0.01, 0.08),
    }  # fmt: skip
    name: Literal["flight"] = "flight"
    hold: Seconds = 4.0
    corrections: Annotated[float, Field(ge=0.0, le=0.5)] = 0.03
    """Standard deviation of the corrections over the amplitude."""
    bandwidth_hz: Annotated[float, Field(gt=0.0, le=50.0)] = 1.0

    def shape(self, time: Array, rng: np.random.Generator) -> Array:
        if time.size == 0:
            return np.zeros(0)
        held = _held(time, self.hold, rng, lambda k: np.clip(0.4 * rng.standard_normal(k), -0.8, 0.8))
        held = np.asarray(sosfilt(butter(2, 1.5, fs=1.0 / PERIOD, output="sos"), held))
        low_pass = butter(2, self.bandwidth_hz, fs=1.0 / PERIOD, output="sos")
        noise = sosfilt(low_pass, rng.standard_normal(time.size))
        noise = noise / np.sqrt(1.1107 * self.bandwidth_hz * 2.0 * PERIOD)
        return np.clip(held + self.corrections * noise, -1.0, 1.0)


class Resting(Flight):
    """An axis that mostly stands: held for long, corrected by hundredths of a millimetre."""

    usual: ClassVar[Ranges] = {
        "amplitude": (0.01, 0.08), "hold": (20.0, 120.0), "corrections": (0.0003, 0.01),
    }  # fmt: skip
    name: Literal["resting"] = "resting"  # type: ignore[assignment]
    hold: Seconds = 60.0
    corrections: Annotated[float, Field(ge=0.0, le=0.5)] = 0.002


class ConstantSpeed(Duty):
    """Strokes at constant pump speed between ± amplitude, in speed control: how leakage and friction
    are measured. The next of `speeds` is taken every `turn` seconds."""

    usual: ClassVar[Ranges] = {"amplitude": (0.02, 0.11), "dwell": (0.0, 2.0)}
    name: Literal["constant_speed"] = "constant_speed"
    speeds: Annotated[
        tuple[Annotated[float, Field(gt=0.0, le=2000.0)], ...], Field(min_length=1, max_length=64)
    ] = (50.0, 105.0, 200.0)
    """rad/s."""
    turn: Seconds = 20.0
    dwell: Annotated[float, Field(ge=0.0, le=60.0)] = 0.5

    def setpoint(self, n: int, position: bool, rng: np.random.Generator) -> Array:
        time = np.arange(n) * PERIOD - self.lead_in
        levels = np.array(self.speeds)
        which = np.mod((np.maximum(time, 0.0) / self.turn).astype(np.int64), levels.size)
        return np.where(time >= 0.0, levels[which], 0.0)


class Levels(Duty):
    """Set-points as the user writes them: held, or linear in between.

    Attributes
    ----------
    points : times (s after the rest) and set-points: m from `offset` in position control, rad/s in speed
        control. The first one's set-point holds from the end of the rest.
    linear : straight lines between the points instead of steps.
    amplitude, speed : taken from the points.
    """

    name: Literal["levels"] = "levels"
    points: AnyProgramme = Programme(points=((0.0, 0.0), (1.0, 0.03)))
    linear: bool = False
    amplitude: Annotated[float, Field(ge=0.0, le=2000.0)] = 0.0
    speed: Annotated[float, Field(ge=0.0, le=2000.0)] = 0.0
    lead_in: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0

    @model_validator(mode="after")
    def _reach(self) -> Levels:
        most = max(abs(self.points.least), abs(self.points.most))
        if most > 2000.0:
            raise InputError(f"set-point {most:g} is out of range", mend="use m, or up to 2000 rad/s")
        object.__setattr__(self, "amplitude", most)
        object.__setattr__(self, "speed", most)
        return self

    def setpoint(self, n: int, position: bool, rng: np.random.Generator) -> Array:
        time = self.moving(n)
        if self.linear:
            levels = self.points.over(time)
        else:
            times, values = np.array(self.points.points).T
            # Half a tick of grace: 0.3 s is the 300th millisecond, whatever the rounding.
            before = np.searchsorted(times, time + 0.5 * PERIOD, side="right") - 1
            levels = values[np.maximum(before, 0)]
        return np.concatenate([np.zeros(n - time.size), levels]) + (self.offset if position else 0.0)


class Replay(Duty):
    """A given set-point, one value a millisecond, the last one held: signals that no other duty makes.

    For test signals of one's own, as the thesis's chapters 5 to 7 use them. It has no usual ranges and no
    form on the command line, so it is not in `DUTIES`.

    Examples
    --------
    >>> Replay(values=(1.0, 2.0)).setpoint(4, False, np.random.default_rng(0)).tolist()
    [1.0, 2.0, 2.0, 2.0]
    """

    name: Literal["replay"] = "replay"
    values: Annotated[tuple[float, ...], Field(min_length=1, max_length=600_000)]
    """m in position control, measured from mid-stroke; rad/s in speed control."""
    amplitude: Annotated[float, Field(ge=0.0, le=2.0)] = 0.0

    def setpoint(self, n: int, position: bool, rng: np.random.Generator) -> Array:
        given = np.array(self.values[:n])
        return np.concatenate([given, np.full(n - given.size, given[-1])])


Stage = Annotated[
    Standstill | Steps | Sines | Sweep | Prbs | Sawtooth | Strokes | Flight | Resting | Levels,
    Field(discriminator="name"),
]
"""Duties that a mission is made of."""


class Mission(Duty):
    """One duty after another, each by position and for its own time; the last one goes on.

    Examples
    --------
    >>> stages = (Levels(points=((0.0, 0.01),)), Standstill(offset=0.02))
    >>> mission = Mission(stages=stages, seconds=(0.002, 1.0))
    >>> mission.setpoint(4, True, np.random.default_rng(0)).tolist()
    [0.01, 0.01, 0.02, 0.02]
    """

    name: Literal["mission"] = "mission"
    stages: Annotated[tuple[Stage, ...], Field(min_length=1, max_length=64)] = (Standstill(),)
    seconds: Annotated[tuple[Seconds, ...], Field(min_length=1, max_length=64)] = (60.0,)
    """s of each stage."""

    @model_validator(mode="after")
    def _timed(self) -> Mission:
        if len(self.stages) != len(self.seconds):
            problem = f"{len(self.stages)} stages, {len(self.seconds)} times"
            raise InputError(problem, mend="give each stage its seconds")
        return self

    def setpoint(self, n: int, position: bool, rng: np.random.Generator) -> Array:
        ends = np.minimum(np.round(np.cumsum(self.seconds) / PERIOD).astype(np.int64), n)
        ends[-1] = n
        lengths = np.diff(ends, prepend=0)
        parts = [s.setpoint(int(k), position, rng) for s, k in zip(self.stages, lengths, strict=True)]
        return np.concatenate(parts)


def _held(time: Array, hold: float, rng: np.random.Generator, draw: Callable[[int], Array]) -> Array:
    """Levels that `draw(k)` gives, each held for 0.5 to 1.5 of `hold`."""
    count = int(time.size * PERIOD / (0.5 * hold)) + 2
    edges = np.cumsum(rng.uniform(0.5, 1.5, count) * hold)
    levels = draw(count)
    return np.asarray(levels[np.searchsorted(edges, time, side="right").clip(max=count - 1)])


AnyDuty = Annotated[Stage | ConstantSpeed | Replay | Mission, Field(discriminator="name")]

DUTIES: dict[str, type[Duty]] = {
    kind.model_fields["name"].default: kind
    for kind in (
        Standstill, Steps, Sines, Sweep, Prbs, Sawtooth, Strokes, Flight, ConstantSpeed, Levels, Resting,
        Mission,
    )
}  # fmt: skip
