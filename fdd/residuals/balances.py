"""The balances of an EHA: linear regressions whose coefficients a fault changes.

Each balance is a linear model ``y = X b + e``, a row for each bin of 10 ms. Columns are scaled by the
profile, so that a healthy unit's coefficients are near one, or near zero for what a healthy unit lacks.

Symbols: D displacement, θ pump angle, A area, x position, p_i chamber, p_c accumulator, Δp = p_1 - p_2, ν
viscosity over the reference's, ω speed, s_i = ±1 for chamber 1 and 2.

=============  ==========================================================================================
volume         s(D Δθ - A Δx) of each chamber that no valve feeds (thesis eqs 3.14 to 3.17), m³
force          A_1 p_1 - A_2 p_2, by load and friction (eq. 3.30 and 5.12), over Coulomb friction
torque         motor current by shaft torque, friction and inertia (eq. 4.10), over that at relief pressure
shaft          lines of the motor current once and twice a turn, over that at relief pressure
coherence      measured Δp by p_1 and p_2: lines and sensors, over relief pressure
refeed         p_c - p_i of the side that is fed: its check valve's drop, over that at full flow; where p_c is
               not measured, how far the lower side is below charge pressure, over that
reservoir      gas of the accumulator and oil in the chambers: what left the circuit, in its gas volume
drive          pump speed by the speed demanded, while the drive has torque to spare, over its largest speed
=============  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fdd.measures import ATMOSPHERE_PA
from fdd.residuals.bins import BIN_S, FRAME_BINS, GAS_S
from fdd.residuals.compiled import Array, Flags
from fdd.residuals.quantities import (
    VALVE_MARGIN_PA,
    Quantities,
    central,
    change,
    fed_chambers,
    middle,
    settled,
)
from fdd.tolerances import RELIEF_SHUT

LEAST_INLET_PA = -3e4
"""Pa gauge at its inlet, below which a gear pump does not fill: data sheets say 0.7 to 0.8 bar absolute."""
PILOT_CLOSES = 12
"""Bins that a piloted check valve takes to close beyond those of a plain one: with a time constant of 20 to
30 ms it passes a hundredth of its flow after another 0.1 s."""
AERATION = 0.025
"""Free air of severity 1: volume at atmospheric pressure over that of oil."""
SLIDING_M_S = 1e-3
"""m/s of plastic travel from which a seal slides: what it gave before is taken up (see `_friction`)."""
LAG_S = 0.01
"""s, unit of the force balance's lag: of a pressure behind the motion, by its sensor and the load's give."""
STANDING = 0.02
"""Share of the largest speed up to which the pump may stand; above it friction opposes the turning."""
ORDERS = (1.0, 2.0)
"""Orders of the shaft at which a worn or misaligned coupling shows."""
STEADY = 0.88
"""Slowest speed over the fastest of a frame in which the shaft's lines are sought."""
SPARE = 0.7
"""Share of current limit and largest speed below which a drive has torque and voltage to spare, also one
whose limit is lowered by a degraded motor (20 %)."""
STEADY_BINS, STEADY_CHANGE, LEAST_COMMAND = 20, 0.05, 0.1
"""Bins, and change of the command in them over the largest speed: slower, a drive needs little torque to
accelerate. Least command over the largest speed: near standstill load and friction turn it as well."""
GAS_WORK = 1.0 - 1.0 / 1.4
"""Of a change of ln p, what the gas's temperature changes by before it has lost the heat."""
GAS_WARMED = 0.5 / 300.0
"""1/K of the gas, which warms by about half of what the oil does."""


class RegressionBlock(NamedTuple):
    """Rows of a balance's regression.

    Attributes
    ----------
    y : (n,). x : (n, columns). valid : (n,).
    noise : (n, 2, columns) what one standard deviation of a row's pressure noise adds to the columns' running
        sums, in its own row and in the next one; None where noise does not matter.
    """

    y: Array
    x: Array
    valid: Flags
    noise: Array | None = None


