"""What a unit's profile says that a channel can show: range, noise, counts, rates.

Everything here is physics or a data sheet: nothing is learnt from logs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdd.measures import ATMOSPHERE_PA
from fdd.samples import CHANNELS
from fdd.unit import Unit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NAMES = tuple(c for c in CHANNELS if c != "time")
INDEX = {name: k for k, name in enumerate(NAMES)}
ANGLE, SPEED, POSITION = INDEX["pump_angle"], INDEX["pump_speed"], INDEX["position"]
ONE, TWO, DIFFERENCE = INDEX["pressure_1"], INDEX["pressure_2"], INDEX["pressure_difference"]
ACCUMULATOR = INDEX["pressure_accumulator"]
NOT_MEASURED = ("command", "position_setpoint")
"""Numbers that a controller wrote: they may be anything, and only their absence is reported."""
LIVE = (
    "pressure_1", "pressure_2", "pressure_difference", "pressure_accumulator", "motor_current", "load_force",
)  # fmt: skip
"""Analogue channels, which noise keeps moving. Counts of an encoder and a slow thermocouple may stand."""
IS_LIVE = np.array([n in LIVE for n in NAMES])
IS_MEASURED = np.array([n not in NOT_MEASURED for n in NAMES])
SIGMA = 8.0
"""Standard deviations that noise does not reach: at 1 kHz and eight channels a Gaussian passes 8 once in
3e7 h; what is spent of that is for noise whose tails are heavier."""
PRESSURE_MARGIN = 1.5
"""A relief valve opens up to some tens of per cent above its setting (full flow, dynamics)."""
LOW_MARGIN = 0.03
"""Zero error of a plain transducer, as share of the relief setting that it was chosen for: 1 % of a range
that is up to three times that setting."""
STROKE_MARGIN = 1.1
SPEED_MARGIN = 1.3
"""Above nominal speed: overshoot of the loop, and a load that drives the pump."""
CURRENT_MARGIN = 3.0
"""A servomotor's peak is two to three times its continuous current, which may stand as the limit."""
STEADY_NOISE = 2.0
"""Noise of so many counts changes nearly every row: P(same value again) is q/(σ·√(4π)), 14 % at 2."""
COLOUR = 3.0
"""Noise that is band-limited to a tenth of the sampling rate repeats so much more often."""


