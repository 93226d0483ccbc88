"""What balances are written in: pressures, flows and motion from bins, whichever sensors there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fdd.measures import ATMOSPHERE_PA
from fdd.residuals.bins import COLUMNS, FRAME_BINS, held_on
from fdd.residuals.compiled import Array, Flags
from fdd.residuals.oil import free_air, stiff_compliance, viscosity_ratio
from fdd.unit import Unit

VALVE_MARGIN_PA = 5e3
"""How far above the accumulator a chamber must be for its check valve to be surely shut."""
PILOT = 4.0
"""Area of a pilot piston over its valve's seat, the largest that is usual: as many times the other chamber's
pressure above the accumulator's holds the valve open."""
LEAST_DROP = 3e-3
"""Of relief pressure: drop between the chambers that a pressure sensor's noise does not turn round."""
LINE_LOSS = 0.015
"""Of the relief setting, what a line loses at the pump's full flow, at most: 20 kPa of 3.44 MPa by thesis eq.
3.33, two and a half times that where it is narrow."""


def outlet_loss(unit: Unit, speed: Array, side: int) -> Array:
    """Pa (n,) by which the port of chamber 1 or 2, where its check valve sits, may lie below it at a speed
    (n,) rad/s of the pump, which empties chamber 1 while it is negative."""
    share = np.minimum(speed if side == 1 else -speed, 0.0) / unit.drive.max_speed
    return np.asarray(LINE_LOSS * unit.accumulator.relief_pressure * share**2)


@dataclass(frozen=True)
class Scales:
    """A unit's own sizes, in which all columns are written, so that coefficients compare between sizes.

    Attributes
    ----------
    pressure : Pa, relief setting. charge : Pa absolute, of the accumulator. valve : Pa, drop of a sound
        refeeding valve at the pump's full flow. leakage : m³/(s·Pa), healthy across the ports. friction : N,
        Coulomb, with what a seal needs to break away in. current : A at relief pressure. speed : rad/s, the
        drive's. fault_leakage : m³/(s·Pa), of severity 1. orifice : m³/(s·√Pa), the same.
    """

    pressure: float
    charge: float
    valve: float
    leakage: float
    friction: float
    current: float
    speed: float
    fault_leakage: float
    orifice: float

    @classmethod
    def of(cls, unit: Unit) -> Scales:
        """Those of a profile."""
        pressure = unit.accumulator.relief_pressure
        branches = (unit.friction.forward, unit.friction.reverse)
        flow = unit.pump.displacement * unit.drive.max_speed
        gross = 12e-12 if 2e6 < pressure < 5e6 else 0.05 * flow / (0.5 * pressure)
        return cls(
            pressure=pressure,
            charge=unit.accumulator.charge_pressure + ATMOSPHERE_PA,
            valve=unit.accumulator.refeed_cracking_pressure + flow / unit.accumulator.refeed_flow_gain,
            leakage=unit.pump.total_leakage,
            friction=float(np.mean([b.coulomb for b in branches])),
            current=unit.pump.displacement * pressure / unit.drive.torque_constant,
            speed=unit.drive.max_speed,
            fault_leakage=gross,
            orifice=1e-4 / np.sqrt(1e6) * flow / 1.75e-4 * np.sqrt(3.44e6 / pressure),
        )


class Chamber(NamedTuple):
    """A chamber and its lines, amid bins.

    Attributes
    ----------
    sign : 1 for chamber 1, -1 for chamber 2. area : m² of its piston. pressure : (n,) Pa, of the bins.
    oil : (n,) m³. stiff : 1/Pa, of oil without air. free, air : (n,) 1/Pa, of free air a share, and of the
        unit's own. gas : (n,), volume of free air over that at atmospheric pressure.
    """

    sign: float
    area: float
    pressure: Array
    oil: Array
    stiff: float
    free: Array
    air: Array
    gas: Array


