"""The plant's right-hand side: one axis, or two on one rod.

Each axis has its own hydraulics, drive and seal friction; piston position and velocity are shared, since the
cylinders are joined at the shaft (section 4.5), and connect valves may join the lines (section 4.6.6).
`fdd.plant.state` says where everything stands.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from fdd.plant.conditions import CONNECT_1, CONNECT_2, FORCE, WARMING
from fdd.plant.drive import drive_rates
from fdd.plant.friction import friction_rates
from fdd.plant.hydraulics import hydraulic_rates
from fdd.plant.laws import oil_at, orifice
from fdd.plant.parameters import Constants
from fdd.plant.state import (
    AXIS_STATES,
    DROP,
    FINDINGS,
    FRICTION_FORCE,
    LINE_1,
    LINE_2,
    LOAD_FORCE,
    LOSSES,
    MOTOR_TORQUE,
    P1,
    P2,
    SHARED,
    SPEED,
    STATES,
    STOP_FORCE,
    TEMPERATURE,
    V,
    X,
)

Array = NDArray[np.float64]

EQUATIONS = 13
"""See `fdd.plant.steps.EQUATIONS`: hydraulics, drive and friction are compiled into this module."""


@njit(cache=True, error_model="numpy", inline="always")
def axis_rates(
    y: Array, x: float, v: float, command: float, linked_1: float, linked_2: float, now: Array,
    par: Constants, dy: Array, found: Array,
) -> float:  # fmt: skip
    """Force of one axis on the rod (N); fills its rates and findings."""
    resisting, heat = hydraulic_rates(y, x, v, linked_1, linked_2, now, par, dy, found)
    torque, turning = drive_rates(y, command, resisting, now, par, dy)
    friction = friction_rates(y, v, now, par, dy)
    heat += abs(friction * v) + abs(turning * y[SPEED])
    cooling = par.cooling * (y[TEMPERATURE] - par.surroundings)
    dy[TEMPERATURE] = now[WARMING] + (heat - cooling) / par.heat_capacity
    found[FRICTION_FORCE] = friction
    found[MOTOR_TORQUE] = torque
    found[LOSSES] = heat
    return par.area_1 * y[P1] - par.area_2 * y[P2] - friction


@njit(cache=True, error_model="numpy", inline="always")
def end_stop(x: float, v: float, par: Constants) -> float:
    """Force of stops and cushions, positive against extension (N).

    A cushion throttles the oil that the piston pushes out of the cylinder's end and lets it back freely.
    """
    force = 0.0
    if x * v > 0.0:
        depth = (abs(x) - par.half_stroke) / par.cushion_length + 1.0
        if depth > 0.0:
            force = par.cushion_damping * min(depth, 1.0) * v * abs(v)
    if x > par.half_stroke:
        force += max(par.stop_stiffness * (x - par.half_stroke) * (1.0 + par.stop_damping * v), 0.0)
    elif x < -par.half_stroke:
        force += min(par.stop_stiffness * (x + par.half_stroke) * (1.0 - par.stop_damping * v), 0.0)
    return force


# Its arrays are borrowed: without counting references to them (_nrt) it takes a quarter less time.
@njit(cache=True, error_model="numpy", _nrt=False)
def right_hand_side(
    y: Array,
    command_1: float,
    command_2: float,
    now: Array,
    first: Constants,
    second: Constants,
    dy: Array,
    found: Array,
) -> None:
    """Time derivative of the state.

    Parameters
    ----------
    y : (STATES,) for one axis, (STATES + AXIS_STATES,) for two.
    command_1, command_2 : rad/s, speeds demanded of the drives (after their delay).
    now : (axes, COLUMNS) conditions of this millisecond, at the present viscosity.
    first, second : constants of each axis; load, stops and mass are the first's.
    dy : as y, is filled with the derivative.
    found : (axes·FINDINGS,) is filled with forces, flows, pressures.
    """
    x, v = y[X], y[V]
    row = now[0]
    linked_1, linked_2 = 0.0, 0.0
    o = SHARED + AXIS_STATES
    dual = y.size > STATES
    if dual and (row[CONNECT_1] != 0.0 or row[CONNECT_2] != 0.0):
        # From the second axis's lines into the first's, at the mean of their densities.
        a, b = y[SHARED + LINE_1], y[SHARED + LINE_2]
        a_2, b_2 = y[o + LINE_1], y[o + LINE_2]
        _, rho_a = oil_at(0.5 * (a + a_2), 0.0, first.ambient, first.stiff_compliance, 1.0)
        _, rho_b = oil_at(0.5 * (b + b_2), 0.0, first.ambient, first.stiff_compliance, 1.0)
        linked_1 = rho_a * orifice(a_2 - a, row[CONNECT_1], first.orifice_transition)
        linked_2 = rho_b * orifice(b_2 - b, row[CONNECT_2], first.orifice_transition)
    force = axis_rates(
        y[SHARED:o], x, v, command_1, linked_1, linked_2, row, first, dy[SHARED:o], found[:FINDINGS]
    )
    if dual:
        force += axis_rates(
            y[o:], x, v, command_2, -linked_1, -linked_2, now[1], second, dy[o:], found[FINDINGS:]
        )

    drop = y[DROP]
    load = row[FORCE] + first.spring * (x - first.spring_centre) + first.partner_area * drop
    dy[DROP] = 0.0
    if first.partner_area > 0.0:
        width = first.orifice_transition
        through = drop / math.sqrt(first.throttle * math.sqrt(drop * drop + width * width))
        dy[DROP] = (first.partner_area * v - through) / first.partner_compliance
    stop = end_stop(x, v, first)
    dy[X] = v
    dy[V] = (force - load - stop) / first.mass
    found[LOAD_FORCE] = load
    found[STOP_FORCE] = stop
    if dual:
        found[FINDINGS + LOAD_FORCE] = load
        found[FINDINGS + STOP_FORCE] = stop
