"""The oil as balances and identification need it: viscosity over temperature, free air over pressure.

Oil with a share α of free air (volume at atmospheric pressure over that of oil) has the density
``ln ρ = s·p - α·g(p)`` with a polytropic gas's volume ``g(p) = (p_atm / p_abs)^(1/n)``, and so the compliance
``1/β(p) = s + α·c(p)``, ``c = -dg/dp`` (thesis eqs 5.20 and 5.21). Leakage goes with 1/ν(T), and ν follows
Walther's equation (ASTM D341). Pressures are gauge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.measures import ATMOSPHERE_PA
from fdd.unit import Oil

Array = NDArray[np.float64]

_LOWEST_PA = 1.0e4
"""Absolute: below it the oil cavitates and the air's law says nothing."""
_LEAST_STIFF = 0.3
"""Of the compliance at reference pressure, that oil without air has at least: a profile typed from a sheet
may have more air than leaves oil any give."""


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
    """Viscosity at `temperature` (°C) over that at the oil's reference temperature.

    Examples
    --------
    >>> from fdd.unit import Unit
    >>> oil = Unit.load("axis_a").oil
    >>> viscosity_ratio(oil, [40.0, 100.0]).round(3).tolist()
    [1.0, 0.169]
    """
    return np.asarray(viscosity(oil, temperature) / viscosity(oil, oil.reference_temperature))


def free_air(pressure: ArrayLike, index: float) -> tuple[Array, Array]:
    """g(p), volume of free air over that at atmospheric pressure, and c(p) = -dg/dp, 1/Pa.

    Parameters
    ----------
    pressure : (…) Pa. index : polytropic.
    """
    absolute = np.maximum(np.asarray(pressure, dtype=np.float64) + ATMOSPHERE_PA, _LOWEST_PA)
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
