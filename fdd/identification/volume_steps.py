"""Volume balances of the two chambers over short steps, as rows of a linear regression.

Chamber 1, over a step in which it is neither refed nor relieved:

``A1·Δx = D·Δθ - ξ·∫(p1-p2)/μ - C_ep·∫(p1-p_case)/μ - ∫V1·dp1/β(p1)``

and chamber 2 likewise with the pump's sign reversed, where μ is viscosity over its reference,
``1/β(p) = 1/β_stiff + α·c(p)`` and ``V1 = volume_1 + A1·x`` (thesis eqs 3.14 to 3.17, 5.20, geometric
volume law). Δθ is weighted with the ports' mean density over the chamber's, ``1 - (p1-p2)/2β``: what the
pump moves is oil, not volume, and at 3 MPa that is 0.7 % of the flow. Gears that fill at their inlet's
pressure lose κ·|Δθ|·D·(p1-p2)/2β more, κ up to 1: a leakage that goes with speed, and on large pumps as much
as the other. Oil that warms swells, and a pressure's zero makes a leakage feign a steady loss: each chamber
has one of its own. Position and pump angle are known to one count, so the balance holds to a few mm³, where
the same equation in rates would drown in quantisation noise.

All terms are accumulated first, smoothed by one and the same window without phase, and then
differenced: that keeps the equation exact and averages the pressure noise. Unknowns are scaled by
the base's values.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fdd.identification import Array
from fdd.identification.record import Record, effective_noise, lowest
from fdd.residuals.oil import air_compliance, free_air, stiff_compliance, viscosity
from fdd.residuals.quantities import PILOT, outlet_loss
from fdd.unit import Oil, Unit

SMOOTHING = 0.025
"""s, window over which every accumulated term is averaged."""
STEPS = (0.05, 0.1, 0.2)
"""s: short steps see the compliance best, long ones the leakage."""
REFEED_MARGIN = 4.0e4
"""Pa above the accumulator at which a chamber is surely not being refed, sensor zeros included."""
NOISE_MARGIN = 4.0
"""Standard deviations of the smoothed pressures' noise that this margin must be at least."""
TRAPPED, TRAPPED_SPEED = 0.02, 0.3
"""Of the relief setting, by which a chamber must stand above what an open valve joins it to; of the drive's
speed, up to which the valve's drop is far below that."""
RELIEF_MARGIN = 0.97
"""Of the relief setting, above which the valve may pass oil."""
WARMING_WINDOW = 5.0
"""s: oil warms within minutes, and the sensor's noise must not swell it."""
AIR_SCALE = 3e-3
DRIFT_PRESSURE = 1e5
"""Pa that a chamber's steady loss is counted at."""
LEAKAGE_FLOOR = 1e-12
"""m³/(s·Pa), that leakages are counted in where the base has none."""
BLOCK = 2.0
"""s: residuals farther apart than this count as independent."""


class Term(IntEnum):
    """The regression's unknowns, as they stand in θ."""

    DISPLACEMENT = 0  # D
    AREA_2 = 1  # its change
    CROSS = 2  # ξ
    CASE = 3  # C_ep
    INLET = 4  # κ·D
    DRIFT_1 = 5  # leakage at `DRIFT_PRESSURE` out of chamber 1
    DRIFT_2 = 6
    STIFF = 7  # compliance of the oil without air, beyond its bound
    AIR = 8  # α


@dataclass(frozen=True)
class VolumeSteps:
    """Rows of the regression ``y = m·θ``, y in m³, θ in units of `scales`; r of each."""

    m: Array
    y: Array
    noise: Array
    """(r, 2, 9) what white pressure noise of one pascal at either end of the step adds to m (r, 9)."""
    chamber: NDArray[np.int64]
    block: NDArray[np.int64]
    """Number of the 2 s block the step lies in, over all logs."""
    seconds: Array


def scales(unit: Unit) -> Array:
    """(9,) what one unit of each `Term` is, SI."""
    leakage = max(unit.pump.total_leakage, LEAKAGE_FLOOR)
    displacement, drift = unit.pump.displacement, leakage * DRIFT_PRESSURE
    return np.array([
        displacement, unit.cylinder.area_2, leakage, leakage, displacement, drift, drift,
        1.0 / unit.oil.bulk_modulus, AIR_SCALE,
    ])  # fmt: skip


