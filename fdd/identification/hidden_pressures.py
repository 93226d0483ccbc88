"""Chamber pressures that nobody measures: from their difference, by what the refeeding valves allow.

With a differential sensor alone, the chambers' mean pressure is hidden. It is not free, though: the
refeeding valves keep the lower chamber at the accumulator's pressure less their cracking, so the mean
is at least that plus half the difference; once lifted it stays up, and only the case drain lets it
down. What lifts it is oil from the accumulator, whose pressure falls for it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from fdd.identification.compiled import njit
from fdd.identification.oil import ATMOSPHERE
from fdd.unit import Unit

Array = NDArray[np.float64]


@njit()
def _follow(
    difference: Array,
    compliance: Array,
    tank: Array,
    tank_known: bool,
    charge: float,
    gas: float,
    cracking: float,
    drain_cracking: float,
    drain: float,
    period: float,
) -> Array:
    mean = np.empty_like(difference)
    level = charge + 0.5 * abs(difference[0])
    taken = 0.0
    for k in range(difference.size):
        if not tank_known:
            volume = max(gas + taken, 0.1 * gas)
            tank[k] = (charge + ATMOSPHERE) * gas / volume - ATMOSPHERE
        lost = level - tank[k] - drain_cracking
        if lost > 0.0:
            fall = lost * (1.0 - math.exp(-2.0 * drain / compliance[k] * period))
            level -= fall
            taken -= fall * compliance[k]
        least = tank[k] - cracking + 0.5 * abs(difference[k])
        if level < least:
            taken += (least - level) * compliance[k]
            level = least
        mean[k] = level
    return mean


def chambers_from_difference(
    difference: Array, position: Array, period: float, unit: Unit, accumulator: Array | None
) -> tuple[Array, Array]:
    """Mean chamber pressure and accumulator pressure that go with a pressure difference.

    Parameters
    ----------
    difference : (n,) Pa, smoothed. position : (n,) m. period : s.
    unit : its volumes, bulk modulus, accumulator and case leakage (base values: a first guess).
    accumulator : (n,) Pa where it is measured, else None.

    Returns
    -------
    (n,) mean pressure and (n,) accumulator pressure, Pa gauge.
    """
    cylinder, tank = unit.cylinder, unit.accumulator
    volume = (
        cylinder.volume_1 + cylinder.volume_2 + (cylinder.area_1 - cylinder.area_2) * (position - position[0])
    )
    known = accumulator is not None
    level = accumulator.copy() if accumulator is not None else np.empty_like(difference)
    mean = _follow(
        difference,
        np.maximum(volume, 1e-9) / unit.oil.bulk_modulus,
        level,
        known,
        float(level[0]) if known else tank.charge_pressure,
        tank.gas_volume,
        tank.refeed_cracking_pressure,
        tank.case_cracking_pressure,
        unit.pump.case_leakage,
        period,
    )
    return mean, level
