"""The oil as balances and identification need it: viscosity over temperature, free air over pressure, and the
pressures that it has in chambers where nobody measures them.

Oil with a share α of free air (volume at atmospheric pressure over that of oil) has the density
``ln ρ = s·p - α·g(p)`` with a polytropic gas's volume ``g(p) = (p_atm / p_abs)^(1/n)``, and so the compliance
``1/β(p) = s + α·c(p)``, ``c = -dg/dp`` (thesis eqs 5.20 and 5.21). Leakage goes with 1/ν(T), and ν follows
Walther's equation (ASTM D341). Pressures are gauge.

With a differential sensor alone, the chambers' mean pressure is hidden. It is not free, though: the
refeeding valves keep the lower chamber at the accumulator's pressure less their cracking, so the mean
is at least that plus half the difference; once lifted it stays up, and only the case drain lets it
down. What lifts it is oil from the accumulator, whose pressure falls for it. While both chambers are
shut their oil's mass stays what it is: the lower one, whose air is softer, changes less. Pilots of unequal
chambers' valves hold the lower one open to the accumulator.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fdd.measures import ATMOSPHERE_PA
from fdd.residuals.compiled import Array, njit
from fdd.unit import Oil, Unit

LEAST_PA = 1.0e4
"""Absolute pressure below which the oil cavitates and the air's law says nothing."""
_LEAST_STIFF = 0.3
"""Of the compliance at reference pressure, that oil without air has at least: a profile typed from a sheet
may have more air than leaves oil any give."""
DRAINS = (1.0, 0.5, 2.0)
"""Case leakage over the profile's, by which the mean is followed: data sheets are off by 40 %, and no sensor
shows how the chambers drain."""
NEWTON_STEPS = 3
"""Steps in which the mean pressure is found."""


def viscosity(oil: Oil, temperature: ArrayLike) -> Array:
    """Kinematic viscosity (m²/s) at `temperature` (°C), shape of `temperature`.

    ``log10 log10(ν + 0.7) = a - b log10 T`` (ν in cSt, T in K), through the viscosities at 40 and 100 °C.

    Examples
    --------
    >>> from fdd.unit import Unit
    >>> round(float(viscosity(Unit.load("axis_a").oil, 40.0)) * 1e6, 3)
    32.0
    """
    known = np.array([oil.viscosity_40, oil.viscosity_100]) * 1e6
    ordinate = np.log10(np.log10(known + 0.7))
    abscissa = np.log10(np.array([313.15, 373.15]))
    slope = (ordinate[1] - ordinate[0]) / (abscissa[1] - abscissa[0])
    kelvin = np.clip(np.asarray(temperature, dtype=np.float64), -40.0, 200.0) + 273.15
    return np.asarray(
        (10.0 ** (10.0 ** (ordinate[0] + slope * (np.log10(kelvin) - abscissa[0]))) - 0.7) * 1e-6
    )


def viscosity_ratio(oil: Oil, temperature: ArrayLike) -> Array:
    """Viscosity at `temperature` (°C) over that at the oil's reference temperature."""
    return np.asarray(viscosity(oil, temperature) / viscosity(oil, oil.reference_temperature))


def free_air(pressure: ArrayLike, index: float) -> tuple[Array, Array]:
    """g(p), volume of free air over that at atmospheric pressure, and c(p) = -dg/dp, 1/Pa, at p (…) Pa."""
    absolute = np.maximum(np.asarray(pressure, dtype=np.float64) + ATMOSPHERE_PA, LEAST_PA)
    gas = (ATMOSPHERE_PA / absolute) ** (1.0 / index)
    return np.asarray(gas), np.asarray(gas / (index * absolute))


def air_compliance(pressure: ArrayLike, index: float) -> Array:
    """c(p) alone, 1/Pa; see `free_air`."""
    return free_air(pressure, index)[1]


def pressure_of_compliance(compliance: ArrayLike, index: float) -> Array:
    """Pressure (Pa) at which free air has a compliance, (n,) 1/Pa; NaN for one that no pressure gives.

    Examples
    --------
    >>> round(float(pressure_of_compliance(air_compliance(5e5, 1.4), 1.4)))
    500000
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ATMOSPHERE_PA ** (1.0 / index) / (index * np.asarray(compliance, dtype=np.float64))
        return np.asarray(share ** (index / (index + 1.0)) - ATMOSPHERE_PA)


def stiff_compliance(oil: Oil) -> float:
    """Compliance s of oil and walls without the air, 1/Pa, such that with it the unit's is met."""
    air = oil.air_fraction * float(air_compliance(oil.reference_pressure, oil.polytropic_index))
    return max(1.0 / oil.bulk_modulus - air, _LEAST_STIFF / oil.bulk_modulus)


def modulus_at(oil: Oil, pressure: float) -> float:
    """Effective bulk modulus (Pa) at `pressure` (Pa).

    Examples
    --------
    >>> from fdd.unit import Unit
    >>> oil = Unit.load("axis_a").oil
    >>> round(modulus_at(oil, oil.reference_pressure) / 1e6), round(modulus_at(oil, 2e6) / 1e6)
    (210, 261)
    """
    air = oil.air_fraction * float(air_compliance(pressure, oil.polytropic_index))
    return 1.0 / (stiff_compliance(oil) + air)


@njit()
def _log_density(pressure: float, oil: Array) -> tuple[float, float]:
    """ln ρ of a chamber's oil at an absolute pressure (Pa) and its compliance (1/Pa), by the oil's 1/Pa
    without air, share of free air, polytropic index, and atmosphere (Pa)."""
    stiff, air, index, atmosphere = oil
    absolute = max(pressure, LEAST_PA)
    gas = (atmosphere / absolute) ** (1.0 / index)
    return stiff * pressure - air * gas, stiff + air * gas / (index * absolute)


@njit()
def _follow(
    difference: Array, noise: Array, volumes: Array, oil: Array, drain: Array, rod: Array, tank: Array,
    period: float, fixed: Array, state: Array, mean: Array,
) -> None:  # fmt: skip
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
    difference: Array, position: Array, period: float, unit: Unit, accumulator: Array, *,
    noise: Array | None = None, viscosity: Array | float = 1.0, state: Array | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """Mean chamber pressure and accumulator pressure that go with a pressure difference.

    Parameters
    ----------
    difference : (n,) Pa. position : (n,) m. period : s.
    unit : its volumes, bulk modulus, accumulator and case leakage.
    accumulator : (n,) Pa, NaN where it is not known.
    noise : (n,) Pa, standard deviation of the difference's: its peaks lift nothing. viscosity : over the
        reference's. state : (3,), NaN, 0 and NaN at first; kept for the bins that follow.

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
    if cylinder.needs_pilots:
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

    The higher chamber's pressure then rises by all that the difference does, or by half. All as for
    `chambers_from_difference`, with a state for each of `DRAINS`.
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