class Limits(NamedTuple):
    """Per channel, in the order of `NAMES`, (12,) each, and of the unit; SI."""

    low: Array  # what a frame's median cannot be beyond, -inf where nothing is known
    high: Array  # likewise, inf where nothing is known
    noise: Array  # the profile's, as `resolution`
    resolution: Array
    repeat: Array  # chance that noise alone repeats a row's value; 1 where noise is below the counts
    rail: Array  # the highest reading of the sensor or its converter, NaN unknown
    dead: Array  # what a broken current loop reads, else 0
    pump_speed: float  # rad/s, largest
    acceleration: float  # rad/s², largest
    piston_speed: float  # m/s, largest
    release: float  # m/s², of the piston when its breakaway force is suddenly free
    lightness: float  # m/s² of the piston for each Pa of Δp, A/m
    softness: float  # m/Pa of the piston against the oil, with room for air
    stiffness: float  # Pa/m³ of the smaller chamber
    displacement: float
    area: float
    stroke: float
    leakage: float
    relief: float
    # Pa, Δp of a single-rod cylinder below which both its piloted check valves may be open, so that nothing
    # holds the piston; 0 of a cylinder of equal areas.
    loose: float

    @classmethod
    def of(cls, unit: Unit) -> Limits:
        """From a profile."""
        cylinder, pump, drive, relief = unit.cylinder, unit.pump, unit.drive, unit.accumulator.relief_pressure
        areas = (cylinder.area_1, cylinder.area_2)
        # A blocked differential cylinder multiplies the pressure by its ratio of areas.
        highest = PRESSURE_MARGIN * (relief * max(areas) / min(areas) + unit.accumulator.charge_pressure)
        lowest = -ATMOSPHERE_PA - LOW_MARGIN * relief
        bounds = {
            "pressure_1": (lowest, highest), "pressure_2": (lowest, highest),
            "pressure_accumulator": (lowest, highest), "pressure_difference": (-highest, highest),
            "position": (-STROKE_MARGIN * cylinder.stroke, STROKE_MARGIN * cylinder.stroke),
            "pump_speed": (-SPEED_MARGIN * drive.max_speed, SPEED_MARGIN * drive.max_speed),
            "motor_current": (-CURRENT_MARGIN * drive.current_limit, CURRENT_MARGIN * drive.current_limit),
            "oil_temperature": (-60.0, 200.0), "load_force": (-highest * max(areas), highest * max(areas)),
        }  # fmt: skip
        sensors = [unit.sensor(n) for n in NAMES]
        noise = np.array([s.noise for s in sensors])
        counts = np.array([s.resolution for s in sensors])
        steady = (noise > 0.0) & (noise >= STEADY_NOISE * counts)
        with np.errstate(divide="ignore", invalid="ignore"):
            chance = COLOUR * counts / (noise * np.sqrt(4.0 * np.pi))
        repeat = np.where(steady, np.clip(chance, 1e-3, 0.9), 1.0)
        rail = [s.loop.largest if s.loop is not None else s.high for s in sensors]
        volume = max(cylinder.volume_1, cylinder.volume_2) + 0.5 * max(areas) * cylinder.stroke
        smaller = min(cylinder.volume_1, cylinder.volume_2)
        torque = drive.torque_constant * drive.current_limit + pump.displacement * relief
        return cls(
            low=np.array([bounds.get(n, (-np.inf, np.inf))[0] for n in NAMES]),
            high=np.array([bounds.get(n, (-np.inf, np.inf))[1] for n in NAMES]),
            noise=noise, resolution=counts, repeat=repeat,
            rail=np.array([np.nan if r is None else r for r in rail]),
            dead=np.array([0.0 if s.loop is None else -s.loop.offset for s in sensors]),
            pump_speed=drive.max_speed, acceleration=torque / drive.inertia,
            piston_speed=1.5 * pump.displacement * drive.max_speed / min(areas),
            release=max(unit.friction.forward.static, unit.friction.reverse.static) / cylinder.moving_mass,
            lightness=max(areas) / cylinder.moving_mass,
            # Free air makes oil at low pressure some three times softer than the profile's value.
            softness=3.0 * volume / (unit.oil.bulk_modulus * min(areas)),
            # And at high pressure it is the oil's own, up to 1.5 GPa.
            stiffness=max(unit.oil.bulk_modulus, 1.5e9) / smaller,
            displacement=pump.displacement, area=min(areas), stroke=cylinder.stroke,
            leakage=pump.total_leakage, relief=relief,
            loose=unit.accumulator.charge_pressure if cylinder.needs_pilots else 0.0,
        )  # fmt: skip

    def row_bounds(self) -> Array:
        """Least and largest value of a row, largest change in a second (inf where none is known), and an
        allowance on that, (4, 12)."""
        reach = SIGMA * self.noise + self.resolution
        rate = np.full(reach.size, np.inf)
        rate[POSITION], rate[ANGLE] = self.piston_speed, 1.3 * self.pump_speed
        bounds = np.stack([self.low - reach, self.high + reach, rate, 4.0 * reach])
        # A speed that is a difference of counts over the nominal period doubles in a row a period late.
        bounds[:2, SPEED] *= 2.0
        return bounds


def figure(name: str, value: float) -> str:
    """A value with its unit, as people say it."""
    unit = CHANNELS[name].unit
    scale, shown = {"Pa": (1e-6, "MPa"), "m": (1e3, "mm")}.get(unit, (1.0, unit))
    return f"{value * scale:.4g} {shown}"
