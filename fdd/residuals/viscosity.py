"""Oil viscosity over temperature, for comparing leakage at different temperatures."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.unit import Oil


def viscosity_ratio(oil: Oil, temperature: ArrayLike) -> NDArray[np.float64]:
    """Viscosity at `temperature` (°C) over that at the oil's reference temperature.

    Walther's equation, ASTM D341: ``log10 log10(ν + 0.7) = a − b log10 T`` (ν in cSt, T in K),
    through the oil's two viscosities at 40 and 100 °C. Laminar leakage goes with its inverse.

    Examples
    --------
    >>> from fdd.unit import Unit
    >>> oil = Unit.load("axis_a").oil
    >>> viscosity_ratio(oil, [40.0, 100.0]).round(3).tolist()
    [1.0, 0.169]
    """

    def w(nu: float) -> float:
        return float(np.log10(np.log10(nu * 1e6 + 0.7)))

    x40, x100 = np.log10(313.15), np.log10(373.15)
    slope = (w(oil.viscosity_100) - w(oil.viscosity_40)) / (x100 - x40)

    def nu(celsius: ArrayLike) -> NDArray[np.float64]:
        kelvin = np.clip(np.asarray(celsius, dtype=np.float64), -40.0, 200.0) + 273.15
        return np.asarray(10.0 ** (10.0 ** (w(oil.viscosity_40) + slope * (np.log10(kelvin) - x40))) - 0.7)

    return np.asarray(nu(temperature) / nu(oil.reference_temperature), dtype=np.float64)
