"""The oil as identification needs it: viscosity over temperature, the air's compliance over pressure.

``1/β(p) = 1/β_stiff + α·c(p)`` with ``c(p) = p_atm^(1/n) / (n·(p + p_atm)^((n+1)/n))`` (thesis eqs 5.20
and 5.21); leakage goes with 1/ν(T), and ν follows Walther's law (ASTM D341).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.unit import Oil

Array = NDArray[np.float64]

ATMOSPHERE = 101_325.0
_LOWEST = 1.0e4
"""Pa, absolute: below it the oil cavitates and the air's law says nothing."""


def viscosity(oil: Oil, temperature: ArrayLike) -> Array:
    """Kinematic viscosity (m²/s) at `temperature` (°C), shape of `temperature`.

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
    kelvin = np.asarray(temperature, dtype=np.float64) + 273.15
    return np.asarray(
        (10.0 ** (10.0 ** (ordinate[0] + slope * (np.log10(kelvin) - abscissa[0]))) - 0.7) * 1e-6
    )


def air_compliance(pressure: ArrayLike, index: float) -> Array:
    """c(p), 1/Pa: compliance per fraction of free air at gauge `pressure` (Pa), polytropic `index`."""
    absolute = np.maximum(np.asarray(pressure, dtype=np.float64) + ATMOSPHERE, _LOWEST)
    return np.asarray(ATMOSPHERE ** (1.0 / index) / (index * absolute ** ((index + 1.0) / index)))


def pressure_of_compliance(compliance: ArrayLike, index: float) -> Array:
    """Gauge pressure (Pa) at which the air has a compliance, (n,) 1/Pa; NaN for one that no pressure gives.

    Examples
    --------
    >>> round(float(pressure_of_compliance(air_compliance(5e5, 1.4), 1.4)))
    500000
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = ATMOSPHERE ** (1.0 / index) / (index * np.asarray(compliance, dtype=np.float64))
        return np.asarray(share ** (index / (index + 1.0)) - ATMOSPHERE)


def air_shrinkage(pressure: ArrayLike, index: float) -> Array:
    """∫c dp: share of the free air's volume that gauge `pressure` (Pa) takes away, but for a constant."""
    absolute = np.maximum(np.asarray(pressure, dtype=np.float64) + ATMOSPHERE, _LOWEST)
    return np.asarray(-((ATMOSPHERE / absolute) ** (1.0 / index)))


def modulus_at(oil: Oil, pressure: float) -> float:
    """Effective bulk modulus (Pa) at gauge `pressure` (Pa), where air is compressed as much as it is there.

    Examples
    --------
    >>> from fdd.unit import Unit
    >>> oil = Unit.load("axis_a").oil
    >>> round(modulus_at(oil, oil.reference_pressure) / 1e6), round(modulus_at(oil, 2e6) / 1e6)
    (210, 261)
    """
    more = air_compliance(pressure, oil.polytropic_index) - air_compliance(
        oil.reference_pressure, oil.polytropic_index
    )
    # A profile typed from a sheet may have more air at its high reference pressure than leaves oil any give.
    return 1.0 / max(1.0 / oil.bulk_modulus + oil.air_fraction * float(more), 0.2 / oil.bulk_modulus)