class Quantities:
    """Bins, and what follows from them, (n,) each; NaN where a sensor is missing.

    Parameters
    ----------
    bins : (n, len(COLUMNS)) of `BinMaker`, whole frames. unit : profile.
    accumulator_before : Pa, last known before the bins; NaN before its sensor's first value.

    Attributes
    ----------
    chambers_measured, accumulator_measured : (n,), whether both are, in the bin's frame or the one before.
    drop_measured : (n,) Pa, by both chambers or by the sensor of their difference. chambers : by side.
    noise : by side, (n,) Pa, standard deviation of the chamber's pressure.
    accumulator_before : Pa, last known at the end.
    """

    def __init__(self, bins: Array, unit: Unit, scales: Scales, accumulator_before: float = np.nan) -> None:
        self.unit, self.scales = unit, scales
        self.take = take = {name: bins[:, i] for name, i in COLUMNS.items()}
        self.position, self.angle = take["position"], take["pump_angle"]
        self.difference_measured = take["pressure_difference"]
        accumulator = take["pressure_accumulator"]
        known = held_on(accumulator, accumulator_before)
        self.accumulator_before = float(known[-1])
        self.accumulator_measured = _of_late(np.isfinite(accumulator))
        # Never measured: its gas takes what room a single rod leaves.
        tank, cylinder = unit.accumulator, unit.cylinder
        rod = (cylinder.area_1 - cylinder.area_2) * np.nan_to_num(self.position)
        gas = tank.gas_volume / np.maximum(tank.gas_volume + rod, 0.1 * tank.gas_volume)
        resting = (tank.charge_pressure + ATMOSPHERE_PA) * gas - ATMOSPHERE_PA
        known = np.where(np.isfinite(known), known, resting)
        self.accumulator = np.where(self.accumulator_measured, accumulator, known)
        self.p1, self.p2 = take["pressure_1"], take["pressure_2"]
        self.noise = {1: take["pressure_1_noise"], 2: take["pressure_2_noise"]}
        self.chambers_measured = _of_late(np.isfinite(self.p1) & np.isfinite(self.p2))
        if not self.chambers_measured.all():
            both, mean = self.chambers_measured, take["mean_pressure"]
            half = 0.5 * self.difference_measured
            self.p1 = np.where(both, self.p1, mean + half)
            self.p2 = np.where(both, self.p2, mean - half)
        self.chambers = {side: self._chamber(side) for side in (1, 2)}
        if not self.chambers_measured.all():
            own = take["pressure_difference_noise"]
            for side, noise in self.noise.items():
                self.noise[side] = np.where(both, noise, own * self._share(side))
        self.drop = self.p1 - self.p2
        self.drop_measured = np.where(self.chambers_measured, self.drop, self.difference_measured)
        self.turn, self.travel = change(self.angle), change(self.position)
        self.dt = change(take["time"])
        self.speed = self.turn / self.dt
        area = 0.5 * (cylinder.area_1 + cylinder.area_2)
        # Of the pump's flow: the position's noise must not enter a column.
        self.velocity = unit.pump.displacement * self.speed / area
        celsius = take["temperature"]
        warm = np.where(np.isfinite(celsius), celsius, unit.oil.reference_temperature)
        self.viscosity = viscosity_ratio(unit.oil, warm)

    def _chamber(self, side: int) -> Chamber:
        cylinder, oil = self.unit.cylinder, self.unit.oil
        sign, area, volume, p = {
            1: (1.0, cylinder.area_1, cylinder.volume_1, self.p1),
            2: (-1.0, cylinder.area_2, cylinder.volume_2, self.p2),
        }[side]
        gas, free = free_air(middle(p), oil.polytropic_index)
        held = volume + sign * area * middle(self.position)
        return Chamber(sign, area, p, held, stiff_compliance(oil), free, oil.air_fraction * free, gas)

    def _share(self, side: int) -> Array | float:
        """What a chamber's pressure changes by with the measured difference, (n,): all of it while the lower
        chamber is held at the accumulator's pressure, else the less the softer it is."""
        if self.unit.cylinder.needs_pilots:
            return 1.0
        least = self.accumulator - self.unit.accumulator.refeed_cracking_pressure
        soft = {k: c.oil * (c.stiff + c.air) for k, c in self.chambers.items()}
        fed = np.minimum(self.p1, self.p2) < least + 1.0
        return np.where(fed, 1.0, soft[3 - side] / (soft[1] + soft[2]))


def fed_chambers(q: Quantities) -> dict[int, Flags]:
    """Where the accumulator may feed a chamber, or take its oil, over the check valve: by side, (n,)."""
    # The higher chamber is shut where the accumulator lies below it. The lower one may give oil back through
    # a valve that the other chamber's pressure holds open, but where the unit was seen to keep it. What feeds
    # it may not be measured, then by its cracking pressure. A line loses pressure between valve and sensor.
    known = q.chambers_measured & q.accumulator_measured
    higher = LEAST_DROP * q.scales.pressure
    lower = np.inf if q.unit.accumulator.refeed_pilots else VALVE_MARGIN_PA + higher
    sure = max(VALVE_MARGIN_PA + q.unit.accumulator.refeed_cracking_pressure, higher)
    loss = {side: outlet_loss(q.unit, np.nan_to_num(q.speed), side) for side in (1, 2)}
    fed = {}
    for side, p, drop in ((1, q.p1, q.drop - loss[1]), (2, q.p2, -q.drop - loss[2])):
        margin = np.where(drop > higher, VALVE_MARGIN_PA + loss[side], lower + loss[1] + loss[2])
        fed[side] = np.where(known, ~(p >= q.accumulator + margin), ~(drop > sure))
    if q.unit.cylinder.needs_pilots:
        for side, p, other in ((1, q.p1, q.p2), (2, q.p2, q.p1)):
            fed[side] |= known & ~(p - q.accumulator > PILOT * (other - q.accumulator))
    return fed


def _of_late(there: Flags) -> Flags:
    """Whether anything is there in a bin's frame or in the one before, (n,)."""
    frames: Flags = np.asarray(there.reshape(-1, FRAME_BINS).any(axis=1))
    frames[1:] |= frames[:-1].copy()
    return np.repeat(frames, FRAME_BINS)


def change(column: Array) -> Array:
    """Change from the bin before, (n,); NaN first."""
    out = np.full(column.shape, np.nan)
    out[1:] = column[1:] - column[:-1]
    return out


def central(column: Array) -> Array:
    """Change from the bin before to the next one, (n,); NaN first and last."""
    out = np.full(column.shape, np.nan)
    out[1:-1] = column[2:] - column[:-2]
    return out


def middle(column: Array) -> Array:
    """Mean of a bin and the one before: what goes with a difference."""
    out = np.full(column.shape, np.nan)
    out[1:] = 0.5 * (column[1:] + column[:-1])
    return out


def settled(valid: Flags, bins: int) -> Flags:
    """Where the last `bins` bins were all valid."""
    count = np.arange(1, valid.size + 1)
    last_bad = np.maximum.accumulate(np.where(valid, 0, count))
    return count - last_bad >= bins