def keeps_trapped_oil(record: Record, unit: Unit, noise: tuple[float, float]) -> bool:
    """Whether a chamber stays above the accumulator under a higher one: no pilot holds its valve open.

    While the pump hardly turns, an open valve's drop is nearly nought. `noise` is that of `LogBalances`.
    """
    if not (record.chambers_measured and record.accumulator_measured):
        return False
    least = TRAPPED * unit.accumulator.relief_pressure + NOISE_MARGIN * float(np.hypot(*noise))
    pressures = np.stack([record.smooth(p, SMOOTHING) for p in (record.pressure_1, record.pressure_2)])
    store = record.smooth(record.accumulator, SMOOTHING)
    low, high = pressures.min(axis=0) - store, pressures.max(axis=0) - store
    _, speed = record.speeds(SMOOTHING)
    slow = ~record.gap & (np.abs(speed) < TRAPPED_SPEED * unit.drive.max_speed)
    trapped = slow & (low > least) & (high > low + least)
    return bool(np.sum(trapped) * record.period > BLOCK)


def volume_steps(record: Record, unit: Unit, logs: LogBalances) -> VolumeSteps:
    """The rows that one of the logs gives, with a profile's areas, volumes, oil and relief pressure."""
    x, theta = record.position, record.angle
    cylinder, tank, h = unit.cylinder, unit.accumulator, record.period
    mu, warmth, still = np.ones_like(x), np.zeros_like(x), np.zeros_like(x)
    if record.temperature is not None:
        warmth = record.smooth(record.temperature, WARMING_WINDOW)
        mu = viscosity(unit.oil, warmth) / viscosity(unit.oil, logs.reference_temperature(unit))
    smooth_1 = record.smooth(record.pressure_1, SMOOTHING)
    smooth_2 = record.smooth(record.pressure_2, SMOOTHING)
    store = record.smooth(record.accumulator, 0.1)
    case = np.minimum(0.5 * (smooth_1 + smooth_2), store + tank.case_cracking_pressure)
    calm = ~record.gap & (np.abs(smooth_1 - smooth_2) < RELIEF_MARGIN * tank.relief_pressure)
    drop = record.pressure_1 - record.pressure_2
    higher = NOISE_MARGIN * float(np.hypot(*logs.noise))
    x_smooth = record.smooth(x, SMOOTHING)
    denser = 0.5 * (_log_density(unit.oil, smooth_1) - _log_density(unit.oil, smooth_2))
    lost = np.abs(np.diff(theta)) * denser[1:]
    speed = np.gradient(record.smooth(theta, SMOOTHING), h)
    inlet = np.concatenate(([0.0], np.cumsum(lost)))
    time = h * np.arange(x.size)
    # 1/β_stiff = ½·α·c(reference) + excess: with excess ≥ 0 the stiff oil is at most three times β.
    bound = 0.5 * float(air_compliance(logs.pressure, unit.oil.polytropic_index))
    parts = []
    for chamber, sign, pressure, smoothed, area, at_centre in (
        (1, 1.0, record.pressure_1, smooth_1, cylinder.area_1, cylinder.volume_1),
        (2, -1.0, record.pressure_2, smooth_2, cylinder.area_2, cylinder.volume_2),
    ):
        moved = cylinder.position_compliance * area * x_smooth
        volume = np.maximum(at_centre + sign * moved, 0.1 * at_centre)
        levels = (
            sign * area * x,
            # Each step over the density of the chamber's oil against that of the ports' mean.
            sign * np.concatenate(([0.0], np.cumsum(np.diff(theta) * (1.0 - (sign * denser)[1:])))),
            -sign * x if chamber == 2 else still,
            -sign * h * np.cumsum(drop / mu),
            -h * np.cumsum((pressure - case) / mu),
            -sign * inlet,
            -time if chamber == 1 else still,
            -time if chamber == 2 else still,
            *_compression(pressure, smoothed, volume, unit.oil.polytropic_index, bound),
            unit.oil.thermal_expansion * at_centre * warmth,
        )
        softness = air_compliance(smoothed, unit.oil.polytropic_index) + bound
        slopes = np.column_stack([-volume, -volume * softness])  # of the compression terms per pascal
        terms = np.column_stack([record.smooth(np.asarray(level), SMOOTHING) for level in levels])
        above = smoothed - store - max(REFEED_MARGIN, NOISE_MARGIN * logs.noise[chamber - 1])
        loss = outlet_loss(unit, speed, chamber)
        # The lower chamber may give oil back through a valve that the other one holds open, at just
        # such a pressure, but where the unit was seen to keep it.
        usable = (above > loss) & (sign * (smooth_1 - smooth_2) > higher + loss)
        if not unit.accumulator.refeed_pilots:
            usable |= above > outlet_loss(unit, speed, 1) + outlet_loss(unit, speed, 2)
        usable &= calm
        if unit.cylinder.needs_pilots:
            other = smooth_2 if chamber == 1 else smooth_1
            usable &= smoothed - store > PILOT * (other - store)
        for seconds in STEPS:
            parts.append(_differences(record, seconds, terms, slopes, usable, chamber))
    scale, lengths = scales(unit), np.repeat(STEPS * 2, [p[1].size for p in parts])
    m, y, ends, of_chamber, block = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return VolumeSteps(m * scale, y, ends * scale, of_chamber, block, lengths)


