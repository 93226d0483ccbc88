"""Conditions: everything about the plant that changes with time, one row per millisecond.

The compiled loop holds a row for its millisecond. Faults, oil temperature and loads
act on the plant only through these columns.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.plant.oil import viscosity_ratio
from fdd.unit import Unit

Array = NDArray[np.float64]

SETPOINT = 0
"""m in position control, rad/s in speed control, unsigned rad/s for strokes at constant speed."""
CROSS_LEAKAGE = 1
"""ξ of eq. 3.14 at the present viscosity, faults included (m³/(s·Pa))."""
CASE_LEAKAGE = 2
"""C_ep of eq. 3.14 at the present viscosity (m³/(s·Pa))."""
AIR = 3
"""Free air at atmospheric pressure over oil, by volume."""
FRICTION = 4
"""Scale of the seal's friction curve."""
VISCOUS = 5
"""Scale of its viscous part: the seal's times the viscosity's."""
OPEN_1 = 6
"""Flow (m³/s at 1 MPa) of an orifice between chamber 1 and accumulator: its check valve stuck open."""
OPEN_2 = 7
FORCE = 8
"""External force on the rod that depends on time alone, against extension (N)."""
RELIEF_OPEN = 9
"""Flow (m³/s at 1 MPa) of an orifice between the chambers: a relief valve stuck open."""
REFEED_1 = 10
"""Share of its healthy flow gain that chamber 1's check valve has left."""
REFEED_2 = 11
TORQUE = 12
"""Share of its torque constant that the motor has left."""
COLUMNS = 13


def healthy_conditions(unit: Unit, setpoint: Array, temperature: Array, force: Array) -> Array:
    """The conditions before any fault.

    Parameters
    ----------
    unit : leakages, air and the oil's viscosity law.
    setpoint : (n,) what the controller is asked for.
    temperature : (n,) °C, oil.
    force : (n,) N, external.

    Returns
    -------
    (n, COLUMNS) one row per millisecond.
    """
    ratio = viscosity_ratio(unit.oil, temperature)
    rows = np.zeros((setpoint.size, COLUMNS))
    rows[:, SETPOINT] = setpoint
    rows[:, CROSS_LEAKAGE] = unit.pump.cross_port_leakage / ratio
    rows[:, CASE_LEAKAGE] = unit.pump.case_leakage / ratio
    rows[:, AIR] = unit.oil.air_fraction
    rows[:, FRICTION] = 1.0
    rows[:, VISCOUS] = ratio
    rows[:, FORCE] = force
    rows[:, REFEED_1] = 1.0
    rows[:, REFEED_2] = 1.0
    rows[:, TORQUE] = 1.0
    return rows
