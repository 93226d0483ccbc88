"""How much gas and oil the accumulator of a closed circuit holds at rest."""

from __future__ import annotations

import math

EXPANSION = 7e-4
"""1/K, of mineral oil's volume (typical data sheet of an ISO VG 32 oil)."""
RESERVE = 1.1
"""Oil at rest over what the circuit can take."""
HIGHEST, LOWEST = 1.6, 0.6
"""Absolute gas pressure over that at rest: hottest, and coldest under load."""
STEP_M3 = 1e-5
"""10 cm³: volumes are rounded up to it."""


def accumulator_volumes(
    total_oil: float, loaded_oil: float, relief_pressure: float, bulk_modulus: float, shifted: float,
    cooling: float, heating: float,
) -> tuple[float, float]:  # fmt: skip
    """Gas and oil volume at rest (m³) such that the circuit is neither starved nor overcharged.

    The thesis (section 4.4) sizes its 13 cm³ by what may leak between services alone. A closed circuit needs
    besides, each rounded up to 10 cm³:

    - oil: 1.1 times what contracts down to the coldest temperature, what the loaded chamber takes in at the
      relief pressure, and what unequal areas shift over half a stroke;
    - gas, isothermal: below 1.6 times its absolute pressure at rest when the hottest oil and the shifted oil
      have come in, above 0.6 times when all of the oil above is gone.

    Only ratios of absolute pressures count, so the charge does not enter.

    Parameters
    ----------
    total_oil : m³, in both chambers with their lines. loaded_oil : m³, in the chamber under load.
    relief_pressure, bulk_modulus : Pa.
    shifted : m³, difference of the piston areas times half the stroke; its sign does not matter.
    cooling, heating : K, at least 0, from the reference temperature to the coldest and to the hottest.

    Examples
    --------
    The prototype's axis (Table 4.21, 2 V_o in each chamber), 40 °C, 10 to 70 °C:

    >>> gas, oil = accumulator_volumes(4.32e-3, 2.16e-3, 3.44e6, 2.1e8, 0.0, 30.0, 30.0)
    >>> round(1e6 * gas), round(1e6 * oil)
    (250, 140)
    """
    per_kelvin, shift = EXPANSION * total_oil, abs(shifted)
    taken = per_kelvin * cooling + loaded_oil * relief_pressure / bulk_modulus + shift
    given = per_kelvin * heating + shift
    gas = max(given * HIGHEST / (HIGHEST - 1.0), taken * LOWEST / (1.0 - LOWEST))
    # Less a hair: 20 cm³ that a sum gives as 20.000000000000004 stay 20.
    gas, oil = (STEP_M3 * math.ceil(volume / STEP_M3 - 1e-9) for volume in (gas, RESERVE * taken))
    return gas, oil