@dataclass(frozen=True)
class Balance:
    """One balance.

    Attributes
    ----------
    name, title : for people. columns : names of the coefficients. blocks : quantities to one or two
    blocks of rows that share the coefficients. settle : bins left out after what was
    invalid.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    blocks: Callable[[Quantities], list[RegressionBlock]]
    settle: int = 1
    cumulative: bool = False
    """Rows are increments: they are summed up over each unbroken stretch of a frame."""
    bins_per_row: int = 1
    """Bins whose mean is one row of the regression."""
    floor: float = 0.0
    """Least noise of a row, in its unit."""
    free: tuple[str, ...] = ()
    """Columns of the load or of unmeasured inputs, whose coefficients are free in each log."""
    laminar: tuple[str, ...] = ()
    """Columns whose coefficients are proportional to the inverse of the oil's viscosity."""
    viscous: tuple[str, ...] = ()
    """Columns whose coefficients are proportional to the oil's viscosity."""
    lines: int = 0
    """Number of spectral lines: columns are pairs of cosine and sine, coefficients the amplitudes."""

    @property
    def own(self) -> Flags:
        """Which coefficients (n,) are the unit's, not of the load or of unmeasured inputs."""
        return np.array([c not in self.free for c in self.columns])


def _volume(q: Quantities) -> list[RegressionBlock]:
    unit, scales = q.unit, q.scales
    out = []
    p_c = middle(q.accumulator)
    # The case drains into the accumulator over a check valve: until that opens it lies amid the ports.
    case = np.minimum(0.5 * middle(q.p1 + q.p2), p_c + unit.accumulator.case_cracking_pressure)
    weight = q.dt / q.viscosity
    speed = np.abs(q.speed) / scales.speed
    fed = fed_chambers(q)
    starved = np.minimum(q.p1, q.p2) < LEAST_INLET_PA
    # What the pump sweeps arrives denser, by half of ln ρ_1 - ln ρ_2 where it moves its ports' mean density.
    # It loses as much again whichever way it turns where it fills at its inlet, and more by what its dead
    # volume takes up and gives back (Energies 2022, 15, 298, doi 10.3390/en15010298). Free air adds to both.
    swept = 0.5 * unit.pump.displacement * q.turn
    gas = AERATION * (q.chambers[2].gas - q.chambers[1].gas)
    denser = q.chambers[1].stiff * middle(q.drop) + unit.oil.air_fraction / AERATION * gas
    for side, (sign, area, p, oil_volume, stiff, free, air, _) in q.chambers.items():
        mid, dp = middle(p), change(p)
        drop = sign * middle(q.drop)
        above = np.sqrt(np.maximum(mid - p_c, 0.0))
        y = sign * (2.0 * swept - area * q.travel)
        lag = sign * unit.pump.displacement * change(q.turn)
        s1, s2 = float(side == 1), float(side == 2)
        orifice = scales.orifice * np.sign(drop) * np.sqrt(np.abs(drop)) * q.dt
        x = np.column_stack([
            2.0 * sign * swept,
            oil_volume * (stiff + air) * dp,
            oil_volume * AERATION * free * dp + swept * gas,
            sign * np.abs(swept) * gas,
            AERATION * (sign * oil_volume * free * dp - swept * (q.chambers[1].gas + q.chambers[2].gas)),
            lag,
            oil_volume * stiff * change(dp),
            swept * denser,
            sign * np.abs(swept) * denser,
            scales.leakage * drop * weight,
            scales.leakage * drop * np.abs(drop) / scales.pressure * weight,
            scales.leakage * (mid - case) * weight,
            scales.leakage * drop * speed * weight,
            np.where(q.drop > 0.0, orifice, 0.0),
            np.where(q.drop < 0.0, orifice, 0.0),
            scales.orifice * above * q.dt * s1,
            scales.orifice * above * q.dt * s2,
            scales.leakage * mid * q.dt * s1,
            scales.leakage * mid * q.dt * s2,
        ])  # fmt: skip
        ok = ~fed[side] & (mid > 3e4) & (np.abs(q.drop) < RELIEF_SHUT * scales.pressure) & ~starved
        if unit.cylinder.needs_pilots:
            ok = settled(ok, PILOT_CLOSES)
        noise = np.zeros((y.size, 2, x.shape[1]))
        noise[:, 0, 1] = oil_volume * (stiff + air) * q.noise[side]
        noise[:, 0, 2] = oil_volume * AERATION * free * q.noise[side]
        noise[:, 0, 4] = sign * noise[:, 0, 2]
        noise[:, 0, 6] = oil_volume * stiff * q.noise[side]
        noise[:, 1, 6] = -noise[:, 0, 6]
        out.append(RegressionBlock(y, x, ok, np.nan_to_num(noise)))
    return out


