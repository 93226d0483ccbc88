"""Conditions: everything about an axis that changes with time, one row per millisecond.

The compiled loop holds a row for its millisecond. Faults, valves, loads and the oil's change of
viscosity act on the plant only through these columns. Leakages are those at the oil's reference
temperature: the loop divides them by the viscosity of its own, present temperature.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.unit import Unit

Array = NDArray[np.float64]

(
    SETPOINT,
    FORCE,
    WARMING,
    VISCOSITY,
    CROSS_LEAKAGE,
    CROSS_ORIFICE,
    SPEED_LEAKAGE,
    SEAL_LEAKAGE,
    CASE_LEAKAGE,
    SHAFT_LEAKAGE,
    OUTSIDE_1,
    OUTSIDE_2,
    AIR,
    FRICTION_FORWARD,
    FRICTION_REVERSE,
    VISCOUS,
    OPEN_1,
    OPEN_2,
    REFEED_1,
    REFEED_2,
    RELIEF_OPEN,
    DISPLACEMENT,
    RIPPLE,
    TORQUE,
    RESISTANCE,
    CURRENT_LIMIT,
    PLAY,
    ECCENTRICITY,
    BYPASS,
    CONNECT_1,
    CONNECT_2,
    CHARGE,
    ENCODER_OFFSET,
) = range(33)
COLUMNS = 33

MEANING: dict[int, str] = {
    SETPOINT: "m in position control, rad/s in speed control, unsigned rad/s for strokes at constant speed",
    FORCE: "external force on the rod that depends on time alone, against extension (N); first axis only",
    WARMING: "heating of the oil from outside (K/s)",
    VISCOSITY: "the oil's viscosity over that of sound oil at the same temperature",
    CROSS_LEAKAGE: "ξ of eq. 3.14, across the pump's ports (m³/(s·Pa))",
    CROSS_ORIFICE: "turbulent part of the leakage across the ports (m³/s at 1 MPa)",
    SPEED_LEAKAGE: "leakage across the ports per pump speed (m³/(s·Pa) per rad/s)",
    SEAL_LEAKAGE: "leakage past the piston's seal, L/2 of eq. 3.40 (m³/(s·Pa))",
    CASE_LEAKAGE: "C_ep of eq. 3.14 (m³/(s·Pa))",
    SHAFT_LEAKAGE: "from the case drain past the shaft seal to the outside (m³/(s·Pa))",
    OUTSIDE_1: "from chamber 1 to the outside (m³/(s·Pa))",
    OUTSIDE_2: "from chamber 2 to the outside (m³/(s·Pa))",
    AIR: "free air at atmospheric pressure over oil, by volume",
    FRICTION_FORWARD: "scale of the seal's friction curve, extending",
    FRICTION_REVERSE: "scale of the seal's friction curve, retracting",
    VISCOUS: "scale of the viscous part beside the oil's viscosity",
    OPEN_1: "orifice between chamber 1 and accumulator, its check valve stuck open (m³/s at 1 MPa)",
    OPEN_2: "the same of chamber 2",
    REFEED_1: "share of its healthy flow gain that chamber 1's check valve has left",
    REFEED_2: "the same of chamber 2",
    RELIEF_OPEN: "orifice between the ports, a relief valve stuck open (m³/s at 1 MPa)",
    DISPLACEMENT: "share of the pump's displacement that is left",
    RIPPLE: "flow ripple added to the healthy one, amplitude over mean flow",
    TORQUE: "share of the torque constant (and back EMF) that the motor has left",
    RESISTANCE: "winding resistance over the healthy one",
    CURRENT_LIMIT: "share of the current limit that is left; 0 is a motor without power",
    PLAY: "torsional play between motor and pump (rad)",
    ECCENTRICITY: "pump speed's swing once a turn over the speed: a coupling out of line",
    BYPASS: "by-pass or throttling valve across the cylinder (m³/s at 1 MPa)",
    CONNECT_1: "valve between both axes' lines 1 (m³/s at 1 MPa); first axis only",
    CONNECT_2: "valve between both axes' lines 2 (m³/s at 1 MPa); first axis only",
    CHARGE: "flow of the charging pump into the inner circuit (m³/s)",
    ENCODER_OFFSET: "what the position encoder has slipped by (m)",
}
"""Column to meaning and unit."""


def healthy_conditions(unit: Unit, setpoint: Array, force: Array) -> Array:
    """The conditions before any fault.

    Parameters
    ----------
    unit : leakages and air.
    setpoint : (n,) what the controller is asked for.
    force : (n,) N, external.

    Returns
    -------
    (n, COLUMNS) one row per millisecond.
    """
    rows = np.zeros((setpoint.size, COLUMNS))
    rows[:, SETPOINT] = setpoint
    rows[:, FORCE] = force
    rows[:, CROSS_LEAKAGE] = unit.pump.cross_port_leakage
    rows[:, CASE_LEAKAGE] = unit.pump.case_leakage
    rows[:, AIR] = unit.oil.air_fraction
    for column in (
        VISCOSITY, FRICTION_FORWARD, FRICTION_REVERSE, VISCOUS, REFEED_1, REFEED_2,
        DISPLACEMENT, TORQUE, RESISTANCE, CURRENT_LIMIT,
    ):  # fmt: skip
        rows[:, column] = 1.0
    return rows
