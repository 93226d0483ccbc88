"""The columns of the truth, from what the compiled loop gave."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdd.plant import conditions as c
from fdd.plant import state as s
from fdd.plant.oil import bulk_modulus, viscosity_ratio
from fdd.plant.parameters import Parameters
from fdd.unit import Unit

Array = NDArray[np.float64]


def truth_columns(
    unit: Unit, par: Parameters, rows: Array, states: Array, found: Array, axis: int
) -> dict[str, Array]:
    """Truth of one axis, each column (n,), as `fdd.plant.truth.TRUTH` describes them.

    Parameters
    ----------
    unit, par : of the axis.
    rows : (n, COLUMNS) its conditions.
    states : (n, states) of the plant.
    found : (n, axes·FINDINGS).
    axis : 0 or 1.
    """
    own = states[:, s.SHARED + axis * s.AXIS_STATES :]
    f = found[:, axis * s.FINDINGS :]
    air_1, air_2 = own[:, s.FREE_1], own[:, s.FREE_2]
    air = 0.5 * (air_1 + air_2)
    p1, p2, speed = own[:, s.P1], own[:, s.P2], own[:, s.SPEED]
    ratio = viscosity_ratio(unit.oil, own[:, s.TEMPERATURE]) * rows[:, c.VISCOSITY]
    cross = rows[:, c.CROSS_LEAKAGE] + rows[:, c.SPEED_LEAKAGE] * np.abs(speed) + rows[:, c.SEAL_LEAKAGE]
    drop = f[:, s.PORT_DIFFERENCE]
    case = 0.25 * (rows[:, c.CASE_LEAKAGE_1] + rows[:, c.CASE_LEAKAGE_2])
    cross = cross + rows[:, c.CROSS_OPENING] * np.abs(drop)
    film = 1.0 + par.film_share * (np.sqrt(ratio) - 1.0)
    return {
        "leakage": (cross + case) / ratio + _secant(rows, f, par.orifice_transition * ratio**2),
        "bulk_modulus": bulk_modulus(unit.oil, np.full(air.size, unit.oil.reference_pressure), air),
        "bulk_modulus_1": bulk_modulus(unit.oil, p1, air_1, par.ambient),
        "bulk_modulus_2": bulk_modulus(unit.oil, p2, air_2, par.ambient),
        "coulomb_friction": 0.5
        * (
            par.coulomb_forward * rows[:, c.FRICTION_FORWARD] * rows[:, c.COULOMB_FORWARD]
            + par.coulomb_reverse * rows[:, c.FRICTION_REVERSE] * rows[:, c.COULOMB_REVERSE]
        )
        * film,
        "viscous_friction": 0.5 * (par.viscous_forward + par.viscous_reverse) * rows[:, c.VISCOUS] * ratio,
        "position": states[:, s.X],
        "velocity": states[:, s.V],
        "pressure_1": p1,
        "pressure_2": p2,
        "pressure_difference": p1 - p2,
        "pressure_accumulator": f[:, s.ACCUMULATOR],
        "pressure_case": f[:, s.CASE_PRESSURE],
        "port_difference": f[:, s.PORT_DIFFERENCE],
        "pump_angle": own[:, s.ANGLE],
        "pump_speed": speed,
        "motor_current": own[:, s.CURRENT],
        "motor_torque": f[:, s.MOTOR_TORQUE],
        "oil_temperature": own[:, s.TEMPERATURE],
        "friction_force": f[:, s.FRICTION_FORCE],
        "load_force": f[:, s.LOAD_FORCE],
        "stop_force": f[:, s.STOP_FORCE],
        "pump_flow": f[:, s.PUMP_FLOW],
        "cross_flow": f[:, s.CROSS_FLOW],
        "bypass_flow": f[:, s.BYPASS_FLOW],
        "refeed_flow_1": f[:, s.REFEED_FLOW_1],
        "refeed_flow_2": f[:, s.REFEED_FLOW_2],
        "drain_flow": f[:, s.DRAIN_FLOW],
        "relief_flow": f[:, s.RELIEF_FLOW],
        "stuck_relief_flow": f[:, s.STUCK_RELIEF_FLOW],
        "outside_flow": f[:, s.OUTSIDE_FLOW],
        "connect_flow_1": f[:, s.CONNECT_FLOW_1],
        "connect_flow_2": f[:, s.CONNECT_FLOW_2],
        "power_lost": f[:, s.LOSSES],
        "oil_lost": own[:, s.LOST],
        "oil_mass": f[:, s.OIL_MASS],
        "oil_stored": f[:, s.STORED_OIL],
        "gas_temperature": own[:, s.GAS] * (par.surroundings + 273.15) - 273.15,
    }


def _secant(rows: Array, found: Array, width: Array) -> Array | float:
    """Leakage coefficient of the turbulent part: its flow over the present pressure, (n,); laminar up to
    `width` (Pa)."""
    gain = rows[:, c.CROSS_ORIFICE]
    if not gain.any():
        return 0.0
    drop = found[:, s.PORT_DIFFERENCE]
    return np.asarray(gain * 1e-3 / np.sqrt(np.sqrt(drop * drop + width * width)))