def _force(q: Quantities) -> list[RegressionBlock]:
    unit, scales = q.unit, q.scales
    mean_area = 0.5 * (unit.cylinder.area_1 + unit.cylinder.area_2)
    y = np.where(
        q.chambers_measured,
        unit.cylinder.area_1 * q.p1 - unit.cylinder.area_2 * q.p2,
        mean_area * q.difference_measured,
    )
    y /= scales.friction
    # The piston's own motion: the pump's flow is ahead of it by what compression and leakage take.
    time = q.take["time"]
    velocity = central(q.position) / central(time)
    acceleration = central(velocity) / central(time)
    v, late = velocity / 0.05, LAG_S * central(y) / central(time)
    # Viscous friction is a part of the seal's curve: it is worn with it.
    f = unit.friction
    viscous = np.where(velocity > 0.0, f.forward.viscous, f.reverse.viscous) * velocity
    friction = (q.take["friction"] + viscous) / scales.friction
    # A load cell that fails, or is slower than the bins, counts as none.
    load = q.take["load_force"] / scales.friction
    there = np.isfinite(load).reshape(-1, FRAME_BINS).mean(axis=1) > 0.9
    measured = np.where(np.repeat(there, FRAME_BINS), load, 0.0)
    x = np.column_stack([
        np.ones_like(y),
        measured,
        q.position / (0.25 * unit.cylinder.stroke),
        acceleration / 1.0,
        v,
        v * np.abs(v),
        late,
        late * np.abs(v),  # a throttled partner gives way by its oil, the slower the more flows
        np.maximum(friction, 0.0),
        np.minimum(friction, 0.0),
    ])  # fmt: skip
    # While the seal sticks or reverses, its force is anywhere below break-away: friction shows in sliding
    # alone.
    sliding = np.abs(q.take["sliding"]) > SLIDING_M_S
    valid = np.isfinite(y) & sliding & (q.take["sliding"] * friction > 0.0)
    # Two bins late, as the acceleration asks for the next two: else the last ones at hand would be lost.
    shifted = np.roll(np.arange(y.size), 2)
    return [RegressionBlock(y[shifted], x[shifted], valid[shifted])]


def _torque(q: Quantities) -> list[RegressionBlock]:
    unit, scales = q.unit, q.scales
    drop = middle(q.drop_measured) / scales.pressure
    sense = np.tanh(q.speed / (0.01 * scales.speed))
    share = q.speed / scales.speed
    turning = (
        unit.drive.inertia * change(q.take["pump_speed"]) / (unit.drive.torque_constant * scales.current)
    )
    y = middle(q.take["motor_current"]) / scales.current * q.dt
    x = np.column_stack([
        q.dt, drop * q.dt, turning, sense * q.dt, share * q.viscosity * q.dt, np.abs(drop) * sense * q.dt,
    ])  # fmt: skip
    # At standstill the pump's friction is anywhere below break-away: its law shows while it turns.
    turns = np.abs(q.speed) > STANDING * scales.speed
    return [RegressionBlock(y, x, np.isfinite(y) & turns)]


