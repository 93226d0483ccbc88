"""Chamber pressures that nobody measures: from their difference, by what the refeeding valves allow.

With a differential sensor alone, the chambers' mean pressure is hidden. It is not free, though: the
refeeding valves keep the lower chamber at the accumulator's pressure less their cracking, so the mean
is at least that plus half the difference; once lifted it stays up, and only the case drain lets it
down. What lifts it is oil from the accumulator, whose pressure falls for it. While both chambers are
shut their oil's mass stays what it is: the lower one, whose air is softer, changes less. Pilots of unequal
chambers' valves hold the lower one open to the accumulator.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.measures import ATMOSPHERE_PA
from fdd.residuals.compiled import njit
from fdd.residuals.oil import stiff_compliance
from fdd.unit import Unit

Array = NDArray[np.float64]

DRAINS = (1.0, 0.5, 2.0)
"""Case leakage over the profile's, by which the mean is followed: data sheets are off by 40 %, and no sensor
shows how the chambers drain."""
NEWTON_STEPS, LEAST_PA = 3, 1e4
"""Steps in which the mean pressure is found, and the absolute pressure below which oil cavitates."""


@njit()
def _log_density(pressure: float, oil: Array) -> tuple[float, float]:
    """ln ρ of a chamber's oil at an absolute pressure (Pa) and its compliance (1/Pa), by `fdd.residuals.oil`.

    Parameters
    ----------
    oil : 1/Pa without air, share of free air, polytropic index, atmosphere (Pa).
    """
    stiff, air, index, atmosphere = oil
    absolute = max(pressure, LEAST_PA)
    gas = (atmosphere / absolute) ** (1.0 / index)
    return stiff * pressure - air * gas, stiff + air * gas / (index * absolute)


@njit()
def _follow(
    difference: Array,
    noise: Array,
    volumes: Array,
    oil: Array,
    drain: Array,
    rod: Array,
    tank: Array,
    period: float,
    fixed: Array,
    state: Array,
    mean: Array,
) -> None:
    """Follow the mean pressure bin by bin; a missing difference leaves it as it is.

    Parameters
    ----------
    volumes : (n, 2) m³ of the chambers. oil : of `_log_density`. drain : (n,) m³/(s·Pa), both chambers to
        the case. rod : (n,) m³ that the rod's way out takes from the accumulator. tank : (n,) Pa, filled
        where it is NaN.
    fixed : Pa absolute, m³, Pa, Pa, Pa: charge pressure, gas, cracking pressures of refeeding and of the
        case, atmosphere.
    state : (3,) Pa, m³ taken from the accumulator, Pa of the last difference; NaN before the first bin.
    """
    charge, gas, cracking, drain_cracking, atmosphere = fixed
    level, taken, before = state
    for k in range(difference.size):
        mean[k] = np.nan
        if not np.isfinite(difference[k]):
            continue
        if np.isnan(tank[k]):
            volume = max(gas + taken + rod[k], 0.1 * gas)
            tank[k] = charge * gas / volume - atmosphere
        half = 0.5 * abs(difference[k])
        if np.isnan(level):
            level, before = tank[k] + half, difference[k]
        half_1, half_2 = atmosphere + 0.5 * difference[k], atmosphere - 0.5 * difference[k]
        one, two = volumes[k]
        mass = one * _log_density(level + atmosphere + 0.5 * before, oil)[0]
        mass += two * _log_density(level + atmosphere - 0.5 * before, oil)[0]
        for _ in range(NEWTON_STEPS):
            rho_1, soft_1 = _log_density(level + half_1, oil)
            rho_2, soft_2 = _log_density(level + half_2, oil)
            compliance = one * soft_1 + two * soft_2
            level += (mass - one * rho_1 - two * rho_2) / compliance
        before = difference[k]
        lost = level - tank[k] - drain_cracking
        if lost > 0.0:
            fall = lost * (1.0 - np.exp(-drain[k] / compliance * period))
            level -= fall
            taken -= fall * compliance
        least = tank[k] - cracking + max(half - 0.5 * noise[k], 0.0)
        if level < least:
            taken += (least - level) * compliance
            level = least
        mean[k] = level
    state[0], state[1], state[2] = level, taken, before


def chambers_from_difference(
    difference: Array,
    position: Array,
    period: float,
    unit: Unit,
    accumulator: Array,
    *,
    noise: Array | None = None,
    viscosity: Array | float = 1.0,
    state: Array | None = None,
) -> tuple[Array, Array]:
    """Mean chamber pressure and accumulator pressure that go with a pressure difference.

    Parameters
    ----------
    difference : (n,) Pa. position : (n,) m. period : s.
    unit : its volumes, bulk modulus, accumulator and case leakage.
    accumulator : (n,) Pa, NaN where it is not known.
    noise : (n,) Pa, standard deviation of the difference's: its peaks lift nothing. viscosity : over the
        reference's. state : (3,), NaN at first; kept for the bins that follow.

    Returns
    -------
    (n,) mean pressure, NaN without difference or position, and (n,) accumulator pressure, Pa gauge.
    """
    cylinder, tank = unit.cylinder, unit.accumulator
    known = np.where(np.isfinite(position), difference, np.nan)
    moved = np.nan_to_num(position)
    one = np.maximum(cylinder.volume_1 + cylinder.area_1 * moved, 1e-9)
    two = np.maximum(cylinder.volume_2 - cylinder.area_2 * moved, 1e-9)
    drain = 2.0 * unit.pump.case_leakage / viscosity * np.ones_like(known)
    if unit.cylinder.needs_pilots:
        drain = np.full_like(known, np.inf)
    air, index = unit.oil.air_fraction, unit.oil.polytropic_index
    oil = np.array([stiff_compliance(unit.oil), air, index, ATMOSPHERE_PA])
    level, mean = accumulator.copy(), np.empty_like(known)
    fixed = np.array([
        tank.charge_pressure + ATMOSPHERE_PA, tank.gas_volume, tank.refeed_cracking_pressure,
        tank.case_cracking_pressure, ATMOSPHERE_PA,
    ])  # fmt: skip
    _follow(
        known, np.zeros_like(known) if noise is None else np.nan_to_num(noise),
        np.column_stack([one, two]), oil, drain,
        (cylinder.area_1 - cylinder.area_2) * moved, level, period, fixed,
        np.array([np.nan, 0.0, np.nan]) if state is None else state, mean,
    )  # fmt: skip
    return mean, level


def sure_mean_pressure(
    difference: Array, position: Array, period: float, unit: Unit, accumulator: Array, *, noise: Array,
    viscosity: Array, states: Array,
) -> Array:  # fmt: skip
    """Mean chamber pressure (n,) Pa, NaN where `DRAINS` disagree whether a valve feeds the lower chamber.

    The higher chamber's pressure then rises by all that the difference does, or by half.

    Parameters
    ----------
    states : (len(DRAINS), 3), NaN, 0 and NaN at first; kept for the bins that follow. Others as of
        `chambers_from_difference`.
    """
    rise = np.maximum(0.5 * np.abs(difference) - 0.5 * np.nan_to_num(noise), 0.0)
    fed, means = [], []
    for drain, state in zip(DRAINS, states, strict=True):
        mean, tank = chambers_from_difference(
            difference, position, period, unit, accumulator, noise=noise, viscosity=viscosity / drain,
            state=state,
        )  # fmt: skip
        fed.append(mean <= tank - unit.accumulator.refeed_cracking_pressure + rise + 1.0)
        means.append(mean)
    alike = np.all(fed, axis=0) | ~np.any(fed, axis=0)
    return np.where(alike, means[0], np.nan)
