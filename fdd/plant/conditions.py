"""Conditions: everything about an axis that changes with time, one row per millisecond.

The compiled loop holds a row for its millisecond. Faults, valves, loads and the oil's change of
viscosity act on the plant only through these columns. Leakages are those at the oil's reference
temperature: the loop divides them by the viscosity of its own, present temperature.
"""

from __future__ import annotations

import numpy as np

from fdd.plant import Array
from fdd.unit import Unit

(
    SETPOINT,  # m in position control, rad/s in speed control, unsigned rad/s for strokes at constant speed
    FORCE,  # external force on the rod that depends on time alone, against extension (N); first axis only
    WARMING,  # heating of the oil from outside (K/s)
    VISCOSITY,  # the oil's viscosity over that of sound oil at the same temperature
    VAPOUR,  # the oil's vapour pressure over that of sound oil
    TRANSITION,  # pressure up to which orifices are laminar, over that at the reference viscosity
    CROSS_LEAKAGE,  # ξ of eq. 3.14, across the pump's ports (m³/(s·Pa))
    CROSS_ORIFICE,  # turbulent part of the leakage across the ports (m³/s at 1 MPa)
    CROSS_OPENING,  # part of that leakage that opens with pressure (m³/(s·Pa²))
    SPEED_LEAKAGE,  # leakage across the ports for each rad/s of pump speed (m³/(rad·Pa))
    SEAL_LEAKAGE,  # leakage past the piston's seal (m³/(s·Pa))
    CASE_LEAKAGE_1,  # C_ep of eq. 3.14, port 1 to the case drain (m³/(s·Pa))
    CASE_LEAKAGE_2,  # the same of port 2
    SHAFT_LEAKAGE,  # case drain to the outside past the shaft's seal (m³/(s·Pa))
    SHAFT_SPEED,  # the same for each rad/s of pump speed (m³/(rad·Pa))
    OUTSIDE_1,  # from chamber 1 to the outside (m³/(s·Pa))
    OUTSIDE_2,  # from chamber 2 to the outside (m³/(s·Pa))
    OUTSIDE_ORIFICE_1,  # from chamber 1 to the outside through an orifice (m³/s at 1 MPa)
    OUTSIDE_ORIFICE_2,  # the same of chamber 2
    OUTSIDE_OPENING_1,  # from chamber 1 to the outside, opening with pressure (m³/(s·Pa²))
    OUTSIDE_OPENING_2,  # the same of chamber 2
    AIR_1,  # air of chamber 1 at atmospheric pressure over its oil, by volume; where more comes, oil leaves
    AIR_2,  # the same of chamber 2
    INGRESS,  # air of both chambers that comes in beside their oil, by volume
    FRICTION_FORWARD,  # scale of the seal's friction curve, extending
    FRICTION_REVERSE,  # scale of the seal's friction curve, retracting
    COULOMB_FORWARD,  # scale of that curve's level at speed, extending
    COULOMB_REVERSE,  # the same, retracting
    STRIBECK_FORWARD,  # scale of what friction at rest has beyond that level, extending
    STRIBECK_REVERSE,  # the same, retracting
    STRIBECK_SPEED,  # scale of the speed over which this falls
    VISCOUS,  # scale of the viscous part beside the oil's viscosity
    MIDDLE,  # change of the curve at mid-stroke, relative; gone at a quarter of the stroke either way
    OPEN_1,  # orifice between chamber 1 and accumulator, its check valve stuck open (m³/s at 1 MPa)
    OPEN_2,  # the same of chamber 2
    REFEED_1,  # share of its healthy flow gain that chamber 1's check valve has left
    REFEED_2,  # the same of chamber 2
    CRACKING_1,  # added to the cracking pressure of chamber 1's check valve (Pa)
    CRACKING_2,  # the same of chamber 2
    STICKING_1,  # pressure back over chamber 1's check valve without which it does not shut (Pa)
    STICKING_2,  # the same of chamber 2
    RELIEF_OPEN,  # orifice between the ports, a relief valve stuck open (m³/s at 1 MPa)
    RELIEF_SETTING,  # relief valves' setting over the healthy one
    RELIEF_GAIN,  # relief valves' flow over the healthy one
    DISPLACEMENT,  # share of the pump's displacement that is left
    RIPPLE,  # flow ripple added to the healthy one, amplitude over mean flow
    DRAG,  # the pump's viscous torque over the healthy one beside the oil's viscosity
    TORQUE,  # share of the torque constant (and back EMF) that the motor has left
    RESISTANCE,  # winding resistance over the healthy one
    CURRENT_LIMIT,  # share of the current limit that is left; 0 is a motor without power
    PHASE,  # share by which one of three phases is open: torque swings twice an electrical turn
    BRAKING,  # torque of shorted turns against the speed (N·m·s/rad)
    PLAY,  # torsional play between motor and pump (rad)
    ECCENTRICITY,  # pump speed's swing once a turn over the speed: a coupling out of line
    BYPASS,  # by-pass or throttling valve across the cylinder (m³/s at 1 MPa)
    CONNECT_1,  # valve between both axes' lines 1 (m³/s at 1 MPa); first axis only
    CONNECT_2,  # valve between both axes' lines 2 (m³/s at 1 MPa); first axis only
    CHARGE,  # flow of the charging pump into the inner circuit (m³/s)
    ENCODER_OFFSET,  # what the position encoder has slipped by (m)
    BY_LOAD,  # share of the load up to which faults that come with load act; the loop writes it
    BY_HEAT,  # share of the warming up to which faults that come with heat act; the loop writes it
    STORE_DENSITY,  # of the accumulator's oil over that at gauge zero and 40 °C; the loop writes it
    STORE_SPECIFIC,  # one over it
) = range(63)
COLUMNS = 63

WHOLE = (
    VISCOSITY, VAPOUR, TRANSITION, FRICTION_FORWARD, FRICTION_REVERSE, COULOMB_FORWARD,
    COULOMB_REVERSE, STRIBECK_FORWARD, STRIBECK_REVERSE, STRIBECK_SPEED, VISCOUS, REFEED_1, REFEED_2,
    RELIEF_SETTING, RELIEF_GAIN, DISPLACEMENT, DRAG, TORQUE, RESISTANCE, CURRENT_LIMIT,
)  # fmt: skip
"""Columns that are 1 in a sound axis; what the unit does not give is 0."""


def healthy_conditions(unit: Unit, setpoint: Array, force: Array) -> Array:
    """The conditions before any fault, (n, COLUMNS), for a set-point (n,) and an external force (n,) N."""
    row = np.zeros(COLUMNS)
    row[list(WHOLE)] = 1.0
    row[CROSS_LEAKAGE] = unit.pump.cross_port_leakage
    row[[CASE_LEAKAGE_1, CASE_LEAKAGE_2]] = unit.pump.case_leakage
    row[[AIR_1, AIR_2]] = unit.oil.air_fraction
    rows = np.tile(row, (setpoint.size, 1))
    rows[:, SETPOINT] = setpoint
    rows[:, FORCE] = force
    return rows