def _shaft(q: Quantities) -> list[RegressionBlock]:
    scales = q.scales
    y = q.take["windowed_current"] / scales.current
    drop = q.drop_measured / scales.pressure
    turning = np.full_like(y, np.nan)
    turning[1:-1] = 0.5 * (q.speed[2:] - q.speed[:-2]) / BIN_S
    turning *= q.unit.drive.inertia / (q.unit.drive.torque_constant * scales.current)
    lines = []
    for order in ORDERS:
        # A Hann window of two bins: a fast line is lower in it.
        turns = order * q.speed * BIN_S / np.pi
        seen = np.sinc(turns) + 0.5 * (np.sinc(turns - 1.0) + np.sinc(turns + 1.0))
        lines += [seen * np.cos(order * q.angle), seen * np.sin(order * q.angle)]
    x = np.column_stack([*lines, drop, turning, np.tanh(q.speed / (0.01 * scales.speed))])
    # A bin late, as the acceleration asks for the next bin: else the last one at hand would be lost.
    late = np.roll(np.arange(y.size), 1)
    return [RegressionBlock(y[late], x[late], (np.isfinite(y) & _turning(q))[late])]


def _turning(q: Quantities) -> Flags:
    """Where a line shows: over whole turns at nearly constant speed, as starts and stops excite all orders,
    and below the rate at which a bin's mean swallows it."""
    angle, speed = (x.reshape(-1, FRAME_BINS) for x in (q.angle, np.abs(q.speed)))
    whole = np.fmax.reduce(angle, axis=1) - np.fmin.reduce(angle, axis=1) > 4.0 * np.pi
    whole &= np.fmin.reduce(speed, axis=1) > STEADY * np.fmax.reduce(speed, axis=1)
    return (np.abs(q.speed) * BIN_S * max(ORDERS) < np.pi) & np.repeat(whole, FRAME_BINS)


def _coherence(q: Quantities) -> list[RegressionBlock]:
    y = q.difference_measured / q.scales.pressure
    p1, p2 = (q.take[name] / q.scales.pressure for name in ("pressure_1", "pressure_2"))
    share = q.speed / q.scales.speed
    x = np.column_stack([np.ones_like(y), p1, p2, share * q.viscosity, share * np.abs(share)])
    # Errors in variables: both sides are measured, so noise is in the columns too.
    noise = np.zeros((y.size, 2, x.shape[1]))
    noise[:, 0, 1] = q.take["pressure_1_noise"] / q.scales.pressure
    noise[:, 1, 2] = q.take["pressure_2_noise"] / q.scales.pressure
    made = np.abs(y - p1 + p2) < 1e-7  # Δp was made from them
    return [RegressionBlock(y, x, np.isfinite(y) & ~made, np.nan_to_num(noise))]


def _refeed(q: Quantities) -> list[RegressionBlock]:
    out = []
    # Without its sensor the accumulator's pressure is a level that both sides have in common: what differs
    # between them, or begins on one, is a valve's.
    known = q.accumulator_measured.astype(np.float64)
    hidden = (1.0 - known) * q.scales.charge / q.scales.valve
    for side, chamber in q.chambers.items():
        p, other = chamber.pressure, q.chambers[3 - side].pressure
        y = (q.accumulator - p) / q.scales.valve
        rod = chamber.sign * (chamber.area - 0.5 * (q.unit.cylinder.area_1 + q.unit.cylinder.area_2))
        inflow = np.maximum(rod * q.velocity, 0.0) / (q.unit.pump.displacement * q.scales.speed)
        s1, s2 = float(side == 1), float(side == 2)
        x = np.column_stack([
            known * s1, known * s2, known * inflow * s1, known * inflow * s2,
            hidden, hidden * s1, hidden * s2,
        ])  # fmt: skip
        low = (p < other - 0.02 * q.scales.pressure) & (p < q.accumulator + VALVE_MARGIN_PA)
        out.append(RegressionBlock(y, x, low & q.chambers_measured))
    return out