def _log_density(oil: Oil, pressure: Array) -> Array:
    """ln of the base's oil's density, but for a constant: ∫dp/β(p)."""
    gas, _ = free_air(pressure, oil.polytropic_index)
    return np.asarray(stiff_compliance(oil) * pressure - oil.air_fraction * gas)


def _compression(
    pressure: Array, smoothed: Array, volume: Array, index: float, bound: float
) -> tuple[Array, Array]:
    """Accumulated oil volume taken up per unit of the stiff compliance's excess and of α (both negative)."""
    # Along the smoothed pressure and linear about it: the air's law is curved, and noise must not bend it.
    gas, soft = free_air(smoothed, index)
    shrinkage = soft * (pressure - smoothed) - gas
    between = 0.5 * (volume[1:] + volume[:-1])
    stiff = np.concatenate(([0.0], np.cumsum(between * np.diff(pressure))))
    air = np.concatenate(([0.0], np.cumsum(between * np.diff(shrinkage))))
    return -stiff, -(air + bound * stiff)


def _differences(
    record: Record, seconds: float, levels: Array, slopes: Array, usable: NDArray[np.bool_], chamber: int
) -> tuple[Array, Array, Array, NDArray[np.int64], NDArray[np.int64]]:
    n, rim = record.rows(seconds), record.rows(SMOOTHING) // 2 + 1
    starts = np.arange(rim, len(record) - n - rim, max(n // 2, 1))
    bad = np.concatenate(([0], np.cumsum(~usable)))
    moved = levels[starts + n] - levels[starts]
    # A pump that stands still against a pressure that does not fall is shut off by a valve: no leakage there.
    turning = (np.abs(moved[:, 1]) > 5e-4) | (np.abs(moved[:, 0]) > 1e-9)
    kept = (bad[starts + n + rim] == bad[starts - rim]) & turning
    starts, moved = starts[kept], moved[kept]
    noise = np.zeros((starts.size, 2, len(Term)))
    noise[:, 0, Term.STIFF :] = slopes[starts]
    noise[:, 1, Term.STIFF :] = slopes[starts + n]
    block = (starts * record.period / BLOCK).astype(np.int64)
    return moved[:, 1:-1], moved[:, 0] - moved[:, -1], noise, np.full(starts.size, chamber), block


class LogBalances:
    """What all logs are referred to, and their rows.

    `temperature` is the oil's mean (°C), None where it is not measured; `pressure` (Pa gauge) by default the
    accumulator's usual one, else the chambers' mean: compressibility is referred to it.
    """

    def __init__(self, records: list[Record], pressure: float | None = None) -> None:
        self.records = records
        known = [float(np.mean(r.temperature)) for r in records if r.temperature is not None]
        self.temperature = float(np.mean(known)) if known else None
        if pressure is None:
            levels = [
                r.accumulator if r.accumulator_measured or not r.chambers_measured
                else 0.5 * (r.pressure_1 + r.pressure_2) for r in records
            ]  # fmt: skip
            pressure = float(np.median(np.concatenate(levels)))
        self.pressure = max(pressure, 0.0)

    @cached_property
    def noise(self) -> tuple[float, float]:
        """Pa, white noise of the chamber pressures that is left after the balance's window."""
        left = []
        for channel in ("pressure_1", "pressure_2"):
            found = lowest([effective_noise(getattr(r, channel), r.period) for r in self.records])
            left.append((found or 0.0) / np.sqrt(self.records[0].rows(SMOOTHING)))
        return left[0], left[1]

    def reference_temperature(self, unit: Unit) -> float:
        """°C that leakage is referred to: the logs' mean, else the profile's."""
        return unit.oil.reference_temperature if self.temperature is None else self.temperature

    def steps(self, unit: Unit) -> VolumeSteps:
        """The rows of all logs, counted with a profile's volumes."""
        parts, offset = [], 0
        for record in self.records:  # blocks get numbers of their own
            part = volume_steps(record, unit, self)
            parts.append(replace(part, block=part.block + offset))
            offset += int(part.block.max(initial=-1)) + 1
        names = [f.name for f in fields(VolumeSteps)]
        return VolumeSteps(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})