def _drive(q: Quantities) -> list[RegressionBlock]:
    command = q.take["command"] / q.scales.speed
    speed = np.where(np.isfinite(q.take["pump_speed"]), q.take["pump_speed"], q.speed) / q.scales.speed
    before = np.roll(command, 1)
    x = np.column_stack([command, command - before, before - np.roll(command, 5)])
    current = q.take["motor_current"]
    by_drop = q.scales.current * (q.drop_measured / q.scales.pressure)
    current = np.where(np.isfinite(current), current, by_drop)
    spare = (np.abs(current) < SPARE * q.unit.drive.current_limit) & (np.abs(speed) < SPARE)
    steady = np.abs(command - np.roll(command, STEADY_BINS)) < STEADY_CHANGE
    steady &= np.abs(command) > LEAST_COMMAND
    return [RegressionBlock(speed, x, np.isfinite(speed) & spare & steady)]


def _reservoir(q: Quantities) -> list[RegressionBlock]:
    unit = q.unit
    charge = unit.accumulator.charge_pressure + ATMOSPHERE_PA
    isothermal = charge / (q.accumulator + ATMOSPHERE_PA)
    hot = GAS_WORK * isothermal * q.take["gas_heat"]
    y = change(isothermal + hot)  # growth of the gas, in its volume at charge
    gas, oil = unit.accumulator.gas_volume, unit.oil
    held = np.zeros_like(y)
    for c in q.chambers.values():
        held += c.oil * (c.stiff + c.air) * change(c.pressure)
    contents = unit.cylinder.volume_1 + unit.cylinder.volume_2 + unit.accumulator.oil_at_rest
    warmed = oil.thermal_expansion * contents / gas + GAS_WARMED
    x = np.column_stack([
        0.5 * q.scales.fault_leakage * 0.5 * q.scales.pressure * q.dt / gas,
        0.5 * q.scales.fault_leakage * middle(q.p1) * q.dt / gas,
        0.5 * q.scales.fault_leakage * middle(q.p2) * q.dt / gas,
        held / gas,
        q.travel * (unit.cylinder.area_1 - unit.cylinder.area_2) / gas,
        q.travel / (0.25 * unit.cylinder.stroke),
        middle(hot) * q.dt / GAS_S,  # it cools sooner or later than assumed
        -warmed * q.take["warming"] * q.dt,
    ])  # fmt: skip
    return [RegressionBlock(y, x, np.isfinite(y) & q.accumulator_measured)]


BALANCES: dict[str, Balance] = {
    b.name: b
    for b in (
        Balance(
            "volume", "the chambers' oil",
            ("gain", "compliance", "air", "air_filled", "air_sides", "lag", "sensor_lag", "density", "filled",
             "leak", "leak_square", "case", "wear",
             "relief_12", "relief_21", "valve_1", "valve_2", "outside_1", "outside_2"),
            _volume, settle=8, cumulative=True, laminar=("leak", "leak_square", "case", "wear"),
        ),
        Balance(
            "force", "the piston's forces",
            ("load", "load_measured", "spring", "mass", "damping", "throttle", "lag", "lag_flow",
             "friction_forward", "friction_reverse"),
            _force, bins_per_row=5,
            free=("load", "load_measured", "spring", "mass", "damping", "throttle", "lag", "lag_flow"),
            floor=0.1,  # of Coulomb friction: trials scatter by 9 % (thesis Table 5.1)
        ),
        Balance(
            "torque", "the shaft's torque", ("zero", "pressure", "inertia", "dry", "viscous", "mesh"),
            _torque, cumulative=True, viscous=("viscous",),
        ),
        Balance("shaft", "the shaft's vibration", ("order_1", "order_2"), _shaft, lines=2),
        Balance(
            "coherence", "the pressures among each other",
            ("zero", "gain_1", "gain_2", "line", "line_square"), _coherence, viscous=("line",),
        ),
        Balance(
            "refeed", "the refeeding",
            ("drop_1", "drop_2", "flow_1", "flow_2", "low", "low_1", "low_2"), _refeed, settle=8,
        ),
        Balance(
            "reservoir", "the accumulator's oil",
            ("drift", "outside_1", "outside_2", "held", "rod", "stroke", "cooling", "warming"), _reservoir,
            cumulative=True,
        ),
        Balance("drive", "the drive's response", ("gain", "lag", "lag_before"), _drive, settle=STEADY_BINS),
    )
}  # fmt: skip
